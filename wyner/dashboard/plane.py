"""The paper's Fig. 4 for one real step, in characters.

The plane of two state components is cut through the next state: there a point lies inside the drawn
D_c of a candidate exactly where the agreement test says so. The outline of D_c around each centre
c_i = A x + B u_i is solid, that of D_e dotted; where D_e goes on beyond the frame, arrows say so.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array
from protocol.convex import corners
from protocol.messages import PlantModel, PlantStatus
from wyner.dashboard.text import symbol_of

MARGIN: Final = 0.06
"""Share of the frame that is left free around what is drawn."""

FAR: Final = 1e150
"""Coordinates from here on are not drawn: their squares overflow."""

_BRAILLE: Final = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""The bit of each of the two by four dots of a character."""


Dots = NDArray[np.bool_]
"""Which dots of the picture belong to something: four rows and two columns a character."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One character of the picture, and the style that it is drawn in."""

    character: str
    style: str = ""


@dataclass(frozen=True, slots=True)
class Axes:
    """The two state components drawn, counted from 0: across and up; up is -1 for n = 1."""

    across: int
    up: int

    @property
    def words(self) -> str:
        """The axes as a reader counts them."""
        up = f", vertical x{self.up + 1}" if self.up >= 0 else ""
        return f"horizontal x{self.across + 1}{up}"

    @property
    def short(self) -> str:
        """The same in fewer characters."""
        across = f"x{self.across + 1}"
        return f"x{self.up + 1} against {across}" if self.up >= 0 else across


def axes_of(model: PlantModel) -> Axes:
    """The axes along which an input moves the state furthest, measured in widths of D_c."""
    moved = np.abs(np.array(model.B)).sum(axis=1) / _reach(model)
    order = np.argsort(-moved, kind="stable")
    return Axes(int(order[0]), int(order[1]) if len(order) > 1 else -1)


def _reach(model: PlantModel) -> Array:
    """Distance from the centre of D_c to its edge along each axis."""
    H, h = np.array(model.defender_H), np.array(model.defender_h)
    with np.errstate(divide="ignore"):
        edges = np.where(H > 0, h[:, None] / H, np.inf).min(axis=0)
    return np.where(np.isfinite(edges), edges, 1.0)


def spread(model: PlantModel) -> float:
    """How many times D_c must be scaled to hold D_e: alpha, where it has no shape of its own."""
    if not model.eavesdropper_H or len(model.A) > 4:
        return model.alpha
    ends = corners(model.eavesdropper_H, model.eavesdropper_h)
    gauges = ends @ np.array(model.defender_H).T / np.array(model.defender_h)
    return float(gauges.max())


def fits(model: PlantModel, status: PlantStatus) -> bool:
    """Whether the pictured step can be one of this model's; another plant may have spoken."""
    states, inputs = len(model.A), len(model.B[0])
    return len(status.pictured_x) == states and all(
        len(u) == inputs for u in status.pictured_candidates
    )


def draw(model: PlantModel, status: PlantStatus, width: int, height: int) -> list[list[Cell]]:
    """The pictured transition, which fits the model, as ``height`` rows of ``width`` cells.

    Blank before the first one, and where it is too far out.
    """
    blank = [[Cell(" ")] * width for _ in range(height)]
    if status.pictured_k < 0 or not status.pictured_candidates or width < 4 or height < 2:
        return blank
    axes = axes_of(model)
    A, B = np.array(model.A), np.array(model.B)
    x_next = np.array(status.pictured_x_next)
    with np.errstate(over="ignore", invalid="ignore"):
        centres = A @ status.pictured_x + np.array(status.pictured_candidates) @ B.T
        reach = _reach(model)
        points = np.vstack([centres - reach, centres + reach, x_next])
        low, high = points.min(axis=0), points.max(axis=0)
        room = MARGIN * (high - low)
        low, high = low - room, high + room
    if not (np.abs(points) < FAR).all():
        return blank
    across = np.linspace(low[axes.across], high[axes.across], 2 * width)
    # With one state the second axis is empty, and the sets are intervals.
    up = np.linspace(high[axes.up], low[axes.up], 4 * height) if axes.up >= 0 else np.zeros(4)

    def inside(H: Array, h: Array, centre: Array) -> Dots:
        """Which dots of the frame a set around a centre holds."""
        here = (H @ (x_next - centre))[:, None, None]
        moved = H[:, axes.across][:, None, None] * (across - x_next[axes.across])[None, None, :]
        if axes.up >= 0:
            risen = H[:, axes.up][:, None, None] * (up - x_next[axes.up])[None, :, None]
        else:
            risen = np.zeros((1, 4 * height, 1))
        return np.asarray((here + moved + risen <= h[:, None, None]).all(axis=0), dtype=bool)

    H, h = np.array(model.defender_H), np.array(model.defender_h)
    own = bool(model.eavesdropper_H)
    H_e = np.array(model.eavesdropper_H) if own else H
    h_e = np.array(model.eavesdropper_h) if own else model.alpha * h
    solid = np.zeros((4 * height, 2 * width), dtype=bool)
    dotted, wide = solid.copy(), solid.copy()
    for centre in centres:
        solid |= _outline(inside(H, h, centre))
        hers = inside(H_e, h_e, centre)
        wide |= hers
        dotted |= _outline(hers)
    dotted &= np.indices(dotted.shape).sum(axis=0) % 2 == 0
    cells = _braille(solid, dotted)
    if wide[:, 0].any():
        cells[height // 2][0] = Cell("◀", "eavesdropper")
    if wide[:, -1].any():
        cells[height // 2][-1] = Cell("▶", "eavesdropper")
    taken: set[tuple[int, int]] = set()

    def put(point: Array, character: str, style: str) -> None:
        """Mark where a point lies, or beside it where another mark stands."""
        column = int(np.abs(across - point[axes.across]).argmin()) // 2
        line = int(np.abs(up - point[axes.up]).argmin()) // 4 if axes.up >= 0 else height // 2
        for step in (0, 1, -1, 2, -2):
            place = (line, column + step)
            if 0 <= place[1] < width and place not in taken:
                taken.add(place)
                cells[line][place[1]] = Cell(character, style)
                return

    put(x_next, "●", "next")
    for i, centre in enumerate(centres):
        name = symbol_of(i, len(centres))
        put(centre, name if len(name) == 1 else "+", "centre")
    return cells


def _outline(inside: Dots) -> Dots:
    """The dots of a set that have a neighbour outside; what the frame cuts off has no edge."""
    padded = np.pad(inside, 1, mode="edge")
    whole = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return np.asarray(inside & ~whole, dtype=bool)


def _braille(solid: Dots, dotted: Dots) -> list[list[Cell]]:
    """Dots as characters of two by four of them."""
    height, width = solid.shape[0] // 4, solid.shape[1] // 2
    cells = []
    for y in range(height):
        row = []
        for x in range(width):
            place = (slice(4 * y, 4 * y + 4), slice(2 * x, 2 * x + 2))
            bits = int(_BRAILLE[solid[place] | dotted[place]].sum())
            style = "defender" if solid[place].any() else "eavesdropper"
            row.append(Cell(chr(0x2800 + bits), style) if bits else Cell(" "))
        cells.append(row)
    return cells
