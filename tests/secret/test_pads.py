"""Sets of pads: one block each whatever is put back, and points that do not stay known."""

import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from protocol.secret.authentication import PRIME, RESERVE, TAG_BYTES, WORD_BYTES, number, polynomial
from protocol.secret.records import BlockRow
from runtime.keys import ledger as ledger_module
from runtime.keys.anchor import Anchor
from runtime.keys.ledger import RENEWS, Authentication, pad_counts, take_secret
from runtime.keys.secret_file import make_secret
from runtime.keys.store import KeyStore
from tests.support.giving import agree

ROWS = RENEWS + 4


class Signed:
    """Both ends' ledgers under one secret, and what a block's copies would be made of."""

    def __init__(self, folder: Path) -> None:
        self.random = random.Random(7)
        make_secret(folder / "controller-secret")
        (folder / "plant-secret").write_bytes((folder / "controller-secret").read_bytes())
        (folder / "plant-secret").chmod(0o600)
        self.stores, self.ends = [], []
        for side in ("controller", "plant"):
            store = KeyStore(folder / side, side, create=True)
            take_secret(store, folder / f"{side}-secret")
            self.stores.append(store)
            look: Callable[[], None] = lambda: agree(*self.stores)  # noqa: E731
            self.ends.append(Authentication(store, wait_s=0.2, look=look))

    def close(self) -> None:
        for store in self.stores:
            store.close()

    def block(self, session: str, block: int) -> tuple[bytes, list[bytes], str]:
        """Sign, store and confirm a block at both ends: its text, its rows, the plant's tag."""
        rows = [self.random.randbytes(32) for _ in range(ROWS)]
        text = f"{session}/{block}".encode() + self.random.randbytes(150)
        shown = []
        for store, end in zip(self.stores, self.ends, strict=True):
            signed = end.tags(session, block, text, rows)
            assert signed is not None
            row = BlockRow(session, block, 9, 9, 18, ROWS, ROWS - 3, "stored", 1)
            store.add(row, rows[1:-2], tag=signed[0], pads=signed[3])
            shown.append(signed[:2])
        assert shown[0] == shown[1][::-1]
        for store, end in zip(self.stores, self.ends, strict=True):
            store.confirm(session, block)
            end.confirm(session, block)
        return text, rows, shown[1][0]


@pytest.fixture
def signed(tmp_path: Path) -> Iterator[Signed]:
    both = Signed(tmp_path)
    yield both
    both.close()


def test_each_session_takes_a_set_and_a_block_of_many_rows_refills_the_reserve(
    signed: Signed, tmp_path: Path
) -> None:
    for session in range(2 * RESERVE):
        for block in range(2):
            signed.block(f"{session:016x}", block)
    for side in ("controller", "plant"):
        counts = pad_counts(tmp_path / side)
        assert counts is not None
        assert counts.left >= RESERVE


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("other_first", [False, True])
def test_a_ledger_that_is_put_back_signs_no_other_session_under_the_same_set(
    signed: Signed, end: int, other_first: bool
) -> None:
    store = signed.stores[end]
    assert store.path is not None
    count = Anchor(store.path).path
    copy, counted = store.db.serialize(), count.read_bytes()
    first = signed.ends[end].tags("a" * 16, 0, b"text", [bytes(32)])
    if other_first:
        assert signed.ends[1 - end].tags("a" * 16, 0, b"text", [bytes(32)]) is not None
    store.db.deserialize(copy)
    count.write_bytes(counted)
    for who in (end, 1 - end):
        second = signed.ends[who].tags("b" * 16, 0, b"other", [bytes(32)])
        assert first is not None
        assert second is not None
        assert second[2] != first[2]


def test_a_ledger_that_does_not_know_the_block_before_signs_nothing(signed: Signed) -> None:
    signed.block("a" * 16, 0)
    copy = signed.stores[0].db.serialize()
    signed.block("a" * 16, 1)
    signed.stores[0].db.deserialize(copy)
    assert signed.ends[0].tags("a" * 16, 2, b"text", [bytes(32)]) is None


# --- the polynomial attack ------------------------------------------------------------------------

Poly = list[int]
"""Coefficients modulo the prime, the constant first."""


def trimmed(f: Poly) -> Poly:
    while f and not f[-1]:
        f.pop()
    return f


def remainder(f: Poly, g: Poly) -> Poly:
    f = f[:]
    inverse = pow(g[-1], -1, PRIME)
    while len(f) >= len(g):
        factor, shift = f[-1] * inverse % PRIME, len(f) - len(g)
        for i, c in enumerate(g):
            f[shift + i] = (f[shift + i] - factor * c) % PRIME
        trimmed(f)
    return f


def common(f: Poly, g: Poly) -> Poly:
    while g:
        f, g = g, remainder(f, g)
    return f


def shifted(f: Poly, by: int) -> Poly:
    """f(x + by)."""
    out: Poly = []
    for c in reversed(f):
        moved = [0, *out]
        for i, one in enumerate(out):
            moved[i] = (moved[i] + by * one) % PRIME
        moved = moved or [0]
        moved[0] = (moved[0] + c) % PRIME
        out = moved
    return trimmed(out)


def equation(text: bytes, tag: str, pad: int) -> Poly:
    """What vanishes at the point, of a plant's tag whose text and pad are known."""
    data = b"plant/" + text
    words = [int.from_bytes(data[i : i + WORD_BYTES]) for i in range(0, len(data), WORD_BYTES)]
    f = [(pad - int(tag, 16)) % PRIME, len(data), *reversed(words)]
    return trimmed(f)


def broken(signed: Signed) -> tuple[int, int, str, bytes, int, int]:
    """Blocks 1 to 3 are heard whole: the point is found; block 4 is missed, 5 and 6 are not."""
    blocks = [signed.block("c" * 16, block) for block in range(7)]
    pads = [number(rows[0][TAG_BYTES:]) for _, rows, _ in blocks]
    adds = [number(rows[-1][:TAG_BYTES]) for _, rows, _ in blocks]
    second = equation(blocks[2][0], blocks[2][2], pads[1])
    third = equation(blocks[3][0], blocks[3][2], pads[2])
    renewed = ledger_module.RENEWS <= ROWS
    point = common(second, shifted(third, adds[2] if renewed else 0))
    assert len(point) == 2  # one candidate is left: x - point
    found = -point[0] * pow(point[1], -1, PRIME) % PRIME
    assert (polynomial(found, b"plant/" + blocks[2][0]) + pads[1]) % PRIME == int(blocks[2][2], 16)
    # what she knows of the point of block 6: block 5's row, and not that of block 4
    later = (found + (adds[2] + adds[3] + adds[5] if renewed else 0)) % PRIME
    text, _, shown = blocks[6]
    return later, pads[5], shown, text, adds[4], found


def test_three_blocks_heard_whole_give_the_point_until_one_is_missed(signed: Signed) -> None:
    later, pad, shown, text, missed, _ = broken(signed)
    forged = (polynomial(later, b"plant/" + text) + pad) % PRIME
    assert f"{forged:032x}" != shown
    true = (polynomial((later + missed) % PRIME, b"plant/" + text) + pad) % PRIME
    assert f"{true:032x}" == shown  # which is all that she lacks


def test_a_point_that_stays_is_known_for_ever(
    signed: Signed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("runtime.keys.ledger.RENEWS", 10_000)
    later, pad, shown, text, _, _ = broken(signed)
    forged = (polynomial(later, b"plant/" + text) + pad) % PRIME
    assert f"{forged:032x}" == shown
