"""What she holds: nothing at the proper length, and what linear algebra predicts beyond it.

Each control breaks one rule on purpose, beside the proper one that holds.
"""

import random
from collections.abc import Callable

import pytest

from protocol.secret.bound import Assumption, quantile
from protocol.secret.extractor import extract, words
from protocol.secret.galois import product
from tap_service.eavesdroppers.key_solver import bits_held
from tap_service.inference.miss_rate import Misses
from tests.support.known_rows import held

N, COPIES = 128, 256
EPS = 1e-12


def heard(generator: random.Random, nonces: list[bytes], missed: int) -> list[bytes | None]:
    gone = set(generator.sample(range(len(nonces)), missed))
    return [None if j in gone else nonce for j, nonce in enumerate(nonces)]


@pytest.mark.parametrize(
    ("rows", "bits"), [(1, 0), (16, 0), (23, 0), (24, 0), (25, 256), (26, 512), (32, 2048)]
)
def test_one_row_too_many_is_one_row_she_holds(rows: int, bits: int) -> None:
    generator = random.Random(rows)
    nonces = [generator.randbytes(32) for _ in range(COPIES)]
    her = held(heard(generator, nonces, 24), rows)
    assert her.bits == bits == bits_held(rows, 24)
    # what she computes is right, of all keys
    keys = words(extract(nonces, rows))
    assert (product(her.combinations, keys) == her.values).all()


def test_who_hears_all_holds_all() -> None:
    generator = random.Random(0)
    nonces = [generator.randbytes(32) for _ in range(60)]
    her = held(list(nonces), 10)
    assert her.bits == 2560
    assert (her.values == words(extract(nonces, 10))).all()


class Block:
    """A block of N transitions over a link and a tap, and what three rules make of it."""

    def __init__(self) -> None:
        self.sent: list[bool] = []  # she missed it
        self.counted: list[bool] = []

    def copy(self, *, missed: bool, arrives: bool) -> None:
        self.sent.append(missed)
        if arrives:
            self.counted.append(missed)

    def rows(self, eps_E: float) -> dict[str, int]:
        naive = quantile(len(self.counted), eps_E, EPS)
        proper = quantile(COPIES, eps_E, EPS) - (len(self.sent) - len(self.counted))
        return {"naive": naive, "proper": max(0, proper)}

    def breached(self, rows: int) -> bool:
        return bits_held(rows, sum(self.counted)) > 0


Tap = Callable[[random.Random, Block], None]


def independent(loss: float, link: float) -> Tap:
    def one(generator: random.Random, block: Block) -> None:
        block.copy(missed=generator.random() < loss, arrives=generator.random() >= link)

    return one


def collisions(generator: random.Random, block: Block) -> None:
    """Whatever she misses, the partner misses as well."""
    missed = generator.random() < 0.3
    block.copy(missed=missed, arrives=not missed)


def jammer(generator: random.Random, block: Block) -> None:
    """She jams, at the partner's, what she did not hear herself."""
    collisions(generator, block)


def fifth(generator: random.Random, block: Block) -> None:
    missed = generator.random() < 0.3
    block.copy(missed=missed, arrives=not (missed and generator.random() < 0.2))


def run(tap: Tap, seed: int) -> Block:
    """A block is over after N transitions' worth of counted copies."""
    generator = random.Random(seed)
    block = Block()
    while len(block.counted) < COPIES:
        tap(generator, block)
    return block


@pytest.mark.parametrize(
    ("tap", "naive"),
    [
        (independent(0.3, 0.0), 0),
        (independent(0.3, 0.05), 0),
        (independent(0.3, 0.5), 0),
        (collisions, 40),
        (jammer, 40),
        (fifth, 0),
    ],
)
def test_the_quantile_without_l_breaks_where_her_misses_are_the_links(tap: Tap, naive: int) -> None:
    blocks = [run(tap, seed) for seed in range(40)]
    broken = {
        rule: sum(block.breached(block.rows(0.3)[rule]) for block in blocks)
        for rule in ("naive", "proper")
    }
    assert broken == {"naive": naive, "proper": 0}


@pytest.mark.parametrize(
    ("true", "claimed", "breached"), [(0.3, 0.3, 0), (0.3, 0.5, 20), (0.0, 0.3, 20), (0.45, 0.5, 0)]
)
def test_a_claim_above_the_truth_breaks(true: float, claimed: float, breached: int) -> None:
    rows = Assumption(claimed).rows(256, 256, 512)
    generator = random.Random(1)
    found = 0
    everything = Misses(claimed)
    for _ in range(20):
        misses = [generator.random() < true for _ in range(512)]
        for missed in misses:
            everything.add(missed=missed)
        found += bits_held(rows, sum(misses)) > 0
    assert found == breached or found >= breached - 1 >= 18
    # the audit says so even where the bound's slack hides it
    assert everything.judge().refuted == (true < claimed)
