"""The rate at which a link settles, and that of its start.

From x(0) a loop comes into its target set, and there it is another loop: its candidates may lie
closer, or be one. So the rate is counted after a burn-in, in runs from x(0) and from the origin
alike.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Counts
from protocol.statistics import COMPUTED, Interval, mean_over_runs, share_over_runs

if TYPE_CHECKING:
    from protocol.scenario import Scenario
    from wyner.simulate.engine import Runs
    from wyner.simulate.engine.loop import ManyLaw

RUNS: Final = 20
"""Half of them from x(0), half from the origin."""

BURN_IN: Final = 1000
"""Steps of each run that are left out: no plant that was tried needs more than 500."""

STEPS: Final = 2000
"""Steps of each run that are counted."""

START_STEPS: Final = 250
"""Steps from x(0) that are the start."""

SEED: Final = 1

DRIFT: Final = 0.999
"""Confidence at which two rates that should be one differ: one settled loop in 1000 is called so
wrongly."""


@dataclass(frozen=True, slots=True)
class Rate:
    """What some steps of some runs carried.

    Parameters
    ----------
    agreed : Interval
        Share of the tested transitions that agreed a key.
    bits_per_second : Interval
        Message bits.
    runs, steps : int
    """

    agreed: Interval
    bits_per_second: Interval
    runs: int
    steps: int

    def as_json(self) -> dict[str, Any]:
        """One object for machines."""
        p, bits = self.agreed.as_json(), self.bits_per_second.as_json()
        reasons = {
            name: figure["no_interval"]
            for name, figure in (("agreement_probability", p), ("bits_per_second", bits))
            if "no_interval" in figure
        }
        return {
            "runs": self.runs,
            "steps": self.steps,
            "agreement_probability": p["value"],
            "agreement_interval_95": [p["low"], p["high"]],
            "bits_per_second": bits["value"],
            "bits_per_second_interval_95": [bits["low"], bits["high"]],
            "no_interval": reasons,
        }


@dataclass(frozen=True, slots=True)
class SettledRate:
    """A link's rate in the long run, and at its start.

    Parameters
    ----------
    settled, start : Rate
    burn_in : int
        Steps left out before the settled rate's.
    ceiling : float
        Bit/s where every tested step agrees.
    last_key : int, optional
        The last step of all in which some run agreed a key; None: none ever did.
    still_moves : str
        How the rate has not settled; empty where it has.
    """

    settled: Rate
    start: Rate
    burn_in: int
    ceiling: float
    last_key: int | None
    still_moves: str

    @property
    def silent(self) -> bool:
        """Whether no run agreed a key after the burn-in."""
        return not self.settled.agreed.value > 0

    @property
    def starts_otherwise(self) -> bool:
        """Whether the start's share of agreements is another one."""
        settled, start = self.settled.agreed, self.start.agreed
        if self.silent:
            return start.value > 0
        if not (settled.known and start.known):
            return settled.value != start.value
        return start.low > settled.high or settled.low > start.high

    def as_json(self) -> dict[str, Any]:
        """One object for machines: the settled rate, and the start's beside it."""
        told = self.settled.as_json()
        told["no_interval"]["ceiling_bits_per_second"] = COMPUTED
        return {
            **told,
            "burn_in": self.burn_in,
            "seed": SEED,
            "ceiling_bits_per_second": self.ceiling,
            "silent": self.silent,
            "last_key_step": self.last_key,
            "still_moves": self.still_moves or None,
            "start": self.start.as_json(),
        }

    def lines(self) -> list[str]:
        """For people."""
        settled, start = self.settled, self.start
        how = (
            f"{settled.runs} runs, half from x(0), half from the origin: {settled.steps} steps "
            f"after the first {self.burn_in}, seed {SEED}"
        )
        if self.silent:
            when = "in any step" if self.last_key is None else f"after step {self.last_key}"
            told = [f"settled rate 0 bit/s: the law falls silent, no key is agreed {when} ({how})"]
        else:
            told = [
                f"agreement p = {settled.agreed.text('.3f')} a tested step, settled ({how}; 95 % "
                "intervals over runs)",
                f"settled rate {settled.bits_per_second.text('.3g')} bit/s, which is not secrecy; "
                f"ceiling {self.ceiling:.3g} bit/s",
            ]
        if self.starts_otherwise:
            told.append(
                f"the first {start.steps} steps from x(0) carry "
                f"{start.bits_per_second.text('.3g')} bit/s ({start.runs} runs): not the rate, but "
                "the way to where the loop stays"
            )
        if self.still_moves:
            told.append(f"not settled: {self.still_moves}")
        return told


def long_runs(
    scenario: "Scenario",
    law: "ManyLaw",
    folder: Path = Path(),
    *,
    record: bool = False,
    burn_in: int | None = None,
) -> "list[Runs]":
    """The runs behind a settled rate: from x(0), and from the origin where that is elsewhere.

    Parameters
    ----------
    scenario : Scenario
    law : ManyLaw
    folder : Path
        Where the files that the scenario names are looked for.
    record : bool
        Keep states, candidates, inputs and gauges.
    burn_in : int, optional
        :data:`BURN_IN` where not given.

    Raises
    ------
    wyner.simulate.engine.SimulationError
        When the loop cannot start or leaves the sets.
    """
    from wyner.simulate.engine import simulate_runs

    origin = (0.0,) * scenario.n
    plant = scenario.plant.model_copy(update={"initial_state": origin})
    starts = [scenario, scenario.model_copy(update={"plant": plant})]
    if scenario.initial_state == origin:
        starts = starts[:1]
    each = RUNS // len(starts)
    return [
        simulate_runs(
            of,
            law,
            seed=SEED,
            runs=range(i * each, (i + 1) * each),
            steps=(BURN_IN if burn_in is None else burn_in) + STEPS,
            record=record,
            folder=folder,
        )
        for i, of in enumerate(starts)
    ]


def settled_rate(parts: "Sequence[Runs]", burn_in: int | None = None) -> SettledRate:
    """What the runs of :func:`long_runs` carried, after as many steps as they had left out."""
    from protocol.schemes.registry import make_scheme
    from protocol.schemes.table import advance_many
    from wyner.simulate.engine.link import carries

    burn_in = BURN_IN if burn_in is None else burn_in
    scenario = parts[0].scenario
    steps, alpha = parts[0].steps, scenario.secrecy.alpha
    bits = float(np.log2(scenario.secrecy.candidates)) / scenario.plant.period_s
    made = [carries(runs, [alpha]) for runs in parts]
    tested = [m.tested[:, 0] for m in made]
    agreed = [m.agreed[:, 0] != NO_SYMBOL for m in made]
    carried = [m.pad[:, 0] != NO_SYMBOL for m in made]

    def rate(part: slice, of: slice) -> Rate:
        cut = [np.concatenate([a[part] for a in all_[of]], axis=1) for all_ in (tested, agreed)]
        counts = [c.sum(axis=0).tolist() for c in cut]
        symbols = np.concatenate([c[part] for c in carried[of]], axis=1)
        many = Counter(symbols.sum(axis=0).tolist())
        return Rate(
            agreed=share_over_runs(zip(counts[1], counts[0], strict=True)),
            bits_per_second=mean_over_runs(many).scaled(bits / len(symbols)),
            runs=symbols.shape[1],
            steps=len(symbols),
        )

    could = [(r.symbol != NO_SYMBOL) & (r.largest <= alpha) for r in parts]
    keys = np.flatnonzero(np.concatenate(could, axis=1).any(axis=1))
    scheme = make_scheme(scenario.secrecy.scheme, scenario.secrecy.candidates)
    most = advance_many(scheme, np.zeros((steps, 1), dtype=np.int8)).pad[burn_in:] >= 0
    return SettledRate(
        settled=rate(slice(burn_in, None), slice(None)),
        start=rate(slice(START_STEPS), slice(1)),
        burn_in=burn_in,
        ceiling=float(most.mean()) * bits,
        last_key=int(keys[-1]) if len(keys) else None,
        still_moves=_still_moves([c[burn_in:] for c in could]),
    )


def _still_moves(could: list[NDArray[np.bool_]]) -> str:
    """Whether halves of the counted steps differ, or runs from x(0) and from the origin."""
    half = len(could[0]) // 2
    first, second = (
        np.concatenate([c[part].sum(axis=0) for c in could])
        for part in (slice(half), slice(half, 2 * half))
    )
    if _differs(second - first):
        shares = first.mean() / half, second.mean() / half
        return (
            f"{shares[0]:.3g} of the first {half} counted steps could agree a key, and "
            f"{shares[1]:.3g} of those after them"
        )
    if len(could) > 1:
        ours, theirs = (c.sum(axis=0) for c in could)
        if _differs(ours - theirs):
            return (
                f"from x(0) {ours.mean() / len(could[0]):.3g} of the steps could agree a key, from "
                f"the origin {theirs.mean() / len(could[1]):.3g}"
            )
    return ""


def _differs(differences: Counts) -> bool:
    """Whether a mean is shown not to be 0, by Student's t over runs."""
    from scipy.special import stdtrit

    n = len(differences)
    if not differences.any() or n < 2:
        return False
    error = float(differences.std(ddof=1)) / n**0.5
    most = float(stdtrit(n - 1, 0.5 + DRIFT / 2))
    return bool(abs(float(differences.mean())) > most * error)
