"""``wyner design --noise``: bits that any tap leaves who watches the machine through noise."""

import argparse
import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from protocol.statistics import PROVED
from runtime.errors import DONE, UsageError
from wyner.cli.figure_file import save_table

if TYPE_CHECKING:
    from protocol.scenario import Scenario
    from wyner.bound.loop import LinearLoop

RATIOS: Final = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Noise over the smallest half-width of D_c, where none is named."""

CLAIM: Final = (
    "a claim, as every statement of what she hears is: that her noise is at least this, white and "
    "Gaussian, is stated and audited, never proved"
)
LOOP: Final = (
    "for the linear law u = K x + p of the scenario's regulator, started in its invariant set, and "
    "not for the programs of the law 'packed'"
)
MOST_BLOCKS: Final = 4096
DRAWS: Final = 2000
SEED: Final = 7


ABOUT: Final = (
    "For each noise: the bits of a coin that any tap leaves who watches the states through it, "
    "whatever she knows and computes; and the length of the key that a 2-universal hash makes of "
    "the coins."
)


@dataclass(frozen=True, kw_only=True)
class NoiseOptions:
    """What is asked about her who watches.

    Parameters
    ----------
    noise : str, optional
        Standard deviations on every number that she reads, separated by commas; or empty. None:
        nothing is asked.
    watch : str, optional
        The states that she sees, from 1 on; all if not given.
    offers : str
        What she hears of them: ``none``, ``noisy`` or ``clear``.
    coins : int
        Coins of one key.
    eps : float
        Its distance from uniform.
    measure : bool
        Whether to measure a tap beside the bound.
    """

    noise: str | None = None
    watch: str | None = None
    offers: Literal["none", "noisy", "clear"] = "none"
    coins: int = 1000
    eps: float = 1e-12
    measure: bool = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of this view of a design."""
    group = parser.add_argument_group("bits left from any tap who sees through noise", ABOUT)
    group.add_argument(
        "--noise",
        nargs="?",
        const="",
        metavar="S,S,...",
        help="instead: this, for these deviations of what she reads (default: 0.5 to 4 half-widths "
        "of D_c)",
    )
    group.add_argument(
        "--watch", metavar="I,I,...", help="the states that she sees, from 1 on (default: all)"
    )
    group.add_argument(
        "--offers",
        choices=("none", "noisy", "clear"),
        default="none",
        help="what she hears of them (default: none); clear leaves 0 bits",
    )
    group.add_argument("--coins", type=int, default=1000, metavar="N", help="coins of one key")
    group.add_argument(
        "--eps", type=float, default=1e-12, metavar="E", help="distance of the key from uniform"
    )
    group.add_argument(
        "--measure",
        action="store_true",
        help="beside it what a tap leaves who weighs every sequence of a block (seconds)",
    )


def refuse_alone(asked: NoiseOptions) -> None:
    """Refuse what was asked about her noise where ``--noise`` was not.

    Raises
    ------
    UsageError
    """
    usual = NoiseOptions()
    for field in fields(asked):
        value = getattr(asked, field.name)
        if value != getattr(usual, field.name):
            raise UsageError(f"--{field.name}: got {value!r}, expected --noise beside it")


def show_noise(
    scenario: "Scenario", asked: NoiseOptions, *, as_json: bool, figure: str | None
) -> int:
    """Show the table."""
    from wyner.bound.loop import BoundError, LinearLoop

    if figure and Path(figure).suffix not in (".svg", ".png"):
        raise UsageError(f"--plot: got {figure!r}, expected a name in .svg or .png")
    if not 1 <= asked.coins <= 10_000_000:
        raise UsageError(f"--coins: got {asked.coins}, expected 1 to 10000000")
    if not 0 < asked.eps < 1:
        raise UsageError(f"--eps: got {asked.eps:g}, expected between 0 and 1")
    states = _states(asked.watch, scenario.n)
    try:
        loop = LinearLoop.of(scenario)
    except BoundError as error:
        raise UsageError(f"{scenario.name}: {error}") from None
    if asked.measure and (asked.offers != "none" or states):
        raise UsageError("--measure: expected all states and no offers")
    noises = _noises(asked.noise, loop.half_width)
    result = describe(scenario, loop, noises, asked, states)
    print(json.dumps(result) if as_json else render(result))
    if figure:
        save_table(figure, "wyner.drawing.bound:draw_table", result)
    return DONE


def _noises(text: str | None, half_width: float) -> list[float]:
    if not text:
        return [r * half_width for r in RATIOS]
    try:
        noises = sorted({float(part) for part in text.split(",")})
    except ValueError:
        noises = []
    if not noises or not all(0 <= s <= 1e9 for s in noises):
        raise UsageError(f"--noise: got {text!r}, expected numbers of 0 or more, as in 0.06,0.12")
    return noises


def _states(text: str | None, n: int) -> tuple[int, ...]:
    if text is None:
        return ()
    parts = text.split(",")
    if not all(part.strip().isdecimal() and 1 <= int(part) <= n for part in parts):
        raise UsageError(f"--watch: got {text!r}, expected states from 1 to {n}, as in 1,2")
    return tuple(sorted({int(part) - 1 for part in parts}))


def describe(
    scenario: "Scenario",
    loop: "LinearLoop",
    noises: list[float],
    asked: NoiseOptions,
    states: tuple[int, ...],
) -> dict[str, Any]:
    """The table as one object for machines."""
    import math

    import numpy as np

    from protocol.statistics import normal
    from wyner.bound.taps import block_left

    M = len(loop.offsets)
    active = loop.used > 1
    why = ""
    if active:
        why = (
            f"control.inputs: the linear law may need {loop.used:.3g} times U: where a constraint "
            "is active the response is not linear, and nothing is left for certain"
        )
    elif asked.offers == "clear":
        why = "offers in clear carry K x, and so every coin: nothing is left"
    rows = []
    for noise in noises:
        coin = loop.coin(noise, asked.offers, states)
        row: dict[str, Any] = {
            "noise": noise,
            "ratio": noise / loop.half_width,
            "gain": 1 / coin.deviation if coin.deviation else None,
            "guess": 1.0 if active else coin.guess,
            "bits_per_coin": 0.0 if active else coin.bits,
            "key_bits": 0 if active else coin.key_bits(asked.coins, asked.eps),
            "measured": None,
        }
        if asked.measure and not active and noise > 0:
            coins = max(1, int(math.log(MOST_BLOCKS, M) + 1e-9))
            widths = np.array(scenario.plant.disturbance.half_widths)
            left = block_left(loop, widths, noise, coins, DRAWS, SEED, told=False)
            interval = normal(left.bits, left.bits_error)
            row["measured"] = {
                "bits_per_coin": left.bits,
                "interval_95": [interval.low, interval.high],
                "coins": coins,
                "blocks": DRAWS,
                "seed": SEED,
            }
        rows.append(row)
    return {
        "scenario": scenario.name,
        "claimed_bits": math.log2(M),
        "candidates": M,
        "claim": CLAIM,
        "loop": LOOP,
        "nothing_because": why or None,
        "most_of_U": loop.used,
        "offers": asked.offers,
        "watched": [i + 1 for i in states] or list(range(1, len(loop.A) + 1)),
        "coins": asked.coins,
        "eps": asked.eps,
        "no_interval": {"guess": PROVED, "bits_per_coin": PROVED, "key_bits": PROVED},
        "rows": rows,
    }


def render(r: dict[str, Any]) -> str:
    """The object in lines for people."""
    watched = ", ".join(f"x{i}" for i in r["watched"])
    lines = [
        f"{r['scenario']}: {r['candidates']} candidates, {r['claimed_bits']:.3g} bits a step "
        "claimed by the paper's rule",
        f"left by any tap who watches {watched} through noise; offers: {r['offers']}",
        r["loop"],
        r["claim"],
    ]
    if r["nothing_because"]:
        lines.append(f"0 bits: {r['nothing_because']}")
    measured = any(row["measured"] for row in r["rows"])
    head = f"{'noise':>9} {'/ D_c':>6} {'gain':>8} {'P_g':>7} {'bit/coin':>9} {'key, bit':>9}"
    lines.append(head + ("  measured, bit/coin" if measured else ""))
    for row in r["rows"]:
        gain = "-" if row["gain"] is None else f"{row['gain']:.3f}"
        line = (
            f"{row['noise']:>9.4g} {row['ratio']:>6.3g} {gain:>8} {row['guess']:>7.4f} "
            f"{row['bits_per_coin']:>9.3f} {row['key_bits']:>9}"
        )
        if row["measured"]:
            low, high = row["measured"]["interval_95"]
            line += f"  {row['measured']['bits_per_coin']:.3f} [{low:.3f}, {high:.3f}]"
        lines.append(line)
    lines.append("P_g, bit/coin and key are proved bounds: no interval")
    lines.append(
        f"key: of {r['coins']} coins, within {r['eps']:g} of uniform (sum of absolute differences)"
    )
    if measured:
        one = next(row["measured"] for row in r["rows"] if row["measured"])
        lines.append(
            f"measured: a tap who knows model, law and the deviation of d, blocks of "
            f"{one['coins']} coins, {one['blocks']} blocks, seed {one['seed']}, 95 % intervals"
        )
    return "\n".join(lines)
