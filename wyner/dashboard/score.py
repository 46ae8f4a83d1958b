"""How good the taps are: their guesses scored against the truth, which they never see.

The truth comes over the management bus, the guesses over the adversary bus, and they meet here and
nowhere else.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

from protocol.messages.adversary import KeysHeld, deaf_share
from protocol.relabelling import KnownSymbols, known
from protocol.statistics import CONFIDENCE, Interval, bits_left, stated_left
from wyner.dashboard.model import TAPS_KEPT, LoopState, TapState
from wyner.dashboard.text import drawn, letters, number

ALARM: Final = (1 - CONFIDENCE) / TAPS_KEPT
"""Chance of a false alarm because of one tap, however long one watches: all of them share 5 %."""


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


def score(state: LoopState, tap: TapState) -> KnownSymbols:
    """What one tap knows of all agreed steps so far that it has guessed.

    The limits of the share hold at every look together: it is looked at after every status.
    """
    return known([tap.pairs], state.candidates)


def ranked(state: LoopState) -> list[tuple[TapState, KnownSymbols]]:
    """The taps, strongest first: a true message, else most of its text, else the best guesses.

    Those that failed come last, but for one that holds a true message.
    """
    scored = [(tap, score(state, tap)) for tap in state.taps.values()]

    def strength(pair: tuple[TapState, KnownSymbols]) -> tuple[bool, bool, int, float, str]:
        tap, its = pair
        right, total = characters_right(state, tap)
        # In tenths of the text, so that a character right by chance changes no order.
        tenths = 10 * right // total if total else 0
        failed = bool(tap.status.failed) and not tap.exact
        return (failed, not tap.exact, -tenths, -its.share.low, tap.status.name)

    return sorted(scored, key=strength)


def _carried(state: LoopState) -> int:
    """Agreed keys that can be used: the result of the newest transition is not published yet."""
    if state.plant is None:
        return 0
    newest = max(state.truths, default=None)
    unsaid = newest is not None and state.truths[newest].symbol >= 0
    return state.plant.step.agreements - unsaid


class BitsLeft(NamedTuple):
    """Bits that one tap leaves of the agreed keys, of the steps that it could use.

    ``silent`` are those of the steps that it could not use; ``why`` says what the figure rests on,
    and is empty where it is its guesses as named.
    """

    bits: Interval
    silent: float = 0.0
    why: str = ""


def left_by(state: LoopState, tap: TapState, its: KnownSymbols) -> BitsLeft | None:
    """What one tap leaves: nothing where it holds a true message; None where nobody knows.

    The less of what guessing one by one leaves, and of what it states itself.
    """
    status, belief = tap.status, tap.status.belief
    if tap.exact:
        return BitsLeft(Interval(0.0, 0.0, 0.0), why="a true message")
    if status.failed:
        return None
    keys, size = _carried(state), state.candidates
    silent = round(keys * deaf_share(vars(status.unused), status.steps))
    bit = math.log2(size)
    found, known_left = [], []
    if its.of:
        known_left.append(bits_left(keys - silent, size, its.share))
    if belief.bits_left is not None:
        most = (keys - silent) * bit if state.plant is not None else belief.bits_left
        stated = stated_left(belief.bits_left, most)
        account = f"given {belief.given}" if belief.given else "by its own account"
        if known_left:
            account = f"at most {stated.high:.0f} {account}, by keys alone {known_left[0].high:.0f}"
        found.append(account)
        known_left.insert(0, stated)
        if belief.solved_k < 0:
            found.append("Eve has no whole message yet")
    if not known_left:
        return None
    if its.labels:
        found.append("its symbols relabelled")
    if silent:
        more = f"of {silent * bit:.0f} bit more nobody knows"
        found.append(f"{more}: Eve could not use their steps")
    least = min(known_left, key=lambda left: left.high)
    return BitsLeft(least, silent * bit, "; ".join(found))


def secrecy(state: LoopState) -> SecrecyScore:
    """What the paper's rule counts against the truth, from all taps."""
    symbols = _carried(state)
    claimed = symbols * math.log2(state.candidates)
    taps = ranked(state)
    failed = tuple(tap.status.name for tap, _ in taps if tap.status.failed)
    exceeds = symbols > 0 and any(tap.exact or its.better_than_chance(ALARM) for tap, its in taps)
    by_tap = [(left_by(state, tap, its), tap.status.name, its.of) for tap, its in taps]
    found = [(left, name, of) for left, name, of in by_tap if left is not None]
    if not found:
        why = "Eve failed" if failed else "no guess yet" if taps else "no tap"
        return SecrecyScore(claimed, None, "", exceeds, 0, why, failed)
    # deaf taps are not the strongest
    left, name, of = min(found, key=lambda one: one[0].bits.high + one[0].silent)
    return SecrecyScore(claimed, left.bits, name, exceeds, of, left.why, failed, left.silent)


def rate_in_words(state: LoopState) -> str:
    """Message bits per second of plant time, over the session, and how many may be secret at most.

    The rate is a count of what was sent, and no estimate: it has no interval.
    """
    plant, model = state.plant, state.model
    if plant is None or model is None:
        return "- bit/s"
    seconds, symbols = plant.step.k * model.period_s, plant.step.symbols
    rate = symbols * math.log2(state.candidates) / seconds if seconds else 0.0
    its, hers = secrecy(state), attacker(state)
    if plant.keys.made and not its.claimed_bits:
        broken = hers is not None and (hers.bits or hers.refuted)
        return f"{number(rate)} bit/s, {'not secret' if broken else 'secret if the claim holds'}"
    if its.left_bits is None or not its.claimed_bits:
        return f"{number(rate)} bit/s, secret: unknown"
    secret = rate * its.left_bits / its.claimed_bits
    return f"{number(rate)} bit/s, at most {number(secret)} secret"


def attacker(state: LoopState) -> KeysHeld | None:
    """What the tap holds that holds most of the keys, of those that go for them."""
    held = [keys for tap in state.taps.values() if (keys := tap.status.keys) is not None]
    return max(held, key=lambda keys: keys.bits, default=None)


def contradictions(state: LoopState) -> Iterator[str]:
    """What the tap found against the claim."""
    hers = attacker(state)
    if hers is None:
        return
    if hers.refuted:
        of = f" of the {drawn(hers.direction)}" if hers.direction else ""
        yield f"CLAIM REFUTED: Eve misses {hers.at_most:.2g}{of} at most"
    if hers.bursts:
        yield "MISSES IN BURSTS"


def truth_for(state: LoopState, text: str) -> str:
    """The true message that a tap's text fits best; the one on its way where several fit alike."""
    return max((state.sent, *state.texts), key=lambda truth: _right(truth, text))


def characters_right(state: LoopState, tap: TapState) -> tuple[int, int]:
    """How many characters of the tap's message are right, and how many the true message has."""
    text = tap.status.belief.message
    truth = truth_for(state, text)
    return _right(truth, text), len(letters(truth))


def _right(truth: str, text: str) -> int:
    return sum(a == b for a, b in zip(letters(truth), letters(text), strict=False))
