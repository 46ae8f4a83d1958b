"""A secrecy report for people: its tables, and what must stand beside their numbers."""

from collections.abc import Mapping, Sequence
from typing import Final

from protocol.messages.adversary import KeysHeld
from protocol.relabelling import in_words
from protocol.statistics import FEWEST_RUNS
from wyner.runs.score.report import TapReport, given, percent

GUESSES: Final = ("eavesdropper", "keys wrong", "bits wrong", "list", "read at k")
"""Of an eavesdropper: key symbols and message bits named wrong, messages that it still thinks
possible, and the step at which it was first sure of one (medians over runs)."""

SECRECY: Final = ("eavesdropper", "messages read", "guess right", "bits left", "by keys")
"""Messages read whole; the probability that it guesses a key symbol right; the bits that it leaves
at most, and those by its keys alone."""

NOTE: Final = (
    f"Rates have 95 % intervals over runs; fewer than {FEWEST_RUNS} runs have none. The bits left "
    "are upper limits. These and the limits of a right guess hold however often one looks, for the "
    "symbols up to one relabelling a run. An eavesdropper that is not shown to be better than "
    "chance leaves all bits of the steps that it could use; of other steps nothing is known."
)
"""What the tables' intervals are."""


def guess_rows(taps: Sequence[TapReport]) -> list[tuple[str, ...]]:
    """Rows under :data:`GUESSES`."""
    return [
        (
            t.name,
            percent(t.symbol_error_rate),
            percent(t.message_bit_error_rate),
            _number(t.list_size, ".0f"),
            _number(t.median_broken, ".0f"),
        )
        for t in taps
    ]


def secrecy_rows(taps: Sequence[TapReport]) -> list[tuple[str, ...]]:
    """Rows under :data:`SECRECY`."""
    return [
        (
            t.name,
            percent(t.exact_message_rate),
            t.guessing_probability.text(".3f") if t.agreed_steps else "-",
            _number(None if t.left_bits is None else t.left_bits.high, ".1f"),
            _number(None if t.left_bits_by_keys is None else t.left_bits_by_keys.high, ".1f"),
        )
        for t in taps
    ]


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def remarks(t: TapReport) -> list[str]:
    """What must stand beside the numbers of one eavesdropper, in words."""
    found = []
    if t.unscored:
        found.append(f"not scored: {t.unscored}")
    if t.relabelled:
        alike = len(set(t.relabelled)) == 1
        how = in_words(t.relabelled[0]) if alike and t.size <= WORDED else "by run, in --json"
        found.append(f"its symbols count relabelled: {how}")
    if t.left_bits_stated is not None and t.left_bits_by_keys is not None:
        found.append(
            f"states at most {t.left_bits_stated.high:.1f} bits left, {given(t.given)}; "
            "by its keys, which suppose nothing of the message, at most "
            f"{t.left_bits_by_keys.high:.1f}"
        )
    if t.silent_steps:
        steps = t.silent_steps + t.agreed_steps
        found.append(
            f"could not use {t.silent_steps} of {steps} agreed steps: nothing is known of what it "
            "leaves of them"
        )
    if told := unused_in_words(t.unused):
        found.append(f"not used of what the tap heard: {told}")
    return found


WORDED: Final = 8
"""M up to which a relabelling is told in words."""

_KINDS: Final = {
    "foreign": "messages of other sessions",
    "late": "late messages",
    "dropped": "messages dropped",
    "malformed": "malformed messages",
    "jumped": "steps skipped",
    "restarts": "restarts",
}


def unused_in_words(unused: Mapping[str, int]) -> str:
    """What a tap could not use, by kind; empty where it used all."""
    return ", ".join(f"{unused[k]} {words}" for k, words in _KINDS.items() if unused.get(k))


def held_line(held: KeysHeld) -> str:
    """What one who goes for keys holds, in words."""
    line = f"holds {held.bits} bits of {held.broken} of {held.blocks} key blocks"
    if held.unplaced:
        line += f"; {held.unplaced} transitions fell in no block that it could place"
    return line
