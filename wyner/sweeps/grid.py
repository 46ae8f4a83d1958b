"""A sweep's file and its points: a grid over scenario fields.

A point is a scenario with its fields set, a number of steps and a seed. It is named by the hash of
everything that its numbers depend on.
"""

import hashlib
import itertools
import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from protocol.scenario import Scenario, ScenarioError, with_fields
from protocol.schemes.registry import scheme_named
from protocol.wrong_fields import wrong_fields
from runtime.files import read_regular
from runtime.scenario_file import load_scenario, others_than
from runtime.shipped import SCENARIOS
from wyner.simulate import UNATTACKED, UNSEALED
from wyner.sweeps import SWEEPS
from wyner.sweeps.code import LOOP, code_version

ALPHA: Final = "secrecy.alpha"
FILE: Final = "file"
"""A column of a sweep over several scenarios: as the sweep names each. Two may have one name."""

NEUTRAL: Final = frozenset({"name", "description", "source", "link", "tap", "defence", "attack"})
"""Fields of a scenario that the numbers do not depend on, but for ``tap.loss`` where keys are gone
for. Nobody attacks these loops, and an honest one never alarms."""

Row = dict[str, Any]


class SweepError(Exception):
    """A sweep that cannot be run; ``problems`` holds one line for each wrong field."""

    def __init__(self, problems: Sequence[str] | str) -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(self.problems))


# --- the file ------------------------------------------------------------------------------------


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Variant(_Part):
    """Fields that are set together, under one name."""

    label: str
    set: dict[str, Any] = {}


class Sweep(_Part):
    """A sweep file.

    Parameters
    ----------
    name : str
        Names the results.
    scenario : str or list of str
        Shipped names, or paths relative to the file.
    runs : int
        Runs of each point.
    batch : int
        Runs of one task at most.
    steps, seed : int
    grid : dict
        Dotted path of a scenario field, and the values that it takes.
    variant : list of Variant
        Settings of several fields, each a further axis value.
    eavesdroppers : list of str
        Who listens to every run, as ``wyner tap --eavesdropper`` takes them; each run then sends
        ``message`` again and again. Paths are relative to the file.
    message : str
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]
    description: str = ""
    scenario: str | tuple[str, ...]
    runs: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(ge=2)]
    seed: Annotated[int, Field(ge=0)]
    batch: Annotated[int, Field(ge=1)] = 1000
    grid: dict[str, Annotated[tuple[Any, ...], Field(min_length=1)]] = {}
    variant: tuple[Variant, ...] = (Variant(label=""),)
    eavesdroppers: tuple[str, ...] = ()
    message: Annotated[str, Field(min_length=1, max_length=1000)] = "At nine."

    @model_validator(mode="after")
    def _points_can_be_told_apart(self) -> Self:
        if not self.scenario:
            raise ValueError("scenario: got none, expected at least one")
        labels = [v.label for v in self.variant]
        if not labels or len(set(labels)) != len(labels):
            raise ValueError(f"variant: got labels {labels}, expected different ones")
        for path in self.grid:
            table = path.split(".")[0]
            if table == "link":  # counts with a network, which any of the scenarios may have
                continue
            if table in NEUTRAL and not (table == "tap" and _for_keys(self)):
                raise ValueError(f"grid: {path}: changes none of the numbers")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """What tells its points apart: the grid's fields, and of several scenarios the file."""
        several = not isinstance(self.scenario, str) and len(self.scenario) > 1
        return (FILE, *self.grid) if several else tuple(self.grid)


def load_sweep(path: Path) -> Sweep:
    """Read a sweep file.

    Raises
    ------
    SweepError
        With one line for each wrong field.
    """
    try:
        data = tomllib.loads(read_regular(path).decode())
    except FileNotFoundError:
        others = others_than(str(path), SWEEPS, "sweep")
        raise SweepError(f"{path}: no such file{others}") from None
    except OSError as error:
        raise SweepError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SweepError(f"{path}: not TOML: {error}") from None
    if "plant" in data and "scenario" not in data:
        raise SweepError(
            f"{path}: this is a scenario, expected a sweep: a file with scenario, runs, steps, "
            "seed and a grid over the scenario's fields (docs/guides.md)"
        )
    try:
        return Sweep.model_validate(data)
    except ValidationError as error:
        raise SweepError([f"{path}: {line}" for line in wrong_fields(error)]) from None


# --- points ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Point:
    """One point of the grid.

    Parameters
    ----------
    scenario : Scenario
    variant : str
    fields : dict
        The grid's fields and their values; of several scenarios also which, as `FILE`.
    task : str
        Hash of all that its numbers depend on: scenario, steps, seed and batch.
    """

    scenario: Scenario
    variant: str
    fields: dict[str, Any]
    task: str

    @property
    def key(self) -> tuple[str, str, str]:
        """What its rows are known by: scenario, variant and task."""
        return self.scenario.name, self.variant, self.task


def canonical(value: object) -> str:
    """The value as JSON in one spelling: what is hashed and what stands in a cell."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def _substance(scenario: Scenario) -> dict[str, Any]:
    """What of a scenario the numbers depend on; a field that is left as it is names nothing new."""
    neutral = NEUTRAL if scenario.network is None else NEUTRAL - {"link"}
    return scenario.model_dump(
        mode="json", exclude=set(neutral), exclude_none=True, exclude_defaults=True
    )


def _hash(value: object) -> str:
    return hashlib.blake2b(canonical(value).encode(), digest_size=8).hexdigest()


def _for_keys(sweep: Sweep) -> bool:
    """Whether somebody goes for keys."""
    from tap_service.eavesdroppers import KEY_SOLVER

    return KEY_SOLVER in sweep.eavesdroppers


def _heard(sweep: Sweep, scenario: Scenario) -> dict[str, Any]:
    """What of a point's name the eavesdroppers are; nothing where nobody listens."""
    if not sweep.eavesdroppers:
        return {}
    files = [name.rpartition(":")[0] for name in sweep.eavesdroppers if ":" in name]
    own = [_hash(Path(name).read_text(encoding="utf-8", errors="replace")) for name in files]
    misses = {"tap.loss": scenario.tap.loss} if _for_keys(sweep) else {}
    return {
        **misses,
        "eavesdroppers": [name.rpartition("/")[2] for name in sweep.eavesdroppers],
        "message": sweep.message,
        "version": code_version(LOOP),
        "files": own,
    }


def eavesdroppers_of(sweep: Sweep, folder: Path) -> list[str]:
    """The eavesdroppers, files beside the sweep with their whole path."""
    return [
        str((folder / name).resolve()) if name.rpartition(":")[0].endswith(".py") else name
        for name in sweep.eavesdroppers
    ]


def points_of(sweep: Sweep, folder: Path) -> list[Point]:
    """Every point of the grid, in order; ``folder`` is the sweep file's.

    Raises
    ------
    SweepError
        When a scenario cannot be read, a value does not fit its field, or a point stands there
        twice.
    """
    names = (sweep.scenario,) if isinstance(sweep.scenario, str) else sweep.scenario
    problems: dict[str, None] = {}  # each once, in order
    known: dict[tuple[str, str, str], str] = {}
    points = []
    for name, variant in itertools.product(names, sweep.variant):
        base = _scenario(folder, name)
        where = f"{sweep.name}: {name}" + (f", {variant.label}" if variant.label else "")
        for values in itertools.product(*sweep.grid.values()):
            fields = dict(zip(sweep.grid, values, strict=True))
            try:
                scenario = with_fields(base, variant.set | fields, where)
            except ScenarioError as error:
                problems |= dict.fromkeys(error.problems)
                continue
            problems |= dict.fromkeys(_unlike(sweep, scenario, where))
            shown = f"{where}: {canonical(fields)}" if fields else where
            if FILE in sweep.columns:
                fields = {FILE: name, **fields}
            point = Point(scenario, variant.label, fields, _task(sweep, scenario))
            if point.key in known:
                problems[f"{shown}: stands there twice, first as {known[point.key]}"] = None
            known.setdefault(point.key, shown)
            points.append(point)
    if problems:
        raise SweepError(list(problems))
    return points


def _scenario(folder: Path, name: str) -> Scenario:
    """A scenario of a sweep in ``folder``, or else a shipped one."""
    path, shipped = folder / name, SCENARIOS / f"{name}.toml"
    try:
        return load_scenario(shipped if not path.is_file() and shipped.is_file() else path)
    except ScenarioError as error:
        raise SweepError(error.problems) from None


def _unlike(sweep: Sweep, scenario: Scenario, where: str) -> Iterator[str]:
    """What of a scenario no sweep simulates, and which of its fields change no number."""
    if scenario.attack is not None:
        yield f"{where}: {UNATTACKED}"
    if scheme_named(scenario.secrecy.scheme).from_stream:
        yield f"{where}: {UNSEALED}"
    for path in sweep.grid if scenario.network is None else ():
        if path.startswith("link."):
            yield f"{where}: grid: {path}: changes none of the numbers"


def _task(sweep: Sweep, scenario: Scenario) -> str:
    loop = {"steps": sweep.steps, "seed": sweep.seed, "batch": sweep.batch}
    return _hash({"scenario": _substance(scenario), **loop, **_heard(sweep, scenario)})


@dataclass
class Group:
    """Points that differ in alpha only, and share their trajectories."""

    points: list[Point]
    failure: str = ""


def groups_of(points: Iterable[Point]) -> list[Group]:
    """The points by trajectory, in order of first appearance."""
    found: dict[str, Group] = {}
    for point in points:
        substance = _substance(point.scenario)
        if not point.scenario.control.knows_alpha:
            del substance["secrecy"]["alpha"]
        misses = point.scenario.tap.loss
        key = canonical([point.scenario.name, point.variant, substance, misses])
        found.setdefault(key, Group([])).points.append(point)
    return list(found.values())


def describe(point: Point) -> str:
    """The point without its alpha, in a few words."""
    fields: Mapping[str, Any] = {k: v for k, v in point.fields.items() if k not in (ALPHA, FILE)}
    parts = [point.scenario.name, *([point.variant] if point.variant else [])]
    parts += [f"{name} = {canonical(value)}" for name, value in fields.items()]
    return ", ".join(parts)
