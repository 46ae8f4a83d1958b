"""Every figure of docs/, each from its data files: SVG, the same bytes twice.

A figure's note states its runs, seeds and intervals, all read from the data.
"""

from pathlib import Path

from studies import DATA, FIGURES_FOLDER
from studies.figures import attacks, idea, loop, network, noise, secrecy, signalling
from studies.figures.rows import FIGURES
from wyner.drawing.style import drawing, save

__all__ = ["FIGURES", "attacks", "draw", "idea", "loop", "network", "noise",
           "secrecy", "signalling"]  # fmt: skip


def draw(name: str, data: Path = DATA, output: Path = FIGURES_FOLDER) -> Path:
    """Draw one figure; returns the path of its SVG."""
    kind = FIGURES[name]
    output.mkdir(parents=True, exist_ok=True)
    path = output / f"{name}.svg"
    with drawing(kind.size) as figure:
        figure.supxlabel(kind.draw(figure, data), fontsize=6.5, color="0.35")
        save(figure, path)
    return path
