"""How good the taps are: their guesses scored against the truth, which they never see.

The truth comes over the management bus, the guesses over the adversary bus, and they meet here and
nowhere else.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from protocol.agreement import Gauge
from protocol.messages import PlantModel
from protocol.statistics import (
    CONFIDENCE,
    Interval,
    better_than,
    bits_left,
    confidence_sequence,
    stated_left,
)
from wyner.dashboard.model import TAPS_KEPT, State, TapState, compared
from wyner.dashboard.text import letters, number

ALARM: Final = (1 - CONFIDENCE) / TAPS_KEPT
"""Chance of a false alarm because of one tap, however long one watches: all of them share 5 %."""


@dataclass(frozen=True, slots=True)
class Score:
    """One tap's guesses on the agreed steps that both she and the plant reported.

    Parameters
    ----------
    scored, right : int
        Agreed steps compared, and those where her likeliest symbol was the key symbol.
    guessed : Interval
        The share that was right, with 95 % limits that hold at every look together: it is looked
        at after every status.
    size : int
        M.
    leads : bool
        Whether she is shown to do better than chance.
    """

    scored: int
    right: int
    guessed: Interval
    size: int
    leads: bool

    @property
    def bits_per_key(self) -> float | None:
        """What one key symbol hides from her at most, -log2 P_g in bits; None: she guessed none."""
        return bits_left(1, self.size, self.guessed).high if self.scored else None


@dataclass(frozen=True, slots=True)
class SecrecyScore:
    """What the paper's rule counts of the keys agreed so far, against what is true.

    Parameters
    ----------
    claimed_bits : float
        What the paper's rule counts, of whichever law: every agreed symbol as log2 M secret bits.
    left : Interval or None
        Bits that the strongest running tap leaves of it; None while nobody is scored.
    strongest : str
        Name of that tap, or "".
    exceeds : bool
        Whether that is shown to be too much: a tap holds a true message, or her guesses are better
        than blind ones. Of taps that are blind it is ever so with a chance of 5 % at most.
    when_bits : float
        Upper bound on what may stay hidden of *when* keys were agreed in N steps, from one who
        knows D_e: f log2(2N + 1), f = 1 width of D_c where D_e = alpha D_c.
    scored : int
        Agreed steps on which that tap was scored.
    why : str
        Why nobody is scored, or what the figure rests on where it is not her guesses.
    failed : tuple of str
        Taps that do not guess any more.
    """

    claimed_bits: float
    left: Interval | None
    strongest: str
    exceeds: bool
    when_bits: float
    scored: int
    why: str = ""
    failed: tuple[str, ...] = ()

    @property
    def left_bits(self) -> float | None:
        """Bits left at most."""
        return None if self.left is None else self.left.high


def score(state: State, tap: TapState) -> Score:
    """Score one tap on all agreed steps so far."""
    scored, right = compared(state, tap)
    size = state.candidates
    leads = better_than(1.0 / size, right, scored, ALARM)
    return Score(scored, right, confidence_sequence(right, scored), size, leads)


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
    """Agreed keys that can be used: of the newest transition nobody has been told the result."""
    if state.plant is None:
        return 0
    newest = max(state.truths, default=None)
    unsaid = newest is not None and state.truths[newest].symbol >= 0
    return state.plant.agreements - unsaid


def left_by(state: State, tap: TapState, its: Score) -> Interval | None:
    """Bits that one tap leaves of the agreed keys; None where nobody knows.

    None of them where she holds a true message. By her own account where she gives one, but no more
    than was agreed; else what guessing one by one leaves.
    """
    if tap.exact:
        return Interval(0.0, 0.0, 0.0)
    if tap.status.failed:
        return None
    keys = _carried(state)
    if tap.status.bits_left is not None:
        bits = tap.status.bits_left
        return stated_left(bits, keys * math.log2(its.size) if state.plant is not None else bits)
    if not its.scored:
        return None
    return bits_left(keys, its.size, its.guessed)


def _hidden_widths(model: PlantModel | None) -> int:
    """Widths of D_c that she does not know, who knows D_e."""
    if model is None or not model.eavesdropper_H:
        return 1
    box = Gauge.from_rows(model.defender_H, model.defender_h).half_widths
    return len(box or model.defender_h)


def secrecy(state: State, taps: Sequence[tuple[TapState, Score]] | None = None) -> SecrecyScore:
    """What the paper's rule counts against the truth, from all taps.

    ``taps`` are those of `ranked` where it was called.
    """
    symbols = _carried(state)
    transitions = state.plant.transitions if state.plant is not None else 0
    claimed = symbols * math.log2(state.candidates)
    widths = _hidden_widths(state.model)
    cuts = state.candidates if widths > 1 else 2
    when = widths * math.log2(cuts * transitions + 1)
    taps = ranked(state) if taps is None else taps
    failed = tuple(tap.status.name for tap, _ in taps if tap.status.failed)
    exceeds = symbols > 0 and any(tap.exact or its.leads for tap, its in taps)
    best: tuple[Interval, TapState, Score] | None = None
    for tap, its in taps:
        left = left_by(state, tap, its)
        if left is not None and (best is None or left.high < best[0].high):
            best = left, tap, its
    if best is None:
        why = "she failed" if failed else "nobody guessed" if taps else "nobody listens"
        return SecrecyScore(claimed, None, "", exceeds, when, 0, why, failed)
    left, tap, its = best
    own = tap.status.bits_left is not None and not tap.exact
    account = "her own account"
    if tap.status.solved_k < 0:
        account += ", and she has no whole message yet"
    why = "a true message" if tap.exact else account if own else ""
    return SecrecyScore(claimed, left, tap.status.name, exceeds, when, its.scored, why, failed)


def course(state: State, points: int) -> list[tuple[float, float | None]]:
    """Bits by the paper's rule, and bits left at most by the strongest tap, over the steps held.

    Of her guesses up to each of ``points`` moments, evenly spread; None while there were none, and
    where the figure is her own account, which is known of the last moment alone. From the step on
    at which she was sure of a true message, nothing is left.
    """
    agreed = [k for k in sorted(state.truths)[:-1] if state.truths[k].symbol >= 0]
    its = secrecy(state)
    if not agreed or points < 1 or state.plant is None:
        return []
    tap = state.taps.get(its.strongest)
    size = state.candidates
    bits = math.log2(size)
    before = max(0, _carried(state) - len(agreed))
    first, last = min(state.truths), max(state.truths)
    found: list[tuple[float, float | None]] = []
    scored, right = (tap.scored, tap.right) if tap is not None else (0, 0)
    at = 0
    for i in range(points):
        until = first + (last - first) * (i + 1) / points
        while at < len(agreed) and agreed[at] <= until:
            guess = tap.guesses.get(agreed[at]) if tap is not None else None
            if guess is not None:
                scored += 1
                right += guess.symbol == state.truths[agreed[at]].symbol
            at += 1
        left: float | None = None
        if tap is not None and tap.status.bits_left is not None:
            left = its.left_bits if i == points - 1 else None
        elif scored:
            left = bits_left(before + at, size, confidence_sequence(right, scored)).high
        if tap is not None and tap.exact and 0 <= tap.status.solved_k <= until:
            left = 0.0
        found.append(((before + at) * bits, left))
    return found


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
    """The same with its unit."""
    rate = rate_of(state)
    return f"{'-' if rate is None else number(rate)} bit/s"


SETTLED: Final = 20
"""Transitions from which on the time left is said."""


def time_left_s(state: State) -> float | None:
    """Seconds on the wall clock until the message on its way is whole; None: not to be said."""
    plant, controller = state.plant, state.controller
    if plant is None or controller is None or not plant.recovered_symbols or not plant.rate_hz:
        return None
    if plant.phase == "stopped":
        return None
    if plant.transitions < SETTLED:  # the first second's pace is that of the start, not of the run
        return None
    missing = controller.frame_length - controller.frame_symbols
    if missing <= 0:
        return None
    return missing * plant.transitions / plant.recovered_symbols / plant.rate_hz


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


def model_error(state: State, tap: TapState) -> float | None:
    """Distance of her [A B] from the plant's, relative, Frobenius norm; None: she has no model."""
    model, status = state.model, tap.status
    if model is None or not status.A or not status.B:
        return None
    hers = [*_entries(status.A), *_entries(status.B)]
    true = [*_entries(model.A), *_entries(model.B)]
    if len(hers) != len(true):
        return None
    size = math.hypot(*true)
    return math.hypot(*(a - b for a, b in zip(hers, true, strict=True))) / size if size else None


def _entries(matrix: tuple[tuple[float, ...], ...]) -> list[float]:
    return [entry for row in matrix for entry in row]


def _right(truth: str, text: str) -> int:
    return sum(a == b for a, b in zip(letters(truth), letters(text), strict=False))
