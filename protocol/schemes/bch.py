"""Binary BCH codes of length 2^m - 1: the syndrome of a word, and the errors that explain one.

The polynomials x^5 + x^2 + 1 and x^6 + x + 1 are the usual primitive ones (Lin and Costello, *Error
Control Coding*, appendix A). Words are whole numbers, bit i the coefficient of x^i.
"""

from functools import cached_property
from typing import Final

PRIMITIVE: Final = {5: 0b100101, 6: 0b1000011}


class BCH:
    """A narrow-sense BCH code that corrects up to t errors.

    Parameters
    ----------
    m : int
        The length is n = 2^m - 1.
    t : int
        Errors that it corrects.
    """

    def __init__(self, m: int, t: int) -> None:
        self.n, self.t = (1 << m) - 1, t
        self._power, value = [], 1
        for _ in range(self.n):
            self._power.append(value)
            value <<= 1
            if value > self.n:
                value ^= PRIMITIVE[m]
        self._log = {value: i for i, value in enumerate(self._power)}

    @cached_property
    def generator(self) -> int:
        """The least polynomial with zeros a, a^2, ..., a^(2 t)."""
        zeros = {(j << i) % self.n for j in range(1, 2 * self.t) for i in range(self.n)}
        product = [1]  # of all x - a^z, lowest coefficient first
        for zero in zeros:
            root = self._power[zero]
            times = [self._product(c, root) for c in product]
            product = [a ^ b for a, b in zip([0, *product], [*times, 0], strict=True)]
        return sum(c << i for i, c in enumerate(product))

    @property
    def check_bits(self) -> int:
        """n - k, the bits of a syndrome."""
        return self.generator.bit_length() - 1

    def syndrome(self, word: int) -> int:
        """The remainder of a word's polynomial: 0 of the code's words alone."""
        for i in reversed(range(self.check_bits, self.n)):
            if word >> i & 1:
                word ^= self.generator << (i - self.check_bits)
        return word

    def errors(self, syndrome: int) -> int | None:
        """The word of at most t bits that has this syndrome; None where there is none."""
        values = [self._at(syndrome, j) for j in range(1, 2 * self.t + 1)]
        locator = self._locator(values)
        places = [i for i in range(self.n) if not self._value(locator, self._power[-i % self.n])]
        if not len(places) == len(locator) - 1 <= self.t:
            return None
        found = sum(1 << i for i in places)
        return found if self.syndrome(found) == syndrome else None

    def _locator(self, values: list[int]) -> list[int]:
        """Berlekamp and Massey: the shortest recurrence of the values, lowest coefficient first."""
        now, before = [1], [1]
        length, shift, last = 0, 1, 1
        for i, value in enumerate(values):
            off = value
            for j in range(1, min(length, len(now) - 1) + 1):
                off ^= self._product(now[j], values[i - j])
            if not off:
                shift += 1
                continue
            factor = self._product(off, self._power[-self._log[last] % self.n])
            change = [0] * shift + [self._product(factor, c) for c in before]
            wide = max(len(now), len(change))
            following = [
                a ^ b
                for a, b in zip(
                    now + [0] * (wide - len(now)), change + [0] * (wide - len(change)), strict=True
                )
            ]
            if 2 * length <= i:
                length, before, last, shift = i + 1 - length, now, off, 1
            else:
                shift += 1
            now = following
        while not now[-1]:
            now.pop()
        return now

    def _at(self, word: int, j: int) -> int:
        """The word's polynomial at a^j."""
        total = 0
        for i in range(word.bit_length()):
            if word >> i & 1:
                total ^= self._power[i * j % self.n]
        return total

    def _value(self, polynomial: list[int], x: int) -> int:
        total = 0
        for c in reversed(polynomial):
            total = self._product(total, x) ^ c
        return total

    def _product(self, a: int, b: int) -> int:
        if not (a and b):
            return 0
        return self._power[(self._log[a] + self._log[b]) % self.n]
