"""Runs of a system, as arrays and data frames."""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant_service.adapters import PlantAdapter, Stepped
from plant_service.adapters.registry import open_plant
from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array, Symbols
from protocol.brief import Brief
from protocol.scenario import Scenario
from protocol.schemes.registry import scheme_named
from protocol.statistics import Interval, mean_over_runs
from runtime.errors import needs
from wyner.api.systems import System, design
from wyner.simulate import UNATTACKED, UNSEALED
from wyner.simulate.engine import Runs, Transfer, simulate_runs, transfer
from wyner.simulate.engine.link import follow, whole_messages

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Simulated(Brief):
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

    def brief(self) -> dict[str, object]:
        """Of which system, how many, and what came of them."""
        return {
            "scenario": self.system.scenario.name,
            "runs": self.count,
            "steps": self.steps,
            "seed": self.seed,
            "agreements": int(self.agreements.sum()),
            "messages": sum(map(len, self.messages)),
        }

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
        assert self.record.u is not None
        return np.moveaxis(self.record.u, 2, 0)

    @property
    def cost(self) -> Array:
        """Control cost a step of each run, shape (R,): x(k+1)' Q x(k+1) + u(k)' R u(k)."""
        return self.record.mean_cost

    @property
    def missed_share(self) -> Array:
        """Share of the steps of each run that had no offer, shape (R,)."""
        return self.record.missed_share

    @cached_property
    def gauges(self) -> Array:
        """g(x(k+1) - c_i), in units of D_c, shape (R, steps, M)."""
        assert self.record.gauges is not None
        return np.moveaxis(self.record.gauges, 2, 0)

    @property
    def coin(self) -> Symbols:
        """The plant's coin b_r, shape (R, steps); -1 where a step was missed."""
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
        size = self.system.scenario.secrecy.candidates
        return [whole_messages(row, size) for row in self.message_symbol.tolist()]

    @property
    def agreements(self) -> NDArray[np.int64]:
        """Key symbols agreed in each run, shape (R,)."""
        out: NDArray[np.int64] = (self.key != NO_SYMBOL).sum(axis=1)
        return out

    @property
    def rate(self) -> Interval:
        """Message bits a second of plant time, with the 95 % bootstrap interval over runs.

        Fewer than five runs have no interval: its limits are NaN. A count of what was sent, as the
        paper's rule counts it, and not of what stayed secret (docs/findings.md).
        """
        s = self.system.scenario
        carried = (self.message_symbol != NO_SYMBOL).sum(axis=1)
        bits = float(np.log2(s.secrecy.candidates))
        return _mean(carried).scaled(bits / (self.steps * s.plant.period_s))

    def frame(self, run: int | None = None) -> "pd.DataFrame":
        """One row a step as a pandas data frame; of one run, or of all.

        Columns: run, k, x_1.., u_1.., coin, gauge_0.., key, cipher, message_symbol; -1 stands for
        no symbol.

        Raises
        ------
        ImportError
            Where pandas is not there; the text says how to get it.
        ValueError
            When there is no such run.
        """
        try:
            import pandas as pd
        except ImportError:
            raise ImportError(needs("frame()", "pandas")) from None
        if run is not None and not 0 <= run < self.count:
            raise ValueError(f"run: got {run}, expected 0 to {self.count - 1}")
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
    folder: str | Path | None = None,
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
    folder : path, optional
        Where the files that the scenario names are looked for, if not in the system's folder.

    Raises
    ------
    SimulationError
        When a state leaves every set or a plant fails; the message names run and step. Also for a
        device of which outputs alone are read.
    PlantError
        When the plant cannot be opened.
    ValueError
        When a number is none that can be, the message is text, or the scenario has an attack.
    """
    given: object = message  # the annotation is not what a notebook passes
    if not isinstance(given, bytes):
        got = type(given).__name__
        raise ValueError(f'message: got {got}, expected bytes: "text".encode() or b"text"')
    for name, value, least in (("steps", steps, 1), ("runs", runs, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or value < least:
            raise ValueError(f"{name}: got {value!r}, expected a whole number, {least} or more")
    s = system if isinstance(system, System) else design(system)
    if s.scenario.attack is not None:
        raise ValueError(f"{s.scenario.name}: {UNATTACKED}")
    if message and scheme_named(s.scenario.secrecy.scheme).from_stream:
        raise ValueError(f"{s.scenario.name}: {UNSEALED}")
    place = s.folder if folder is None else Path(folder)
    opened = None if plant is None else (lambda: open_plant(s.scenario, place, plant))
    record = simulate_runs(
        s.scenario,
        s.law,
        seed=seed,
        runs=range(runs),
        steps=steps,
        record=True,
        folder=place,
        plant=opened,
    )
    return Simulated(s, seed, record, transfer(record, payloads=[message] if message else []))


def rate_against_alpha(runs: Simulated, alphas: ArrayLike) -> list[Interval]:
    """The rate that the same runs would have had at each alpha, bits a second.

    Neither law nor coin depends on alpha.
    """
    s = runs.system.scenario
    link = follow(runs.record, [float(a) for a in np.atleast_1d(alphas)])
    scale = float(np.log2(s.secrecy.candidates)) / (runs.steps * s.plant.period_s)
    return [_mean(row).scaled(scale) for row in link.message_symbols]


def _mean(counts: NDArray[np.int64]) -> Interval:
    """Mean of a count over runs, shape (R,), with its interval."""
    return mean_over_runs(Counter(counts.tolist()))
