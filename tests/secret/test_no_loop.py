"""Keys owe nothing to control: two who merely talk make keys of the same worth."""

import random

import pytest

from protocol.secret.blocks import OpenBlock
from protocol.secret.bound import Assumption
from protocol.secret.extractor import extract
from protocol.secret.nonces import Contribution
from tests.support.known_rows import held


@pytest.mark.parametrize("seed", range(5))
def test_a_chat_over_datagrams_makes_the_same_keys_at_both_ends_and_none_at_hers(seed: int) -> None:
    """Questions and answers with nonces, no plant and no input; a fiftieth is lost on the way.

    She misses three datagrams of ten. One who hears all computes every key.
    """
    rng, claim = random.Random(seed), Assumption(0.3)
    alice, bob, hers = OpenBlock(claim), OpenBlock(claim), list[bytes | None]()
    for j in range(1, 257):
        ask, answer = rng.randbytes(32), rng.randbytes(32)
        came = [nonce if rng.random() < 0.98 else None for nonce in (ask, answer)]
        for block in (alice, bob):
            block.add(Contribution(j, 1, came[0], came[1]))
        hers += [None if rng.random() < 0.3 else n for n in came if n is not None]
    one, other = (block.close("chat", 0, 256) for block in (alice, bob))
    assert one.rows == other.rows > 40
    keys = extract(one.nonces, one.rows)
    assert keys == extract(other.nonces, other.rows)
    assert held(hers, one.rows).bits == 0
    assert held(list(one.nonces), one.rows).bits == 256 * one.rows
