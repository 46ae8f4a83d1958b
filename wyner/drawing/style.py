"""What the drawings share: the style, and how a figure is written."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from runtime.files import PUBLIC_FILE, replacing

STYLE: Final[dict[str, Any]] = {
    "svg.hashsalt": "wyner",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,  # TrueType: publishers refuse Type 3
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.markersize": 4,
}
"""Everything that a figure's bytes depend on besides its data and the library's version."""

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
MARKERS: Final = ("o", "s", "^", "D", "v", "P")
DPI: Final = 110


@contextmanager
def drawing(size: tuple[float, float]) -> Iterator[Figure]:
    """An empty figure of this size in inches; the style holds within."""
    style: dict[Any, Any] = {**mpl.rcParamsDefault, **STYLE}  # not the user's own
    with mpl.rc_context(style):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


KINDS: Final = (".png", ".pdf", ".svg")
"""Suffixes of what can be drawn."""

UNSIGNED: Final[dict[str, dict[str, None]]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}
"""Metadata that would differ from one drawing of a figure to the next."""


def save(figure: Figure, path: Path) -> None:
    """Write a figure as SVG, PDF or PNG, by the path's suffix, the same bytes each time.

    Raises
    ------
    OSError
        Also when ``path`` is there and is no regular file.
    """
    kind = path.suffix if path.suffix in UNSIGNED else ".png"
    with replacing(path, PUBLIC_FILE) as partial:
        figure.savefig(partial, format=kind[1:], dpi=DPI, metadata=UNSIGNED[kind])


def svg_of(size: tuple[float, float], draw: Callable[[Axes], None]) -> bytes:
    """What is drawn on one pair of axes, as SVG, the same bytes each time."""
    out = BytesIO()
    with drawing(size) as figure:
        draw(figure.subplots())
        figure.savefig(out, format="svg", metadata=UNSIGNED[".svg"])
    return out.getvalue()
