"""One-time tags: the field is one, and no forger passes more often than is stated."""

from studies.attacks.defences import TAGS


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
