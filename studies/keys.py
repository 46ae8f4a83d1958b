"""The controls of docs/keys.md: each rule broken on purpose, beside the rule, block by block.

What is drawn is which copies she missed and which counted; what she then holds of a block of so
many rows is certain.
"""

from collections.abc import Callable, Iterator, Sequence
from random import Random
from typing import Final, NamedTuple, Self

from protocol.gilbert_elliott import GilbertElliott
from protocol.secret.bound import NONCE_BITS, Assumption, quantile
from protocol.secret.extractor import WORDS
from studies.registry import Lines, Row, study, table
from tap_service.eavesdroppers.key_solver import bits_held

TRANSITIONS: Final = 256
COPIES: Final = 2 * TRANSITIONS
BLOCKS: Final = 40
EPS: Final = 1e-12
CLAIM: Final = Assumption(0.3)

CONTROL_COLUMNS: Final = "control rule blocks breached worst_bits last_seed"


class KeyRun(NamedTuple):
    """Bits of a block that she holds, or made different at the ends: the rule broken, and kept."""

    broken: int
    kept: int

    @classmethod
    def of(cls, broken: int, missed_broken: int, kept: int, missed_kept: int) -> Self:
        """From the rows by either rule, and what she missed under it."""
        return cls(bits_held(broken, missed_broken), bits_held(kept, missed_kept))


def one_row_more(random: Random) -> KeyRun:
    """A row more than she missed of the counted copies."""
    missed = sum(random.random() < 0.3 for _ in range(COPIES))
    return KeyRun.of(missed + 1, missed, CLAIM.rows(TRANSITIONS, TRANSITIONS, COPIES), missed)


def same_nonce(random: Random) -> KeyRun:
    """Repeats carry the nonce; both ways lose half, so a message goes out until it is answered."""
    missed = first_missed = first_counted = 0
    for _ in range(COPIES):
        misses = [random.random() < 0.3]
        first = random.random() < 0.5
        while random.random() >= 0.25:
            misses.append(random.random() < 0.3)
        missed += all(misses)
        first_counted += first
        first_missed += first and misses[0]
    rows = CLAIM.rows(TRANSITIONS, TRANSITIONS, COPIES)
    kept = CLAIM.rows(TRANSITIONS, TRANSITIONS, first_counted)
    return KeyRun.of(rows, missed, kept, first_missed)


def jammer(random: Random) -> KeyRun:
    """Q of the counted copies; she jams at the partner's whatever she did not hear herself."""
    sent = counted = 0
    while counted < COPIES:
        sent += 1
        counted += random.random() >= 0.3
    kept = quantile(COPIES, 0.3, EPS) - (sent - counted)
    return KeyRun.of(quantile(counted, 0.3, EPS), 0, max(0, kept), 0)


def high_claim(random: Random) -> KeyRun:
    """Half of the copies claimed, three of ten missed."""
    missed = sum(random.random() < 0.3 for _ in range(COPIES))
    broken = Assumption(0.5).rows(TRANSITIONS, TRANSITIONS, COPIES)
    return KeyRun.of(broken, missed, CLAIM.rows(TRANSITIONS, TRANSITIONS, COPIES), missed)


def bursts(random: Random) -> KeyRun:
    """Misses in bursts of fifty copies, claimed as if each were drawn by itself."""
    channel = GilbertElliott(0.0, 1.0, 0.02 * 3 / 7, 0.02)
    bad = random.random() < channel.mean
    missed = 0
    for _ in range(COPIES):
        bad = random.random() >= channel.to_good if bad else random.random() < channel.to_bad
        missed += bad
    kept = Assumption(channel.eps_inf).rows(TRANSITIONS, TRANSITIONS, COPIES)
    return KeyRun.of(CLAIM.rows(TRANSITIONS, TRANSITIONS, COPIES), missed, kept, missed)


def half_heard(random: Random) -> KeyRun:
    """She hears the first half of each message that she misses, claimed as missed as a whole."""
    missed = sum(random.random() < 0.3 for _ in range(COPIES))
    half = NONCE_BITS // 2
    broken = CLAIM.rows(TRANSITIONS, TRANSITIONS, COPIES)
    kept = Assumption(0.3, unheard_bits=half).rows(TRANSITIONS, TRANSITIONS, COPIES)
    # of half of the words she heard all; by words she lacks half of what she missed
    unheard = missed * WORDS // 2
    return KeyRun(half * broken, NONCE_BITS // WORDS * max(0, WORDS * kept - unheard))


CONTROLS: Final[dict[str, Callable[[Random], KeyRun]]] = {
    "one row too many": one_row_more,
    "repeats with the nonce": same_nonce,
    "Q without L, jammer": jammer,
    "0.5 claimed, 0.3 true": high_claim,
    "bursts as independent": bursts,
    "half heard as missed": half_heard,
}


@study("key-controls", CONTROL_COLUMNS, lambda: CONTROLS)
def control_rows(control: str) -> Iterator[tuple[str, str, int, int, int, int]]:
    """Blocks that she breaks, with the rule broken and kept."""
    outcomes = [CONTROLS[control](Random(f"{control} {seed}")) for seed in range(BLOCKS)]
    for rule, held in (
        ("broken", [o.broken for o in outcomes]),
        ("kept", [o.kept for o in outcomes]),
    ):
        breached = sum(bits > 0 for bits in held)
        yield control, rule, BLOCKS, breached, max(held), BLOCKS - 1


@table("key-controls", "keys", "key-controls")
def shown(rows: Sequence[Row]) -> Lines:
    """A line a control: blocks that she breaks, and the most bits of one that she holds."""
    lines: list[tuple[str, ...]] = [("control", "rule broken", "most bits", "rule kept")]
    found = {(row["control"], row["rule"]): row for row in rows}
    for control in dict.fromkeys(row["control"] for row in rows):
        broken, kept = (found[control, rule] for rule in ("broken", "kept"))
        of = broken["blocks"]
        lines.append(
            (
                control,
                f"{broken['breached']} of {of}",
                broken["worst_bits"],
                f"{kept['breached']} of {of}",
            )
        )
    return lines
