"""How good the taps are: their guesses scored against the truth, which they never see.

The truth comes over ops, the guesses over intel, and they meet here and nowhere else.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from wyner.dashboard.model import Board, TapBoard
from wyner.dashboard.text import letters, number

SCORED_AT_LEAST: Final = 8
"""Agreed steps needed before a guessing probability is quoted; fewer say nothing."""

CONFIDENCE_Z: Final = 1.96
"""Normal quantile of the 95 % Wilson interval."""


@dataclass(frozen=True, slots=True)
class Score:
    """One tap's guesses on the agreed steps that both she and the plant reported.

    Parameters
    ----------
    scored, right : int
        Agreed steps compared, and those where her likeliest symbol was the key symbol.
    guessing : float or None
        P_g, the share that was right and never below 1/M; None while too few were compared.
    at_least : float
        Lower end of the 95 % Wilson interval of the share that was right.
    """

    scored: int
    right: int
    guessing: float | None
    at_least: float

    @property
    def bits_per_key(self) -> float | None:
        """Min-entropy left in one key symbol, -log2 P_g, in bits."""
        return None if self.guessing is None else abs(math.log2(self.guessing))


@dataclass(frozen=True, slots=True)
class SecrecyScore:
    """What the paper claims of the keys agreed so far, against what is true.

    Parameters
    ----------
    claimed_bits : float
        What the paper's rule counts: every agreed symbol as log2 M secret bits.
    left_bits : float or None
        What the strongest tap leaves of it; None while no tap was scored.
    strongest : str
        Name of that tap, or "".
    exceeds : bool
        Whether the claim is shown to be too high: a tap holds a true message, or her guesses are
        better than blind ones beyond chance (95 %).
    when_bits : float
        Upper bound 2 log2(N + 1) on what may stay hidden of *when* keys were agreed, in N steps.
    scored : int
        Agreed steps on which that tap was scored.
    """

    claimed_bits: float
    left_bits: float | None
    strongest: str
    exceeds: bool
    when_bits: float
    scored: int


def score(board: Board, tap: TapBoard) -> Score:
    """Score one tap on the agreed steps that are still held."""
    scored = right = 0
    for k, guess in tap.guesses.items():
        truth = board.truths.get(k)
        if truth is not None and truth.symbol >= 0:
            scored += 1
            right += truth.symbol == guess.symbol
    guessing = None
    if scored >= SCORED_AT_LEAST:
        guessing = max(right / scored, 1.0 / board.candidates)
    return Score(scored, right, guessing, wilson_lower(right, scored))


def wilson_lower(right: int, scored: int) -> float:
    """Lower end of the 95 % Wilson interval for a proportion; 0 of none."""
    if right == 0:
        return 0.0
    z2 = CONFIDENCE_Z**2
    share = right / scored
    centre = share + z2 / (2 * scored)
    spread = CONFIDENCE_Z * math.sqrt(share * (1 - share) / scored + z2 / (4 * scored**2))
    return max(0.0, (centre - spread) / (1 + z2 / scored))


def ranked(board: Board) -> list[tuple[TapBoard, Score]]:
    """The taps, strongest first: a true message, else most of its text, else the best guesses."""
    scored = [(tap, score(board, tap)) for tap in board.taps.values()]

    def strength(pair: tuple[TapBoard, Score]) -> tuple[bool, int, float, str]:
        tap, its = pair
        right, total = characters_right(board, tap)
        # In tenths of the text, so that a character right by chance changes no order.
        tenths = 10 * right // total if total else 0
        return (not tap.exact, -tenths, -its.at_least, tap.status.name)

    return sorted(scored, key=strength)


def secrecy(board: Board, taps: Sequence[tuple[TapBoard, Score]] | None = None) -> SecrecyScore:
    """The paper's claim against the truth, from all taps.

    ``taps`` are those of `ranked` where it was called.
    """
    symbols = board.plant.agreements if board.plant is not None else 0
    transitions = board.plant.transitions if board.plant is not None else 0
    bits = math.log2(board.candidates)
    claimed = symbols * bits
    when = 2 * math.log2(transitions + 1)
    best: tuple[float, str, int] | None = None
    exceeds = False
    for tap, its in ranked(board) if taps is None else taps:
        left = 0.0 if tap.exact else its.bits_per_key
        if left is None:
            continue
        if best is None or left < best[0]:
            best = (left, tap.status.name, its.scored)
        exceeds |= tap.exact or its.at_least > 1.0 / board.candidates
    if best is None:
        return SecrecyScore(claimed, None, "", False, when, 0)
    left_bits, exceeds = symbols * best[0], exceeds and symbols > 0
    return SecrecyScore(claimed, left_bits, best[1], exceeds, when, best[2])


def course(board: Board, points: int) -> list[tuple[float, float | None]]:
    """Bits that the paper claims, and bits left by the strongest tap, over the steps that are held.

    Of her guesses up to each of ``points`` moments, evenly spread; None while too few were scored.
    From the step on at which she was sure of a true message, nothing is left.
    """
    agreed = [k for k in sorted(board.truths) if board.truths[k].symbol >= 0]
    its = secrecy(board)
    if not agreed or points < 1 or board.plant is None:
        return []
    tap = board.taps.get(its.strongest)
    bits = math.log2(board.candidates)
    before = max(0, board.plant.agreements - len(agreed))
    first, last = min(board.truths), max(board.truths)
    found: list[tuple[float, float | None]] = []
    scored = right = at = 0
    for i in range(points):
        until = first + (last - first) * (i + 1) / points
        while at < len(agreed) and agreed[at] <= until:
            guess = tap.guesses.get(agreed[at]) if tap is not None else None
            if guess is not None:
                scored += 1
                right += guess.symbol == board.truths[agreed[at]].symbol
            at += 1
        left: float | None = None
        if scored >= SCORED_AT_LEAST:
            share = max(right / scored, 1.0 / board.candidates)
            left = (before + at) * abs(math.log2(share))
        if tap is not None and tap.exact and 0 <= tap.status.solved_k <= until:
            left = 0.0
        found.append(((before + at) * bits, left))
    return found


def rate_of(board: Board) -> float | None:
    """Message bits per second of plant time, over the session; None: the period is not known."""
    plant, model = board.plant, board.model
    if plant is None or model is None:
        return None
    if plant.k == 0 or model.period_s <= 0:
        return 0.0
    return plant.recovered_symbols * math.log2(board.candidates) / (plant.k * model.period_s)


def rate_in_words(board: Board) -> str:
    """The same with its unit."""
    rate = rate_of(board)
    return f"{'-' if rate is None else number(rate)} bit/s"


SETTLED: Final = 20
"""Transitions from which on the time left is said."""


def time_left_s(board: Board) -> float | None:
    """Seconds on the wall clock until the message on its way is whole; None: not to be said."""
    plant, controller = board.plant, board.controller
    if plant is None or controller is None or not plant.recovered_symbols or not plant.rate_hz:
        return None
    if plant.transitions < SETTLED:  # the first second's pace is that of the start, not of the run
        return None
    missing = controller.frame_length - controller.frame_symbols
    if missing <= 0:
        return None
    return missing * plant.transitions / plant.recovered_symbols / plant.rate_hz


def truth_for(board: Board, text: str) -> str:
    """The true message that a tap's text fits best; the one on its way where several fit alike."""
    best, best_right = board.sent, _right(board.sent, text)
    for truth in board.texts:
        right = _right(truth, text)
        if right > best_right:
            best, best_right = truth, right
    return best


def characters_right(board: Board, tap: TapBoard) -> tuple[int, int]:
    """How many characters of the tap's message are right, and how many the true message has."""
    truth = truth_for(board, tap.status.message)
    return _right(truth, tap.status.message), len(letters(truth))


def model_error(board: Board, tap: TapBoard) -> float | None:
    """Distance of her [A B] from the plant's, relative, Frobenius norm; None: she has no model."""
    model, status = board.model, tap.status
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
