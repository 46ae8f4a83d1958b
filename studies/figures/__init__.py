"""Every figure of docs/, each from its data files: SVG and PNG, the same bytes twice.

A figure's note states its runs, seeds and intervals, all read from the data.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from matplotlib.figure import Figure

from studies import DATA, FIGURES_FOLDER
from studies.figures import attacks, idea, keys, loop, network, noise, secrecy, signalling
from studies.figures.rows import FigureError
from wyner.drawing.style import drawing, save

__all__ = ["FIGURES", "FigureError", "draw"]


class Kind(NamedTuple):
    """One figure: how it is drawn, from which data files, and its size in inches."""

    draw: Callable[[Figure, Path], str]
    data: tuple[str, ...]
    size: tuple[float, float]


FIGURES: Final[dict[str, Kind]] = {
    "rate-paper": Kind(loop.draw_paper, ("fig7-paper", "fig7-paper-20"), (6.4, 4.2)),
    "rate-sustained": Kind(loop.draw_sustained, ("fig7-sustained", "sustained-long"), (6.4, 4.2)),
    "distance": Kind(loop.draw_distance, ("distance",), (6.4, 4.0)),
    "disturbances": Kind(loop.draw_disturbances, ("disturbances", "taps"), (9.0, 4.2)),
    "price": Kind(loop.draw_price, ("price",), (8.0, 3.8)),
    "plants": Kind(loop.draw_plants, ("settled", "widths"), (8.0, 3.8)),
    "sets": Kind(loop.draw_sets, ("sets",), (9.0, 4.4)),
    "idea": Kind(idea.draw_idea, ("sets",), (9.0, 3.6)),
    "secrecy-alpha": Kind(secrecy.draw_alpha, ("secrecy-alpha",), (7.0, 3.8)),
    "secrecy-alpha-bits": Kind(secrecy.draw_alpha_bits, ("secrecy-alpha",), (7.0, 3.8)),
    "secrecy-shape": Kind(secrecy.draw_shapes, ("secrecy-shape",), (6.4, 3.6)),
    "secrecy-learning": Kind(secrecy.draw_learning, ("secrecy-learning",), (7.0, 3.8)),
    "secrecy-view": Kind(secrecy.draw_views, ("secrecy-view",), (7.5, 4.2)),
    "signalling-rates": Kind(signalling.draw_rates, ("signalling-rates", "fig7-paper"), (7.4, 4.6)),
    "signalling-price": Kind(signalling.draw_price, ("signalling-price",), (8.0, 3.8)),
    "two-step": Kind(signalling.draw_codes, ("two-step",), (6.4, 3.8)),
    "block-codes": Kind(signalling.draw_blocks, ("block-codes",), (6.8, 4.2)),
    "noise-bound": Kind(noise.draw_bound, ("noise-bound",), (8.0, 4.0)),
    "network": Kind(network.draw_network, ("network",), (7.4, 5.0)),
    "key-controls": Kind(keys.draw_controls, ("key-controls",), (7.4, 4.6)),
    "undetected": Kind(attacks.draw_undetected, ("attacks",), (6.4, 3.8)),
    "dither-price": Kind(attacks.draw_dither, ("dither-price",), (6.4, 3.8)),
}
"""The figures, in the order of the pages: findings, control, keys, attacks."""


def draw(name: str, data: Path = DATA, output: Path = FIGURES_FOLDER) -> tuple[Path, Path]:
    """Draw one figure; returns the paths of its SVG and its PNG.

    Raises
    ------
    FigureError
        When its data cannot be read or are not complete.
    """
    kind = FIGURES[name]
    output.mkdir(parents=True, exist_ok=True)
    svg, png = output / f"{name}.svg", output / f"{name}.png"
    with drawing(kind.size) as figure:
        try:
            note = kind.draw(figure, data)
        except (ArithmeticError, LookupError, StopIteration, TypeError, ValueError) as error:
            files = " or ".join(str(data / f"{file}.csv") for file in kind.data)
            raise FigureError(f"{files}: does not have what the figure shows") from error
        figure.supxlabel(note, fontsize=6.5, color="0.35")
        save(figure, svg)
        save(figure, png)
    return svg, png
