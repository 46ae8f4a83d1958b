"""The worked step of the documents: one agreed transition of a seeded run, numbers and picture.

``python -m tools.worked_step --write`` puts the numbers between their markers in
docs/tutorial.md and draws docs/figures/worked-step.svg; a test says when they are stale.
"""

import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from controller_service.laws.registry import cached_design
from protocol.agreement import predict
from protocol.link.session import CountedTransition
from protocol.scenario import Scenario
from runtime.errors import DONE, USAGE
from runtime.files import write_atomically
from runtime.scenario_file import scenario_of
from wyner.drawing.axes import draw_agreement
from wyner.drawing.style import drawing, save
from wyner.simulate.network import Simulation

DOCS: Final = Path(__file__).resolve().parents[1] / "docs"
PAGE: Final = DOCS / "tutorial.md"
PICTURE: Final = DOCS / "figures" / "worked-step.svg"

SEED: Final = 1
STEP: Final = 44
"""A transition of that run on which key symbol 1 is agreed, near the origin."""

BEGIN: Final = "<!-- begin numbers -->\n"
END: Final = "<!-- end numbers -->\n"


class Worked(NamedTuple):
    """The transition that agrees, the one after it, and the coin of the first."""

    scenario: Scenario
    agreed: CountedTransition
    carried: CountedTransition
    coin: int


def worked() -> Worked:
    """Run the scenario ``sustained`` to the step after the one that is told."""
    from controller_service.laws.registry import make_law

    scenario = scenario_of("sustained")
    law = make_law(scenario, cached_design(scenario))
    simulation = Simulation(scenario, law, seed=SEED, payloads=(b"The old mill, at nine.",))
    history = simulation.run(steps=STEP + 2)
    first, second = (list(history.plant.values())[j] for j in (STEP, STEP + 1))
    if first.symbol < 0 or second.message_symbol < 0:
        raise ValueError(f"transition {STEP}: expected one that agrees")
    return Worked(scenario, first, second, first.coin)


def _vector(v: Sequence[float]) -> str:
    return f"({', '.join(f'{value:.4f}' for value in v)})"


def numbers(step: Worked) -> str:
    """The table of the page, one line a quantity."""
    t, scenario = step.agreed, step.scenario
    alpha = scenario.secrecy.alpha
    rows = [("x(k)", _vector(t.x), "in the measurement: everyone reads it")]
    for i, u in enumerate(t.candidates):
        rows.append((f"u_{i}", f"{u[0]:.4f}", "in the offer: everyone reads it"))
    rows.append(("b_r", str(step.coin), "the plant's coin: nobody else knows it"))
    for i, u in enumerate(t.candidates):
        centre = predict(scenario.A, scenario.B, t.x, u)
        rows.append(
            (f"c_{i} = A x + B u_{i}", _vector(centre), "computed by everyone who knows A and B")
        )
    rows.append(("x(k+1)", _vector(t.x_next), "in the next measurement: everyone reads it"))
    for i, g in enumerate(t.verdict.gauges):
        means = "inside D_c" if g <= 1 else f"outside D_c, inside D_e (alpha = {alpha:g})"
        rows.append((f"g_{i}", f"{g:.4f}", means))
    rows.append(("key symbol", str(t.symbol), "the one candidate inside D_c"))
    c = step.carried
    rows.append(("ciphertext symbol of the next offer", str(c.cipher), "everyone reads it"))
    rows.append(
        (
            "message symbol",
            f"({c.cipher} - {c.key}) mod {len(t.candidates)} = {c.message_symbol}",
            "what the plant recovers",
        )
    )
    lines = ["| quantity | value | who knows it, or what it says |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| {a} | {b} | {text} |" for a, b, text in rows), ""])


def refreshed(page: str, step: Worked) -> str:
    """The page with its numbers made anew."""
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return head + BEGIN + numbers(step) + END + tail


def draw(step: Worked, path: Path) -> None:
    """Both centres, the next state, and the sets D_c and D_e around each centre; a closer look."""
    t, scenario = step.agreed, step.scenario
    widths = scenario.defender.disturbance.half_widths
    assert widths is not None
    centres = np.array([predict(scenario.A, scenario.B, t.x, u) for u in t.candidates])
    box = np.array(list(product((-1, 1), repeat=2))) * widths
    with drawing((8.4, 3.9)) as figure:
        wide, near = figure.subplots(1, 2)
        for axes in (wide, near):
            draw_agreement(axes, centres, np.array(t.x_next), box, scenario.secrecy.alpha * box)
            axes.set_xlabel("position x_1")
            axes.set_ylabel("speed x_2")
        near.set_xlim(centres[:, 0].min() - 2 * widths[0], centres[:, 0].max() + 2 * widths[0])
        near.set_ylim(centres[:, 1].min() - 2 * widths[1], centres[:, 1].max() + 2 * widths[1])
        wide.get_legend().remove()
        near.legend(fontsize=7, loc="lower right")
        wide.set_title("What Eve sees: both boxes D_e hold x(k+1)", fontsize=9)
        near.set_title("What the defender sees: one box D_c does", fontsize=9)
        save(figure, path)


def main(argv: Sequence[str]) -> int:
    """Print the numbers, or write page and picture."""
    if argv and list(argv) != ["--write"]:
        print("usage: python -m tools.worked_step [--write]", file=sys.stderr)
        return USAGE
    step = worked()
    if not argv:
        print(numbers(step))
        return DONE
    write_atomically(PAGE, refreshed(PAGE.read_text(encoding="utf-8"), step).encode())
    draw(step, PICTURE)
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
