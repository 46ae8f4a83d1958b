"""How good the taps are: their guesses scored against the truth, which they never see.

The truth comes over the management bus, the guesses over the adversary bus, and they meet here and
nowhere else.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from protocol.messages import TapStatus
from protocol.messages.adversary import deaf_share
from protocol.relabelling import Labels, known
from protocol.statistics import CONFIDENCE, Interval, bits_left, stated_left
from wyner.dashboard.model import TAPS_KEPT, State, TapState, compared
from wyner.dashboard.text import drawn, letters, number

ALARM: Final = (1 - CONFIDENCE) / TAPS_KEPT
"""Chance of a false alarm because of one tap, however long one watches: all of them share 5 %."""


@dataclass(frozen=True, slots=True)
class Score:
    """One tap's guesses on the agreed steps that both Eve and the plant reported.

    Parameters
    ----------
    scored, right : int
        Agreed steps compared, and those where Eve's likeliest symbol was the key symbol, up to one
        relabelling of the symbols for all steps (:mod:`protocol.relabelling`).
    guessed : Interval
        The share that was right, with 95 % limits that hold at every look together: it is looked
        at after every status.
    size : int
        M.
    labels : tuple of int
        That relabelling; empty where Eve's symbols count as named.
    leads : bool
        Whether Eve is shown to do better than chance.
    """

    scored: int
    right: int
    guessed: Interval
    size: int
    labels: Labels
    leads: bool

    @property
    def bits_per_key(self) -> float | None:
        """What one key symbol hides from Eve at most, -log2 P_g in bits; None: no guess yet."""
        return bits_left(1, self.size, self.guessed).high if self.scored else None


@dataclass(frozen=True, slots=True)
class SecrecyScore:
    """What the paper's rule counts of the keys agreed so far, against what is true.

    Parameters
    ----------
    claimed_bits : float
        What the paper's rule counts, of whichever law: every agreed symbol as log2 M secret bits.
    left : Interval or None
        Bits that the strongest running tap leaves of it, of the steps that it could use; None
        while nobody is scored.
    strongest : str
        Name of that tap, or "".
    exceeds : bool
        Whether that is shown to be too much: a tap holds a true message, or its guesses are better
        than blind ones. Of taps that are blind it is ever so with a chance of 5 % at most.
    scored : int
        Agreed steps on which that tap was scored.
    why : str
        Why nobody is scored, or what the figure rests on besides guesses.
    failed : tuple of str
        Taps that do not guess any more.
    silent_bits : float
        Bits of the agreed steps that this tap could not use: what it leaves of them is not known.
    """

    claimed_bits: float
    left: Interval | None
    strongest: str
    exceeds: bool
    scored: int
    why: str = ""
    failed: tuple[str, ...] = ()
    silent_bits: float = 0.0

    @property
    def left_bits(self) -> float | None:
        """Bits left at most."""
        return None if self.left is None else self.left.high


def score(state: State, tap: TapState) -> Score:
    """Score one tap on all agreed steps so far."""
    size = state.candidates
    its = known([compared(state, tap)], size)
    labels = its.labels[0] if its.labels else ()
    return Score(its.of, its.right, its.share, size, labels, its.better_than_chance(ALARM))


def ranked(state: State) -> list[tuple[TapState, Score]]:
    """The taps, strongest first: a true message, else most of its text, else the best guesses.

    Those that failed come last, but for one that holds a true message.
    """
    scored = [(tap, score(state, tap)) for tap in state.taps.values()]

    def strength(pair: tuple[TapState, Score]) -> tuple[bool, bool, int, float, str]:
        tap, its = pair
        right, total = characters_right(state, tap)
        # In tenths of the text, so that a character right by chance changes no order.
        tenths = 10 * right // total if total else 0
        failed = bool(tap.status.failed) and not tap.exact
        return (failed, not tap.exact, -tenths, -its.guessed.low, tap.status.name)

    return sorted(scored, key=strength)


def _carried(state: State) -> int:
    """Agreed keys that can be used: the result of the newest transition is not published yet."""
    if state.plant is None:
        return 0
    newest = max(state.truths, default=None)
    unsaid = newest is not None and state.truths[newest].symbol >= 0
    return state.plant.agreements - unsaid


@dataclass(frozen=True, slots=True)
class Left:
    """Bits that one tap leaves of the agreed keys, of the steps that it could use.

    Parameters
    ----------
    by_keys : Interval, optional
        What guessing one by one leaves; None where it was compared on none.
    stated : Interval, optional
        By its own account, but no more than was agreed; None where it gives none.
    silent : float
        Bits of the steps that it could not use.
    """

    by_keys: Interval | None
    stated: Interval | None
    silent: float = 0.0

    @property
    def least(self) -> Interval | None:
        """The less of both; None where nobody knows."""
        both = [left for left in (self.stated, self.by_keys) if left is not None]
        return min(both, key=lambda left: left.high, default=None)


def left_by(state: State, tap: TapState, its: Score) -> Left:
    """What one tap leaves of the agreed keys: nothing where it holds a true message."""
    if tap.exact:
        return Left(Interval(0.0, 0.0, 0.0), None)
    if tap.status.failed:
        return Left(None, None)
    keys = _carried(state)
    silent = round(keys * deaf_share(vars(tap.status), tap.status.steps))
    bit = math.log2(its.size)
    by_keys = bits_left(keys - silent, its.size, its.guessed) if its.scored else None
    stated, bits = None, tap.status.bits_left
    if bits is not None:
        stated = stated_left(bits, (keys - silent) * bit if state.plant is not None else bits)
    return Left(by_keys, stated, silent * bit)


def secrecy(state: State, taps: Sequence[tuple[TapState, Score]] | None = None) -> SecrecyScore:
    """What the paper's rule counts against the truth, from all taps.

    ``taps`` are those of `ranked` where it was called.
    """
    symbols = _carried(state)
    claimed = symbols * math.log2(state.candidates)
    taps = ranked(state) if taps is None else taps
    failed = tuple(tap.status.name for tap, _ in taps if tap.status.failed)
    exceeds = symbols > 0 and any(tap.exact or its.leads for tap, its in taps)
    best: tuple[float, Left, TapState, Score] | None = None
    for tap, its in taps:
        left = left_by(state, tap, its)
        if (least := left.least) is None:
            continue
        unknown = least.high + left.silent  # deaf taps are not the strongest
        if best is None or unknown < best[0]:
            best = unknown, left, tap, its
    if best is None:
        why = "Eve failed" if failed else "no guess yet" if taps else "no tap"
        return SecrecyScore(claimed, None, "", exceeds, 0, why, failed)
    _, left, tap, its = best
    return SecrecyScore(
        claimed,
        left.least,
        tap.status.name,
        exceeds,
        its.scored,
        _rests_on(tap, its, left),
        failed,
        left.silent,
    )


def _rests_on(tap: TapState, its: Score, left: Left) -> str:
    """What the figure of the strongest tap rests on; empty where it is its guesses as named."""
    if tap.exact:
        return "a true message"
    found = []
    if left.stated is not None:
        expectation = tap.status.given
        account = f"given {expectation}" if expectation else "by its own account"
        if left.by_keys is not None:
            account = (
                f"at most {left.stated.high:.0f} {account}, by keys alone {left.by_keys.high:.0f}"
            )
        found.append(account)
        if tap.status.solved_k < 0:
            found.append("Eve has no whole message yet")
    if its.labels:
        found.append("its symbols relabelled")
    if left.silent:
        found.append(f"of {left.silent:.0f} bit more nobody knows: Eve could not use their steps")
    return "; ".join(found)


def rate_of(state: State) -> float | None:
    """Message bits per second of plant time, over the session; None: the period is not known.

    A count of what was sent, and no estimate: it has no interval.
    """
    plant, model = state.plant, state.model
    if plant is None or model is None:
        return None
    if plant.k == 0 or model.period_s <= 0:
        return 0.0
    return plant.recovered_symbols * math.log2(state.candidates) / (plant.k * model.period_s)


def rate_in_words(state: State) -> str:
    """The rate with its unit, and how much of it may be secret at most."""
    rate = rate_of(state)
    if rate is None:
        return "- bit/s"
    its, hers = secrecy(state), attacker(state)
    if state.plant is not None and state.plant.keys_made and not its.claimed_bits:
        broken = hers is not None and (hers.key_bits_held or hers.claim_refuted)
        return f"{number(rate)} bit/s, {'not secret' if broken else 'secret if the claim holds'}"
    if its.left_bits is None or not its.claimed_bits:
        return f"{number(rate)} bit/s, secret: unknown"
    secret = rate * its.left_bits / its.claimed_bits
    return f"{number(rate)} bit/s, at most {number(secret)} secret"


def attacker(state: State) -> TapStatus | None:
    """The tap that holds most of the keys, of those that go for them."""
    trying = [tap.status for tap in state.taps.values() if tap.status.key_bits_held >= 0]
    return max(trying, key=lambda its: its.key_bits_held, default=None)


def contradictions(state: State) -> Iterator[str]:
    """What the tap found against the claim."""
    hers = attacker(state)
    if hers is None:
        return
    if hers.claim_refuted:
        of = f" of the {drawn(hers.missed_direction)}" if hers.missed_direction else ""
        yield f"CLAIM REFUTED: Eve misses {hers.missed_at_most:.2g}{of} at most"
    if hers.misses_in_bursts:
        yield "MISSES IN BURSTS"


def truth_for(state: State, text: str) -> str:
    """The true message that a tap's text fits best; the one on its way where several fit alike."""
    best, best_right = state.sent, _right(state.sent, text)
    for truth in state.texts:
        right = _right(truth, text)
        if right > best_right:
            best, best_right = truth, right
    return best


def characters_right(state: State, tap: TapState) -> tuple[int, int]:
    """How many characters of the tap's message are right, and how many the true message has."""
    truth = truth_for(state, tap.status.message)
    return _right(truth, tap.status.message), len(letters(truth))


def _right(truth: str, text: str) -> int:
    return sum(a == b for a, b in zip(letters(truth), letters(text), strict=False))
