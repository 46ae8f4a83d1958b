"""Scenarios and what is designed for them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from controller_service.sets.design import Design
from protocol.arrays import Array
from protocol.brief import Brief
from protocol.convex import Polytope, corners, planar_vertices
from protocol.scenario import Scenario, ScenarioError, parse_scenario, with_fields
from runtime.scenario_file import load_scenario, others_than
from runtime.shipped import SCENARIOS, scenario_file_of


def scenario_names() -> list[str]:
    """Names of the shipped scenarios."""
    return sorted(path.stem for path in SCENARIOS.glob("*.toml"))


def load(source: str | Path) -> Scenario:
    """A scenario from a TOML file, or a shipped one by its name.

    Raises
    ------
    ScenarioError
        With one line for each wrong field.
    """
    path = scenario_file_of(str(source))
    if not path.exists():
        raise ScenarioError([f"{source}: no such file{others_than(str(source))}"])
    return load_scenario(path)


def build(tables: Mapping[str, Any], source: str = "scenario") -> Scenario:
    """A scenario from nested dictionaries, which have the names of the TOML file's tables.

    Parameters
    ----------
    tables : mapping
    source : str
        Stands first in each line of an error.

    Raises
    ------
    ScenarioError
        With one line for each wrong field.
    """
    return parse_scenario(dict(tables), source)


def vary(scenario: "Scenario | System", changes: Mapping[str, Any]) -> Scenario:
    """The scenario with some fields changed: ``vary(s, {"secrecy.alpha": 4.0})``.

    Of a system, its scenario.

    Raises
    ------
    ScenarioError
        When there is no such field, or the whole is no scenario any more.
    """
    if isinstance(scenario, System):
        scenario = scenario.scenario
    return with_fields(scenario, changes, scenario.name)


@dataclass(frozen=True, eq=False, repr=False)
class System(Brief):
    """A scenario with its sets and its law.

    Parameters
    ----------
    scenario : Scenario
    design : Design
        The sets T_0..T_N.
    law : CandidateLaw
    folder : Path
        Where the files that the scenario names are: beside its own, or here.
    """

    scenario: Scenario
    design: Design
    law: CandidateLaw
    folder: Path = Path()

    def brief(self) -> dict[str, object]:
        """Which system it is: sizes, law, sets."""
        s = self.scenario
        return {
            "scenario": s.name,
            "law": s.control.law,
            "states": s.n,
            "inputs": s.m,
            "candidates": s.secrecy.candidates,
            "horizon": self.horizon,
        }

    @property
    def gain(self) -> Array:
        """K of u = K x, shape (m, n)."""
        return self.design.K

    @property
    def horizon(self) -> int:
        """N, the index of the largest set."""
        return self.design.horizon

    def index(self, x: Sequence[float]) -> int:
        """i(k) = min { i : x in T_i }; raises :class:`OutsideError` where x is in none."""
        return self.law.index(self._state(x))

    def candidates(self, x: Sequence[float]) -> Array:
        """The M candidate inputs at x, shape (M, m)."""
        return np.array(self.law.candidates(self._state(x)))

    def _state(self, x: Sequence[float]) -> tuple[float, ...]:
        if len(x) != self.scenario.n:
            raise ValueError(f"x: got {len(x)} numbers, expected {self.scenario.n}")
        return tuple(x)

    def corners(self, i: int) -> Array:
        """Corners of T_i, shape (corners, n); in the plane in order of angle."""
        if not 0 <= i <= self.horizon:
            raise ValueError(f"i: got {i}, expected 0 to {self.horizon}")
        p = Polytope(*self.design.set(i))
        return planar_vertices(p) if p.dimension == 2 else corners(p.H, p.h)


def design(scenario: Scenario | str | Path) -> System:
    """Compute a scenario's sets, or read them from the cache, and make its law.

    Raises
    ------
    ScenarioError, SynthesisError, ProgramError
        With one line that names the field.
    """
    folder = Path()
    if not isinstance(scenario, Scenario):
        folder = scenario_file_of(str(scenario)).parent
        scenario = load(scenario)
    found = cached_design(scenario)
    return System(scenario, found, make_law(scenario, found), folder)
