"""What ``wyner design`` says of a scenario: what it is worth, its sets, gain and rate."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from math import log2
from pathlib import Path
from typing import Any, Final

from controller_service.laws.base import CandidateLaw
from controller_service.laws.errors import OutsideError
from controller_service.laws.registry import cached_design, make_law
from controller_service.progress import shown_progress
from controller_service.sets.dead_link import dead_link_budget
from controller_service.sets.design import Design
from controller_service.sets.invariance import invariance
from protocol.convex import Polytope, corners, planar_area
from protocol.scenario import Scenario
from protocol.schemes.registry import scheme_named
from protocol.secret.key_digits import KEY_BITS, WORD_BITS, digits_per_word
from protocol.statistics import Interval, share_over_runs
from wyner.advice import rate as settling
from wyner.advice.answer import Answer, answer
from wyner.advice.rate import SettledRate, long_runs, settled_rate
from wyner.advice.why import Why, why
from wyner.simulate.engine import SimulationError
from wyner.simulate.missed import missed_steps

SHOWN: Final = (0, 1, 2, 5, 10, 20, 50, 100, 150, 200, 250)
"""Indices of the sets that are listed, beside the largest."""

INVARIANCE: Final = {
    "gain": "T_0 is robust invariant under u = K x, and K T_0 is within U (checked to 1e-9)",
    "control": "T_0 is robust invariant under some input in U at each state, not u = K x (checked)",
    None: "T_0 was not found to be robust invariant, under u = K x or any input in U",
}
"""What was found of T_0, by :func:`controller_service.sets.invariance.invariance`."""


@dataclass(frozen=True)
class UnderKeys:
    """What a message under distilled keys can have at most, and the first step that has a key."""

    bits_per_second_at_most: float
    first_step: int


@dataclass(frozen=True)
class DesignReport:
    """What a scenario's design is worth.

    Parameters
    ----------
    scenario : Scenario
    law : CandidateLaw
    ready_seconds : float
    simulated : bool
        Whether the loop could be simulated: the plant is linear, and the scheme agrees its keys.
    answer, rate, why : optional
        What the loop carries and costs, its settled rate, and why it is that. None where it was
        not simulated, cannot start or leaves the sets.
    under_keys : UnderKeys, optional
        For a scheme whose message travels under distilled keys.
    missed : Interval, optional
        The share of steps that the scenario's network misses; None where it has none.
    """

    scenario: Scenario
    law: CandidateLaw
    ready_seconds: float
    simulated: bool
    answer: Answer | None
    rate: SettledRate | None
    why: Why | None
    under_keys: UnderKeys | None
    missed: Interval | None

    @property
    def design(self) -> Design:
        """Its sets and gain."""
        return self.law.design

    @property
    def carries_nothing(self) -> bool:
        """Whether the loop was simulated, and cannot start or leaves the sets."""
        return self.simulated and self.rate is None

    def sets(self) -> list[dict[str, Any]]:
        """Facets, and interval or area, of some of the sets."""
        out = []
        for i in sorted({*(i for i in SHOWN if i <= self.design.horizon), self.design.horizon}):
            entry: dict[str, Any] = {"index": i, "facets": self.design.facets[i]}
            if self.scenario.n == 1:
                entry["interval"] = corners(*self.design.set(i))[:, 0].tolist()
            elif self.scenario.n == 2:
                entry["area"] = planar_area(Polytope(*self.design.set(i)))
            out.append(entry)
        return out

    def start(self) -> dict[str, Any]:
        """The initial state with its index, or why it has none."""
        state = self.scenario.initial_state
        try:
            return {"state": list(state), "index": self.law.index(state)}
        except OutsideError as error:
            return {"state": list(state), "outside": str(error)}

    def to_json(self) -> dict[str, Any]:
        """One object for machines."""
        s, design = self.scenario, self.design
        D_c, found = s.control.disturbance, s.defender.calibration
        return {
            "scenario": s.name,
            "law": s.control.law,
            "states": s.n,
            "inputs": s.m,
            "horizon": design.horizon,
            "horizon_asked": s.control.horizon,
            "stopped": design.stopped,
            "gain": design.K.tolist(),
            "gain_source": self._gain_source(),
            "terminal": vars(design.terminal),
            "invariance": invariance(s, design),
            "sets": self.sets(),
            "largest_deflation": 2 * max(design.margins),
            "start": self.start(),
            "fallback": s.link.fallback,
            "dead_link_steps": dead_link_budget(s, design),
            "control_set": None if D_c is None else D_c.model_dump(exclude_none=True),
            "noisy": s.defender.noise is not None,
            "calibration": None if found is None else found.model_dump(),
            "cached": design.cached,
            "fingerprint": s.design_fingerprint(),
            "seconds": round(design.seconds, 4),
            "ready_seconds": round(self.ready_seconds, 4),
            "answer": None if self.answer is None else self.answer.as_json(),
            "rate": None if self.rate is None else self.rate.as_json(),
            "simulated": self.simulated,
            "under_keys": None if self.under_keys is None else vars(self.under_keys),
            "network": self._network_json(),
            "why": None if self.why is None else self.why.as_json(),
        }

    def __str__(self) -> str:
        """Lines for people: first secrecy, cost and attack."""
        worth = [] if self.answer is None else [*self.answer.lines(), ""]
        reasons = [] if self.why is None else self.why.lines()
        lines = [*worth, *self._of_sets(), *self._of_safety(), "", *self._of_rate(), *reasons]
        return "\n".join(lines)

    def _gain_source(self) -> str:
        return "given" if self.design.gain_given else "linear quadratic regulator"

    def _network_json(self) -> dict[str, Any] | None:
        if self.missed is None:
            return None
        share = self.missed.as_json()
        interval = [share["low"], share["high"]]
        about = {"runs": settling.RUNS, "steps": settling.STEPS, "seed": settling.SEED}
        return {"missed_share": share["value"], "interval_95": interval, **about}

    def _of_sets(self) -> Iterator[str]:
        s, design = self.scenario, self.design
        yield f"{s.name}: {s.n} state(s), {s.m} input(s), law {s.control.law}"
        when = "read from the cache, computed once in" if design.cached else "computed in"
        fewer = ""
        if design.horizon < s.control.horizon:
            why_fewer = "they stop growing there"
            if design.stopped:
                why_fewer = (
                    "larger ones are so long beside their width that rounding could put states "
                    "into them that no input steers"
                )
            fewer = f" ({why_fewer}; {s.control.horizon} were asked)"
        yield f"sets T_0..T_{design.horizon} {when} {design.seconds:.3f} s{fewer}"
        rows = "; ".join(" ".join(f"{v:.6g}" for v in row) for row in design.K.tolist())
        yield f"K ({self._gain_source()}): {rows}"
        yield self._terminal()
        yield INVARIANCE[invariance(s, design)]
        sets = self.sets()
        extent = next((name for name in ("area", "interval") if name in sets[0]), "")
        yield f"{'index':>7} {'facets':>7}  {extent}".rstrip()
        for one in sets:
            values = one["interval"] if extent == "interval" else [one[extent]] if extent else []
            shown = " to ".join(f"{v:.6g}" for v in values)
            yield f"{one['index']:>7} {one['facets']:>7}  {shown}".rstrip()
        start = self.start()
        where = f"index {start['index']}" if "index" in start else start["outside"]
        if "outside" in start:
            where += "; start nearer to the origin, or enlarge control.horizon"
        yield f"initial state {start['state']}: {where}"

    def _terminal(self) -> str:
        t = self.design.terminal
        if t.method == "rakovic":
            return (
                f"T_0: Rakovic's approximation of order {t.order}, contraction {t.alpha:.3g}, "
                f"within {t.bound:.3g} of the minimal invariant set"
            )
        kinds = {
            "interval": "the minimal invariant interval",
            "modal": f"parallelepiped in the modes of A + B K, radius {t.bound:.3g}",
            "invariant": f"the largest set that any control keeps, radius {t.bound:.3g}",
        }
        return f"T_0: {kinds.get(t.method, t.method)}"

    def _of_safety(self) -> Iterator[str]:
        s = self.scenario
        steps = dead_link_budget(s, self.design)
        lasts = "the plant stays inside T_N for ever"
        if steps is not None:
            lasts = (
                f"every state of T_0 lasts {steps} step{'' if steps == 1 else 's'}, whatever d, "
                "before it may leave T_N"
            )
        yield f"dead link, fallback {s.link.fallback}: {lasts}"
        if s.control.disturbance is not None:
            yield "the sets resist control.disturbance, which is larger than the test's D_c"
        c = s.defender.calibration
        what = "D_c" if s.defender.noise is None else "W = D_c + N - A N"
        if c is not None:
            yield (
                f"{what}: a session of {c.steps} steps leaves it "
                f"with probability at most {c.violation:.3g}, confidence {c.confidence:g} "
                f"({c.exceeded} of {c.sessions} fresh sessions did)"
            )
        if self.missed is not None:
            yield (
                f"network: {self.missed.scaled(100.0).text('.3g', ' %')} of steps missed, in "
                f"{settling.RUNS} runs of {settling.STEPS} steps, seed {settling.SEED}; none in "
                "lock-step"
            )

    def _of_rate(self) -> list[str]:
        if self.under_keys is not None:
            return [
                f"message rate: {self.under_keys.bits_per_second_at_most:.3g} bit/s at most, from "
                f"step {self.under_keys.first_step} on at the earliest: each symbol travels under "
                "distilled keys, and is secret while their claim holds"
            ]
        if self.rate is not None:
            return self.rate.lines()
        if self.simulated:
            return ["settled rate: none, the loop cannot start or leaves the sets"]
        return ["settled rate: not simulated, as plant code runs in the plant alone"]


def design_report(scenario: Scenario, folder: Path) -> DesignReport:
    """Compute or read the design, and simulate the loop.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        Where the files are that the scenario names.

    Raises
    ------
    SynthesisError, ProgramError
        When there are no sets, or no law on them.
    """
    begin = time.perf_counter()
    with shown_progress() as progress:
        design = cached_design(scenario, progress)
    law = make_law(scenario, design)
    ready = time.perf_counter() - begin
    keyed = _under_keys(scenario)
    linear = scenario.plant.kind == "linear" and scenario.plant.disturbance.enters != "input"
    simulated = linear and keyed is None
    rate, reasons, worth = (simulated and _rate(scenario, law, folder)) or (None, None, None)
    missed = missed_steps(
        scenario, seed=settling.SEED, runs=range(settling.RUNS), steps=settling.STEPS
    )
    share = None
    if missed is not None:
        share = share_over_runs([(int(m), settling.STEPS) for m in missed.sum(axis=0)])
    return DesignReport(scenario, law, ready, simulated, worth, rate, reasons, keyed, share)


def _under_keys(scenario: Scenario) -> UnderKeys | None:
    """None under a scheme that agrees its own keys.

    A step carries a symbol where it has its digits. Keys give so many at most, where nothing is
    lost.
    """
    schedule = None if scenario.keys is None else scenario.keys.schedule()
    if schedule is None or not scheme_named(scenario.secrecy.scheme).from_stream:
        return None
    a, N, M = schedule.assumption, schedule.largest, scenario.secrecy.candidates
    keys = a.rows(N, N, a.copies * N) - 1
    digits = keys * KEY_BITS // WORD_BITS * digits_per_word(M)[0]
    steps = digits / (N * scenario.digits)
    rate = min(1.0, steps) * log2(M) / scenario.plant.period_s
    return UnderKeys(rate, schedule.first_use)


def _rate(
    scenario: Scenario, law: CandidateLaw, folder: Path
) -> tuple[SettledRate, Why | None, Answer] | None:
    """The rate, why it is what it is, and what it is worth.

    None where the loop cannot start or leaves the sets.
    """
    try:
        runs = long_runs(scenario, law, folder, record=True)
    except SimulationError:
        return None
    rate = settled_rate(runs)
    found = answer(scenario, law.design, runs, rate.settled)
    if scenario.plant.C is not None:
        return rate, None, found
    if scenario.defender.deviations is not None:  # no set decides there
        return rate, None, found
    if scenario.network is not None:
        whole = scenario.model_copy(update={"network": None})
        try:
            runs = long_runs(whole, law, folder, record=True)
        except SimulationError:
            return rate, None, found
    return rate, why(scenario, runs), found
