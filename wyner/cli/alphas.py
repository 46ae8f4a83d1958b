"""``wyner design --alphas``: how many symbols a scenario's inputs can carry, and at what price."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from protocol.statistics import COMPUTED
from runtime.errors import DONE, UsageError
from wyner.cli.figure_file import save_table

if TYPE_CHECKING:
    from protocol.scenario import Scenario
    from wyner.capacity.table import Capacity

ALPHAS: Final = (1.5, 2.0, 2.5, 3.0, 3.01, 4.0, 5.0, 5.01, 6.0, 7.0, 7.01, 8.0, 9.01, 10.0)

TRUE: Final = (
    "counted by the paper's rule; of all of it an eavesdropper who takes the prediction nearest in "
    "the shape of D_c leaves 0 bits, and she knows when: always"
)

VOID: Final = (
    "for keys that are functions of the applied input: where a key may depend on x(k+1) too, the "
    "rule allows any number at any alpha above 1, and true are 0 (docs/findings.md)"
)


ABOUT: Final = (
    "For each alpha: the largest alphabet of which every transition agrees, what the inputs and "
    "the plant's unstable modes leave of it, its bits, the best bet on the scenario's own "
    "disturbance, the upper bounds, and what the alphabet adds to state and input."
)


def show_alphas(scenario: "Scenario", asked: str, *, as_json: bool, figure: str | None) -> int:
    """Show the table; ``asked`` has the alphas, separated by commas, or is empty."""
    from controller_service.sets.design import SynthesisError
    from wyner.capacity.table import capacity

    alphas = _alphas(asked, scenario.secrecy.alpha)
    if figure and Path(figure).suffix not in (".svg", ".png"):
        raise UsageError(f"--plot: got {figure!r}, expected a name in .svg or .png")
    try:
        table = capacity(scenario, alphas)
    except SynthesisError as error:
        raise UsageError(f"{scenario.name}: {error}") from None
    result = describe(scenario, table)
    print(json.dumps(result) if as_json else render(result))
    if figure:
        save_table(figure, "wyner.drawing.capacity:draw_table", result)
    return DONE


def _alphas(text: str, own: float) -> list[float]:
    if not text:
        return sorted({*ALPHAS, own})
    try:
        alphas = sorted({float(part) for part in text.split(",")})
    except ValueError:
        alphas = []
    if not alphas or not all(1 <= a <= 1000 for a in alphas):
        raise UsageError(f"--alphas: got {text!r}, expected numbers from 1 to 1000, as in 3.01,8")
    return alphas


def describe(scenario: "Scenario", table: "Capacity") -> dict[str, Any]:
    """The table as one object for machines."""
    price = table.price
    return {
        "scenario": scenario.name,
        "inputs": scenario.m,
        "period_s": scenario.plant.period_s,
        "rule": TRUE,
        "no_interval": COMPUTED,
        "class": VOID,
        "spacing": table.sigma,
        "ceilings": [
            {"mode": c.magnitude, "room": c.room, "vector": list(c.vector)} for c in table.ceilings
        ],
        "price": None if price is None else {"state": price.state, "input": price.input},
        "alphas": [
            {
                "alpha": row.alpha,
                "candidates": row.held,
                "bits_per_step": row.bits,
                "bits_per_second": row.bits / scenario.plant.period_s,
                "certain_candidates": row.certain,
                "bound_candidates": row.bound,
                "bet": None if row.bet is None else row.bet._asdict(),
                "long_alphabets_bits": row.erasures,
                "blocks_bits": row.chained,
                "volume_bits": row.volume,
                "added_state": row.state_price,
                "added_input": row.input_price,
            }
            for row in table.rows
        ],
    }


def render(r: dict[str, Any]) -> str:
    """The object in lines for people."""
    lines = [
        f"{r['scenario']}: {r['inputs']} input(s), a step every {r['period_s']:g} s; no figure has "
        f"an interval: {r['no_interval']}",
        r["rule"],
        r["class"],
    ]
    if r["spacing"] is not None and math.isfinite(r["spacing"]):
        lines.append(f"candidates {r['spacing']:.6g} apart are told apart with certainty")
    lines += [
        f"mode {c['mode']:.6g}: the alphabet reaches at most {c['room']:.4g} along it, or control "
        "has nothing left"
        for c in r["ceilings"]
    ]
    if r["price"] is not None:
        kx, ku = (", ".join(f"{v:.3g}" for v in r["price"][k]) for k in ("state", "input"))
        lines.append(f"dither of variance 1 on an input adds {kx} to |x|^2 and {ku} to |u|^2")
    lines.append(
        f"{'alpha':>7} {'M':>5} {'bit/step':>9} {'bit/s':>8} {'bound M':>8} {'bet':>16} "
        f"{'long':>6} {'volume':>7} {'+|x|^2':>9} {'+|u|^2':>9}"
    )
    for row in r["alphas"]:
        bet = row["bet"]
        shown = "-" if bet is None else f"{bet['bits']:.3f} ({bet['size']}, {bet['spacing']:.3f})"
        long = "-" if row["long_alphabets_bits"] is None else f"{row['long_alphabets_bits']:.3f}"
        added = ["-" if row[k] is None else f"{row[k]:.4g}" for k in ("added_state", "added_input")]
        lines.append(
            f"{row['alpha']:>7g} {row['candidates']:>5} {row['bits_per_step']:>9.3f} "
            f"{row['bits_per_second']:>8.3g} {row['bound_candidates']:>8} {shown:>16} {long:>6} "
            f"{row['volume_bits']:>7.3f} {added[0]:>9} {added[1]:>9}"
        )
    lines += [
        "M: the most candidates of which every transition agrees, within U and control's ceiling",
        "bound M: no certain alphabet is larger; bet: the best for this plant's own disturbance, "
        "with its M and spacing",
        "long: supremum of long alphabets, certain but at their ends; volume: log2 of alpha an "
        "input, the bound of all offsets fixed in advance, which codes over many steps reach from "
        "alpha > 2 on (one input)",
    ]
    if any(row["certain_candidates"] > row["candidates"] for row in r["alphas"]):
        lines.append("at the largest alphas U or control's ceiling, not alpha, limits M")
    return "\n".join(lines)
