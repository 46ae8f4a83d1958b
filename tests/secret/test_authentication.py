"""Tags under one-time pads, and the first secret."""

import random
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.secret.authentication import PADS_BYTES, PRIME, RESERVE, Secret, polynomial, tag
from protocol.secret.extractor import cauchy, extract
from protocol.secret.galois import multiply
from runtime.keys.secret_file import SecretError, make_secret, read_secret, spend_secret

TEXTS = st.binary(max_size=100)


@given(TEXTS, TEXTS)
def test_the_polynomial_tells_any_two_texts_apart_at_nearly_every_point(a: bytes, b: bytes) -> None:
    if a != b:
        points = [pow(3, i, PRIME) for i in range(1, 12)]
        same = sum(polynomial(z, a) == polynomial(z, b) for z in points)
        assert same <= 1  # at most eight of 2^127 - 1 points are roots of the difference


@given(TEXTS, st.integers(1, PRIME - 1))
def test_the_polynomial_is_the_sum_of_its_terms(text: bytes, point: int) -> None:
    words = [int.from_bytes(text[i : i + 15]) for i in range(0, len(text), 15)] + [len(text)]
    terms = (w * pow(point, len(words) - i, PRIME) for i, w in enumerate(words))
    assert polynomial(point, text) == sum(terms) % PRIME


def test_a_tag_is_hidden_by_its_pad() -> None:
    assert tag(5, 0, b"x") != tag(5, 1, b"x")
    shown = int(tag(5, 123, b"x"), 16)
    assert (shown - 123) % PRIME == polynomial(5, b"x")


def test_a_secret_serves_one_store_once(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    name = make_secret(path)
    assert path.stat().st_mode & 0o777 == 0o600
    secret = read_secret(path)
    assert isinstance(secret, Secret)
    assert secret.name == name
    assert len(set(secret.sets)) == RESERVE
    assert {len(one) for one in secret.sets} == {PADS_BYTES}
    spend_secret(path, name)
    assert read_secret(path) == name
    assert len(path.read_bytes()) < 60


def test_a_secret_is_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    make_secret(path)
    with pytest.raises(SecretError, match="is there already"):
        make_secret(path)


@pytest.mark.parametrize("text", ["", "nothing", "wyner-secret-1 a 00", "wyner-secret-1 a zz"])
def test_what_is_no_secret_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "secret"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(SecretError, match=r"secret: expected [^\n]*$"):
        read_secret(path)


def test_a_secret_that_others_may_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    make_secret(path)
    path.chmod(0o640)
    with pytest.raises(SecretError, match="got mode 640, expected 600"):
        read_secret(path)
    with pytest.raises(SecretError, match="cannot be read"):
        read_secret(tmp_path / "none")


def test_a_forger_cancels_a_public_tag_and_not_a_secret_one() -> None:
    """Two nonces changed so that row 0 stays: the public tag holds, the ends' keys differ."""
    generator = random.Random(1)
    nonces = [generator.randbytes(32) for _ in range(20)]
    G = cauchy(1, 20)
    caught = 0
    for _ in range(50):
        forged = list(nonces)
        i, j = generator.sample(range(20), 2)
        change = generator.randrange(1, 1 << 16)
        other = int(
            multiply(
                multiply(G[0, i], change),  # type: ignore[arg-type]
                _inverse(int(G[0, j])),  # type: ignore[arg-type]
            )
        )
        forged[i] = _changed(forged[i], change)
        forged[j] = _changed(forged[j], other)
        mine, theirs = extract(nonces, 6), extract(forged, 6)
        assert mine[0] == theirs[0]
        assert mine[1:] != theirs[1:]
        secret, pad = generator.randrange(PRIME), generator.randrange(PRIME)
        caught += tag(secret, pad, b"".join(nonces)) != tag(secret, pad, b"".join(forged))
    assert caught == 50


def _inverse(a: int) -> int:
    from protocol.secret.galois import ORDER, tables

    exp, log = tables()
    return int(exp[ORDER - int(log[a])])


def _changed(nonce: bytes, change: int) -> bytes:
    return (int.from_bytes(nonce[:2]) ^ change).to_bytes(2) + nonce[2:]
