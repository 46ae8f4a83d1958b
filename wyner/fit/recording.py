"""A, B and D_c from a recording of a plant: a table with a column for each state and input.

The recording is cut into three parts in the order of time. The first identifies A and B. The second
scales D_c by split conformal prediction, and the third, which nothing was fitted to, says how often
a step leaves it.
"""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from protocol.arrays import Array
from runtime.files import read_regular
from wyner.fit.conformal import conformal_scale, template, violation_bound
from wyner.fit.identification import WITHIN, FitError, FittedModel, identify

PARTS: Final = (0.5, 0.75)
"""Where the recording is cut: half of it identifies, a quarter scales, a quarter is held out."""

DEPENDENT: Final = 0.999
"""Share of an input's variance from which on the states and other inputs are said to explain it."""

OFFSET: Final = 0.2
"""Half-widths of D_c that zero states move by, from which on it is said."""

ALIKE: Final = 0.2
"""Correlation of neighbouring scores from which on it is said that they are not independent."""


@dataclass(frozen=True, eq=False)
class PlantRecording:
    """The steps that were recorded whole, in the order of time.

    Parameters
    ----------
    states, inputs : tuple of str
        Names of the columns.
    x, u, after : array, shapes (T, n), (T, m), (T, n)
        A step's state, the input that was applied in it, and the state after it.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    x: Array
    u: Array
    after: Array


@dataclass(frozen=True, eq=False)
class RecordedFit:
    """What a recording says of its plant.

    Parameters
    ----------
    model : FittedModel
    half_widths : array, shape (n,)
        D_c, a box.
    steps : dict of str to int
        Steps that were ``identified``, ``scaled``, and ``held_out``.
    exceeded : int
        Steps held out that left D_c.
    violation : float
        Upper bound of the probability that a step leaves D_c, if the steps held out are
        independent and alike to those to come.
    warnings : list of str
        What weakens that bound.
    """

    model: FittedModel
    half_widths: Array
    steps: dict[str, int]
    exceeded: int
    violation: float
    warnings: list[str]


def read_recording(path: Path, states: Sequence[str], inputs: Sequence[str]) -> PlantRecording:
    """Read a CSV file with a line of names, or a MATLAB file (.mat) of vectors.

    Parameters
    ----------
    path : Path
        Columns may be separated by commas, semicolons or tabs. Lines that begin with # are left
        out. An empty cell, or NaN, interrupts the recording. In a MATLAB file a matrix ``x`` of
        k columns is the columns ``x_1`` to ``x_k``.
    states, inputs : sequence of str
        Names of the columns.

    Raises
    ------
    FitError
        With a line that names what is wrong, and where.
    """
    wanted = [*states, *inputs]
    for name in wanted:
        if wanted.count(name) > 1:
            raise FitError(f"--states, --inputs: {name!r} is named twice")
    matlab = path.suffix.lower() == ".mat"
    columns = _matlab_columns(path) if matlab else _csv_columns(path, wanted)
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise FitError(
            f"{path}: has no column {missing[0]!r}, expected one of: {', '.join(columns)}"
        )
    lengths = {len(columns[name]) for name in wanted}
    if len(lengths) > 1:
        raise FitError(f"{path}: columns have {sorted(lengths)} rows, expected one length")
    x = np.column_stack([columns[name] for name in states])
    u = np.column_stack([columns[name] for name in inputs])
    step = np.column_stack([x[:-1], u[:-1], x[1:]])
    whole = np.isfinite(step).all(axis=1)
    return PlantRecording(tuple(states), tuple(inputs), x[:-1][whole], u[:-1][whole], x[1:][whole])


def _csv_columns(path: Path, wanted: Sequence[str]) -> dict[str, Array]:
    try:
        text = read_regular(path).decode("utf-8-sig")
    except OSError as error:
        raise FitError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FitError(f"{path}: not UTF-8 text, expected CSV or a MATLAB file (.mat)") from None
    numbered = enumerate(text.splitlines(keepends=True), 1)
    lines = [(i, line) for i, line in numbered if line.strip() and not line.startswith("#")]
    if len(lines) < 2:
        raise FitError(f"{path}: expected a line of names, and a line of numbers for each step")
    separator = max(",;\t", key=lines[0][1].count)
    rows = csv.reader((line for _, line in lines), delimiter=separator)
    names = [name.strip() for name in next(rows)]
    columns: dict[str, list[float]] = {name: [] for name in names}
    for name in wanted:
        if names.count(name) > 1:
            raise FitError(f"{path}: has two columns {name!r}")
    for row in rows:
        where = f"{path}: line {lines[rows.line_num - 1][0]}"
        cells = dict(zip(names, row, strict=False))
        for name in (n for n in names if n in wanted):
            if name not in cells:
                raise FitError(f"{where}: got {len(row)} columns, expected {len(names)}")
            columns[name].append(_number(cells[name].strip(), f"{where}: {name}"))
    return {name: np.array(column) for name, column in columns.items()}


def _number(cell: str, where: str) -> float:
    """What a cell says; not a number where it is empty."""
    try:
        return float(cell) if cell else math.nan
    except ValueError:
        raise FitError(f"{where}: got {cell!r}, expected a number") from None


def _matlab_columns(path: Path) -> dict[str, Array]:
    from scipy.io import loadmat

    try:
        found: dict[str, Any] = loadmat(str(path))
    except OSError as error:
        raise FitError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (NotImplementedError, ValueError, TypeError) as error:
        why = str(error).splitlines()[0]
        raise FitError(f"{path}: not a MATLAB file before version 7.3: {why}") from None
    columns: dict[str, Array] = {}
    for name, value in found.items():
        table = np.atleast_2d(value)
        if name.startswith("__") or not np.issubdtype(table.dtype, np.number):
            continue
        rows = (table if len(table) > 1 else table.T).astype(float)
        if rows.shape[1] == 1:
            columns[name] = rows[:, 0]
        else:
            columns |= {f"{name}_{i + 1}": rows[:, i] for i in range(rows.shape[1])}
    return columns


def fit_recording(recording: PlantRecording, violation: float) -> RecordedFit:
    """Identify A and B, scale D_c, and count the steps held out that leave it.

    Parameters
    ----------
    recording : PlantRecording
    violation : float
        Share of the steps that may leave D_c, for its scale.

    Raises
    ------
    FitError
        When the recording is too short, does not excite the plant, or shows no disturbance.
    """
    x, u, after = recording.x, recording.u, recording.after
    first, second = (int(share * len(x)) for share in PARTS)
    _check_excited(recording, x[:first], u[:first])
    model = identify(x[:first], u[:first], after[:first])
    if model.dead:
        raise FitError(
            f"input {recording.inputs[model.dead[0]]} has no effect: B's column is within its "
            "error; leave it out of --inputs, or record the plant while that input changes more"
        )
    residuals = after - x @ model.A.T - u @ model.B.T
    shape = template(residuals[:first])
    if not shape.all():
        j = int((shape == 0).argmax())
        raise FitError(f"state {recording.states[j]} shows no disturbance: D_c would have width 0")
    scores = np.abs(residuals / shape).max(axis=1)
    try:
        scale = conformal_scale(scores[first:second].tolist(), violation)
    except ValueError as error:
        problem = str(error).replace("sessions", "steps")
        raise FitError(f"to scale D_c {problem}; record more, or raise --violation") from None
    half_widths, held_out = shape * scale, scores[second:]
    exceeded = int((held_out > scale).sum())
    offset = _offset(x[:first], u[:first], after[:first])
    return RecordedFit(
        model=model,
        half_widths=half_widths,
        steps={"identified": first, "scaled": second - first, "held_out": len(held_out)},
        exceeded=exceeded,
        violation=violation_bound(len(held_out), exceeded),
        warnings=_warnings(held_out, float((offset / half_widths).max())),
    )


def _warnings(held_out: Array, offset: float) -> list[str]:
    """What weakens the bound.

    Parameters
    ----------
    held_out : array
        Scores of the steps held out, in the order of time.
    offset : float
        Where zero states go in a step under zero inputs, in half-widths of D_c.
    """
    found = []
    alike = 0.0
    if len(held_out) > 2 and held_out.std() > 0:
        alike = float(np.corrcoef(held_out[:-1], held_out[1:])[0, 1])
    if alike > ALIKE:
        found.append(
            f"what the model leaves of neighbouring steps is alike (correlation "
            f"{alike:.2f}), so fewer steps are independent than the bound counts"
        )
    if offset > OFFSET:
        found.append(
            f"under zero inputs zero states move by {offset:.2f} half-widths of D_c a "
            "step: subtract the operating point from the columns"
        )
    return found


def _offset(x: Array, u: Array, after: Array) -> Array:
    """The constant part of each next state, where it is more than its error."""
    model = identify(x, np.column_stack([u, np.ones(len(u))]), after)
    constant, errors = np.abs(model.B[:, -1]), model.errors[:, -1]
    return np.where(constant > WITHIN * errors, constant, 0.0)


def _check_excited(recording: PlantRecording, x: Array, u: Array) -> None:
    """Refuse a recording in which an input follows from what else was recorded.

    Under a control law u = K x and nothing else, the data fit every A + B K, and B is not among
    what they say.
    """
    n, m = x.shape[1], u.shape[1]
    if len(x) <= n + m:
        raise FitError(
            f"got {len(x)} steps to identify A and B, expected more than {n + m}; record more"
        )
    for j, name in enumerate(recording.inputs):
        if np.ptp(u[:, j]) == 0:
            raise FitError(f"input {name} is {u[0, j]:g} throughout: the plant was not excited")
        others = np.column_stack([x, np.delete(u, j, axis=1), np.ones(len(x))])
        fitted = others @ np.linalg.lstsq(others, u[:, j], rcond=None)[0]
        left = float(np.var(u[:, j] - fitted) / np.var(u[:, j]))
        if left < 1 - DEPENDENT:
            raise FitError(
                f"input {name} follows from the states and other inputs ({100 * left:.2g} % of its "
                "variance does not): the recording cannot tell A from B; record the plant while a "
                "random part is added to that input"
            )
