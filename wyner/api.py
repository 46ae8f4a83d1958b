"""The library: what a notebook imports, as ``from wyner import ...``.

Load or build a scenario, design it, simulate it, let eavesdroppers hear it, get arrays and data
frames, draw on axes of one's own::

    from wyner import design, eavesdrop, run

    system = design("sustained")
    runs = run(system, steps=1000, runs=20, seed=1, message=b"We sail at dawn.")
    print(runs.rate, runs.messages[0], eavesdrop(runs, ["nearest-centre"]))

Errors are exceptions with one line that names the field, the value and what was expected.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller_service.laws.base import CandidateLaw
from controller_service.laws.online import OutsideError, ProgramError
from controller_service.laws.registry import cached_design, make_law
from controller_service.sets.design import Design, SynthesisError
from plant_service.adapters import PlantAdapter, PlantError, Sample, Stepped
from plant_service.adapters.registry import open_plant
from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array, Symbols
from protocol.convex import Polytope, corners, planar_vertices
from protocol.knowledge import Knowledge
from protocol.scenario import Scenario, ScenarioError, load_scenario, parse_scenario, set_field
from protocol.schemes.framing import Deframer
from protocol.shipped import SCENARIOS, scenario_file_of
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import LADDER, Belief, Eavesdropper, Guess, KnowledgeError
from wyner.scoring.statistics import Interval, bootstrap_mean, wilson
from wyner.simulate.engine import Runs, SimulationError, Transfer, simulate_runs, transfer
from wyner.simulate.engine.link import follow
from wyner.simulate.engine.taps import Heard, listen
from wyner.simulate.single import simulate_plant

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from wyner.verify.clause import Finding

__all__ = [
    "LADDER",
    "Belief",
    "Eavesdropper",
    "Guess",
    "Interval",
    "Knowledge",
    "KnowledgeError",
    "OutsideError",
    "PlantAdapter",
    "PlantError",
    "ProgramError",
    "Sample",
    "Scenario",
    "ScenarioError",
    "Simulated",
    "SimulationError",
    "Stepped",
    "SynthesisError",
    "System",
    "TapScore",
    "Transition",
    "build",
    "check",
    "design",
    "draw_agreement",
    "draw_rate",
    "draw_sets",
    "draw_states",
    "eavesdrop",
    "load",
    "rate_against_alpha",
    "report",
    "run",
    "scenario_names",
    "vary",
]


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
    return load_scenario(scenario_file_of(str(source)))


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


def vary(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """The scenario with some fields changed: ``vary(s, {"secrecy.alpha": 4.0})``.

    Raises
    ------
    ScenarioError
        When there is no such field, or the whole is no scenario any more.
    """
    data = json.loads(scenario.model_dump_json(exclude_none=True, exclude_unset=True))
    for path, value in changes.items():
        set_field(data, path, value)
    return parse_scenario(data, scenario.name)


@dataclass(frozen=True, eq=False)
class System:
    """A scenario with its sets and its law.

    Parameters
    ----------
    scenario : Scenario
    design : Design
        The sets T_0..T_N.
    law : CandidateLaw
    """

    scenario: Scenario
    design: Design
    law: CandidateLaw

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
        return self.law.index(tuple(x))

    def candidates(self, x: Sequence[float]) -> Array:
        """The M candidate inputs at x, shape (M, m)."""
        return np.array(self.law.candidates(tuple(x)))

    def corners(self, i: int) -> Array:
        """Corners of T_i, shape (corners, n); in the plane in order of angle."""
        p = Polytope(*self.design.set(i))
        return planar_vertices(p) if p.dimension == 2 else corners(p.H, p.h)


def design(scenario: Scenario | str | Path) -> System:
    """Compute a scenario's sets, or read them from the cache, and make its law.

    Raises
    ------
    ScenarioError, SynthesisError, ProgramError
        With one line that names the field.
    """
    s = scenario if isinstance(scenario, Scenario) else load(scenario)
    found = cached_design(s)
    return System(s, found, make_law(s, found))


@dataclass(frozen=True, eq=False)
class Simulated:
    """Runs of a system. Arrays have the run first and the step second.

    Parameters
    ----------
    system : System
    seed : int
    record : Runs
        As the engine keeps them, the run last.
    link : Transfer
    """

    system: System
    seed: int
    record: Runs
    link: Transfer

    @property
    def steps(self) -> int:
        """Steps of each run."""
        return self.record.steps

    @property
    def count(self) -> int:
        """R, the number of runs."""
        return len(self.record.runs)

    @cached_property
    def x(self) -> Array:
        """States, shape (R, steps + 1, n)."""
        assert self.record.x is not None
        return np.moveaxis(self.record.x, 2, 0)

    @cached_property
    def candidates(self) -> Array:
        """Offered inputs, shape (R, steps, M, m)."""
        assert self.record.candidates is not None
        return np.moveaxis(self.record.candidates, 3, 0)

    @cached_property
    def u(self) -> Array:
        """Applied inputs, shape (R, steps, m)."""
        place = self.coin[:, :, None, None].astype(np.intp)
        return np.take_along_axis(self.candidates, place, axis=2)[:, :, 0]

    @cached_property
    def gauges(self) -> Array:
        """g(x(k+1) - c_i), in units of D_c, shape (R, steps, M)."""
        assert self.record.gauges is not None
        return np.moveaxis(self.record.gauges, 2, 0)

    @property
    def coin(self) -> Symbols:
        """The plant's coin b_r, shape (R, steps)."""
        return self.record.coin.T

    @property
    def key(self) -> Symbols:
        """The key symbol agreed on a step, or -1, shape (R, steps)."""
        return self.link.agreed.T

    @property
    def cipher(self) -> Symbols:
        """The public ciphertext symbol of a step, shape (R, steps)."""
        return self.link.cipher.T

    @property
    def message_symbol(self) -> Symbols:
        """The message symbol recovered on a step, or -1, shape (R, steps)."""
        return self.link.message_symbol.T

    @cached_property
    def messages(self) -> list[list[bytes]]:
        """Whole messages that the plant recovered, in each run."""
        found = []
        for row in self.message_symbol.tolist():
            deframer = Deframer(self.system.scenario.secrecy.candidates)
            frames = [f for v in row if v != NO_SYMBOL and (f := deframer.push(v)) is not None]
            found.append([f.payload for f in frames if f.intact])
        return found

    @property
    def agreements(self) -> NDArray[np.int64]:
        """Key symbols agreed in each run, shape (R,)."""
        out: NDArray[np.int64] = (self.key != NO_SYMBOL).sum(axis=1)
        return out

    @property
    def rate(self) -> Interval:
        """Message bits a second of plant time, with the 95 % bootstrap interval over runs.

        The paper's count: what was sent, not what stayed secret (docs/secrecy.md).
        """
        s = self.system.scenario
        counts, of = np.unique((self.message_symbol != NO_SYMBOL).sum(axis=1), return_counts=True)
        bits = float(np.log2(s.secrecy.candidates))
        mean = bootstrap_mean(dict(zip(counts.tolist(), of.tolist(), strict=True)))
        return mean.scaled(bits / (self.steps * s.plant.period_s))

    def frame(self, run: int | None = None) -> "pd.DataFrame":
        """One row a step as a pandas data frame; of one run, or of all.

        Columns: run, k, x_1.., u_1.., coin, gauge_0.., key, cipher, message_symbol; -1 stands for
        no symbol.
        """
        import pandas as pd

        rows = range(self.count) if run is None else range(run, run + 1)
        columns: dict[str, Any] = {
            "run": np.repeat(np.array(self.record.runs)[list(rows)], self.steps),
            "k": np.tile(np.arange(self.steps), len(rows)),
        }
        part = slice(rows.start, rows.stop)

        def add(name: str, values: NDArray[Any], first: int) -> None:
            for i in range(values.shape[2]):
                columns[f"{name}_{i + first}"] = values[part, : self.steps, i].ravel()

        add("x", self.x, 1)
        add("u", self.u, 1)
        columns["coin"] = self.coin[part].ravel()
        add("gauge", self.gauges, 0)
        for name in ("key", "cipher", "message_symbol"):
            columns[name] = getattr(self, name)[part].ravel()
        return pd.DataFrame(columns)


def run(
    system: System | Scenario | str,
    *,
    steps: int = 250,
    runs: int = 1,
    seed: int = 1,
    message: bytes = b"",
    plant: Stepped | PlantAdapter | None = None,
    folder: str | Path = ".",
) -> Simulated:
    """Simulate runs of a system; run r of a seed is the same however many others there are.

    Linear plants go through the engine, all runs at once; any other is stepped by itself.

    Parameters
    ----------
    system : System, Scenario or str
        What :func:`design` returned, or what it takes.
    steps, runs : int
    seed : int
        Of coins, disturbances and ciphertext symbols.
    message : bytes
        Sent once, then idle symbols.
    plant : Stepped or PlantAdapter, optional
        An object of one's own in place of the scenario's plant, in physical units; it is reset, or
        started, for each run.
    folder : path
        Where the files that the scenario's plant names are looked for.

    Raises
    ------
    SimulationError
        When a state leaves every set or a plant fails; the message names run and step.
    PlantError
        When the plant cannot be opened.
    """
    s = system if isinstance(system, System) else design(system)
    linear = s.scenario.plant.kind == "linear" and s.scenario.defender.model is None
    if plant is None and linear:
        record = simulate_runs(
            s.scenario, s.law, seed=seed, runs=range(runs), steps=steps, record=True
        )
    else:
        record = simulate_plant(
            s.scenario,
            s.law,
            lambda: open_plant(s.scenario, Path(folder), plant),
            seed=seed,
            runs=range(runs),
            steps=steps,
            folder=Path(folder),
        )
    return Simulated(s, seed, record, transfer(record, payloads=[message] if message else []))


def rate_against_alpha(runs: Simulated, alphas: ArrayLike) -> list[Interval]:
    """The rate that the same runs would have had at each alpha, bits a second.

    Neither law nor coin depends on alpha.
    """
    s = runs.system.scenario
    link = follow(runs.record, [float(a) for a in np.atleast_1d(alphas)])
    scale = float(np.log2(s.secrecy.candidates)) / (runs.steps * s.plant.period_s)
    out = []
    for row in link.message_symbols:
        counts, of = np.unique(row, return_counts=True)
        mean = bootstrap_mean(dict(zip(counts.tolist(), of.tolist(), strict=True)))
        out.append(mean.scaled(scale))
    return out


@dataclass(frozen=True, slots=True)
class TapScore:
    """What one eavesdropper got of some runs.

    Parameters
    ----------
    name : str
    keys : Interval
        Share of the agreed key symbols that she guessed right at once, with the 95 % Wilson
        interval; a blind guess has 1/M. (0.5, 0, 1) where none was agreed and M = 2.
    agreements, right : int
    delivered, read : int
        Whole messages that the plant recovered, and how many of them she had in the end.
    """

    name: str
    keys: Interval
    agreements: int
    right: int
    delivered: int
    read: int


def eavesdrop(
    runs: Simulated,
    eavesdroppers: Sequence[str | type[Eavesdropper]] = ("set-membership", "nearest-centre"),
) -> list[TapScore]:
    """Let eavesdroppers hear every run's public messages, nothing lost, and score them.

    Parameters
    ----------
    runs : Simulated
    eavesdroppers : sequence of str or class
        Names of :data:`LADDER`, ``file.py:Name``, or classes that extend :class:`Eavesdropper`.

    Raises
    ------
    KnowledgeError
        When there is no such eavesdropper.
    """
    heard = [listen(runs.record, runs.link, eavesdroppers, r) for r in range(runs.count)]
    size = runs.system.scenario.secrecy.candidates
    return [
        _score(e if isinstance(e, str) else e.name, [of_run[i] for of_run in heard], size)
        for i, e in enumerate(eavesdroppers)
    ]


def _score(name: str, heard: Sequence[Heard], size: int) -> TapScore:
    agreements, right = sum(h.agreements for h in heard), sum(h.right for h in heard)
    keys = wilson(right, agreements) if agreements else Interval(1.0 / size, 0.0, 1.0)
    delivered, read = sum(h.delivered for h in heard), sum(h.read for h in heard)
    return TapScore(name, keys, agreements, right, delivered, read)


# --- runs of the services -------------------------------------------------------------------------


def check(run_dir: str | Path) -> "list[Finding]":
    """What ``wyner check`` says of a run's folder, clause by clause.

    Raises
    ------
    FileNotFoundError, ScenarioError, TraceError
        When there is no run, or it cannot be read.
    """
    from wyner.verify import check as judge
    from wyner.verify.evidence import read_evidence

    return judge(read_evidence(Path(run_dir)))


def report(run_dir: str | Path, output: str | Path | None = None) -> Path:
    """Write the page of a run, by default as ``report.html`` in its folder; returns its path.

    Raises
    ------
    FileNotFoundError, ScenarioError, TraceError
        When there is no run, or it cannot be read.
    """
    from wyner.run_report import write_report

    return write_report(Path(run_dir), None if output is None else Path(output))


# --- figures --------------------------------------------------------------------------------------


def draw_sets(
    system: System,
    axes: "Axes",
    indices: Sequence[int] | None = None,
    runs: Simulated | None = None,
) -> None:
    """Draw some T_i of a plant in the plane, and the trajectories of ``runs`` through them."""
    from wyner.studies.figures.axes import draw_sets as draw

    chosen = indices or sorted({0, 1, 2, 4, 8} & set(range(system.horizon + 1)))
    draw(axes, {i: system.corners(i) for i in chosen}, None if runs is None else runs.x)


def draw_agreement(runs: Simulated, axes: "Axes", step: int | None = None, run: int = 0) -> None:
    """Draw one step as Fig. 4 does: both reachable sets of both parties, and where x(k+1) fell.

    By default the first step on which a key symbol was agreed; of plants with more than two states
    the first two.
    """
    from wyner.studies.figures.axes import draw_agreement as draw

    agreed = np.flatnonzero(runs.key[run] != NO_SYMBOL)
    k = step if step is not None else int(agreed[0]) if len(agreed) else 0
    scenario = runs.system.scenario
    x, offers = runs.x[run, k], runs.candidates[run, k]
    centres = x @ np.array(scenario.A).T + offers @ np.array(scenario.B).T
    D_c = scenario.defender.disturbance
    points = corners(*(np.array(a) for a in D_c.rows()))
    draw(axes, centres, runs.x[run, k + 1], points, scenario.secrecy.alpha)


def draw_states(runs: Simulated, axes: "Axes", run: int = 0) -> None:
    """Draw the states of a run over time, with a mark on every step that agreed a key symbol."""
    from wyner.studies.figures.axes import draw_states as draw

    agreed = np.flatnonzero(runs.key[run] != NO_SYMBOL)
    draw(axes, runs.x[run], runs.system.scenario.plant.period_s, agreed)


def draw_rate(runs: Simulated, axes: "Axes", alphas: ArrayLike, label: str | None = None) -> None:
    """Draw the rate against alpha with its 95 % band (the paper's Fig. 7)."""
    from wyner.studies.figures.axes import draw_rate as draw

    values = np.atleast_1d(np.asarray(alphas, dtype=float))
    name = label or runs.system.scenario.name
    draw(axes, values, rate_against_alpha(runs, values), name)
