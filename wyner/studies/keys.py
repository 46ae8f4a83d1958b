"""The controls of docs/keys.md: each rule broken on purpose, beside the rule, block by block.

What is drawn is which copies she missed and which counted; what she then holds of a block of so
many rows is certain.
"""

from collections.abc import Callable, Iterator
from random import Random
from typing import Final, NamedTuple

from protocol.secret.bound import Assumption, GilbertElliott, quantile
from tap_service.inference.key_solver import bits_held

SOURCES: Final = (
    "wyner/studies/keys.py",
    "protocol/secret/bound.py",
    "tap_service/inference/key_solver.py",
)
"""Where the numbers of this module come from."""

TRANSITIONS: Final = 256
COPIES: Final = 2 * TRANSITIONS
BLOCKS: Final = 40
EPS: Final = 1e-12
CLAIM: Final = Assumption(0.3)

CONTROL_COLUMNS: Final = ("control", "rule", "blocks", "breached", "worst_bits", "last_seed")


class KeyRun(NamedTuple):
    """A block's rows by the broken rule and by the right one, with what she missed under each."""

    broken: int
    missed_broken: int
    kept: int
    missed_kept: int


def one_row_more(random: Random) -> KeyRun:
    """A row more than she missed of the counted copies."""
    missed = sum(random.random() < 0.3 for _ in range(COPIES))
    return KeyRun(missed + 1, missed, CLAIM.rows(TRANSITIONS, TRANSITIONS, COPIES), missed)


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
    return KeyRun(rows, missed, kept, first_missed)


def jammer(random: Random) -> KeyRun:
    """Q of the counted copies; she jams at the partner's whatever she did not hear herself."""
    sent = counted = 0
    while counted < COPIES:
        sent += 1
        counted += random.random() >= 0.3
    kept = quantile(COPIES, 0.3, EPS) - (sent - counted)
    return KeyRun(quantile(counted, 0.3, EPS), 0, max(0, kept), 0)


def high_claim(random: Random) -> KeyRun:
    """Half of the copies claimed, three of ten missed."""
    missed = sum(random.random() < 0.3 for _ in range(COPIES))
    broken = Assumption(0.5).rows(TRANSITIONS, TRANSITIONS, COPIES)
    return KeyRun(broken, missed, CLAIM.rows(TRANSITIONS, TRANSITIONS, COPIES), missed)


def bursts(random: Random) -> KeyRun:
    """Misses in bursts of fifty copies, claimed as if each were drawn by itself."""
    channel = GilbertElliott(0.0, 1.0, 0.02 * 3 / 7, 0.02)
    bad = random.random() < channel.mean
    missed = 0
    for _ in range(COPIES):
        bad = random.random() >= channel.to_good if bad else random.random() < channel.to_bad
        missed += bad
    kept = Assumption(channel.eps_inf).rows(TRANSITIONS, TRANSITIONS, COPIES)
    return KeyRun(CLAIM.rows(TRANSITIONS, TRANSITIONS, COPIES), missed, kept, missed)


CONTROLS: Final[dict[str, Callable[[Random], KeyRun]]] = {
    "one row too many": one_row_more,
    "repeats with the nonce": same_nonce,
    "Q without L, jammer": jammer,
    "0.5 claimed, 0.3 true": high_claim,
    "bursts as independent": bursts,
}


def control_rows() -> Iterator[tuple[str, str, int, int, int, int]]:
    """Blocks that she breaks, by control, with the rule broken and kept."""
    for control, draw in CONTROLS.items():
        outcomes = [draw(Random(f"{control} {seed}")) for seed in range(BLOCKS)]
        for rule, held in (
            ("broken", [bits_held(o.broken, o.missed_broken) for o in outcomes]),
            ("kept", [bits_held(o.kept, o.missed_kept) for o in outcomes]),
        ):
            breached = sum(bits > 0 for bits in held)
            yield control, rule, BLOCKS, breached, max(held), BLOCKS - 1
