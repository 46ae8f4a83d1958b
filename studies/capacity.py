"""Keys that are functions of the applied inputs, over blocks of steps: the chained code's sizes.

Theorem 5 of docs/findings.md states what bounds them, and how the code works. All bits here are
claimed by the paper's rule.
"""

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Any, Final

from studies.registry import Lines, Row, study, table

BLOCKS: Final = ((2.0, 50), (2.5, 40), (3.0, 40), (8.0, 10))
"""Alpha, and steps of a block."""

SHOWN: Final = 6
"""The first sizes of a row, in words."""


def chained_keys(alpha: float, steps: int) -> list[int]:
    """K_1, ..., K_T of the chained code: K_T = ceil(alpha K_(T-1)) - 1 from K_0 = 1.

    Whole numbers throughout, for K grows beyond what a float holds exactly.
    """
    exact = Fraction(alpha)
    out, keys = [], 1
    for _ in range(steps):
        keys = max(1, math.ceil(exact * keys) - 1)
        out.append(keys)
    return out


@study("block-codes", "alpha steps first_keys bits log2_alpha", lambda: BLOCKS)
def code_of(block: tuple[float, int]) -> Iterator[tuple[Any, ...]]:
    """The row of a code: bits are those of a step."""
    alpha, steps = block
    keys = chained_keys(alpha, steps)
    bits = math.log2(keys[-1]) / steps
    yield alpha, steps, " ".join(map(str, keys[:SHOWN])), bits, math.log2(alpha)


@table("block-codes", "findings", "block-codes")
def codes(rows: list[Row]) -> Lines:
    """Sizes and rates of the chained code."""
    lines = [["alpha", "K_1, K_2, ...", "bits a step", r"$\log_2 \alpha$"]]
    for row in rows:
        sizes = ", ".join(row["first_keys"].split())
        rate = f"{float(row['bits']):.3f} at T = {row['steps']}"
        lines.append([f"{float(row['alpha']):g}", sizes, rate, f"{float(row['log2_alpha']):.3f}"])
    return lines
