"""One-time tags: the field is one, and no forger passes more often than is stated."""

import numpy as np

from studies.attacks.defences import TAGS, Mac


def test_the_large_polynomial_is_irreducible() -> None:
    """Rabin: x^(2^32) = x, and no common factor with x^(2^16) - x, 2 the only prime of 32."""

    def remainder(a: int, b: int) -> int:
        while a.bit_length() >= b.bit_length():
            a ^= b << (a.bit_length() - b.bit_length())
        return a

    powers = [2]
    for _ in range(32):
        powers.append(TAGS.multiply(powers[-1], powers[-1]))
    assert powers[32] == 2
    a, b = TAGS.polynomial, powers[16] ^ 2
    while b:
        a, b = b, remainder(a, b)
    assert a == 1


def test_a_message_with_its_tag_passes_and_no_other() -> None:
    mac, draw = Mac(2, 4), np.random.default_rng(7)
    session, step = mac.session_key(draw, (2000,)), mac.step_key(draw, (2000,))
    x = draw.normal(size=(2000, 2))
    wire = mac.encode(7, session, step, x)
    assert not mac.decode(7, session, step, wire).alarm.any()
    assert mac.decode(8, session, step, wire).alarm.all()  # replayed in another step
    changed = type(wire)(x + 1e-12, wire.tag)
    assert mac.decode(7, session, step, changed).alarm.all()
    other = mac.step_key(draw, (2000,))
    assert mac.decode(7, session, other, wire).alarm.all()
