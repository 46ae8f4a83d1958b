"""The three lines with which ``wyner design`` begins: what is secret, what it costs, what is seen.

A loop carries keys by the paper's rule; what of them is truly secret is what an eavesdropper leaves
who names the nearest prediction. The cost is that of the loop beside the same loop under u = K x.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from controller_service.sets.design import Design
from controller_service.sets.terminal import regulator_gain
from protocol.agreement import Gauge
from protocol.arrays import Array, Indices
from protocol.link.fallback import clip
from protocol.scenario import Scenario
from protocol.statistics import COMPUTED, STATED, Interval, bits_left, wilson
from protocol.vectors import Vector
from wyner.advice import rate as settling
from wyner.advice.rate import Rate, long_runs

if TYPE_CHECKING:
    from wyner.simulate.engine import Runs

EVE: Final = "nearest-centre"
"""Who names the keys: the cheapest eavesdropper that names them all on every shipped scenario."""

HEARD: Final = 5
"""Runs that Eve hears, at most."""

DRAWS: Final = 2000
"""Draws of runs behind the interval of a ratio (bootstrap)."""


class PlainLaw:
    """u = K x, clipped to U, as every candidate: the loop without a secret.

    K is the design's, or where that does not stabilise the plant the linear quadratic regulator's
    for the weights by which the loop is judged.

    Parameters
    ----------
    scenario : Scenario
    design : Design
    """

    def __init__(self, scenario: Scenario, design: Design) -> None:
        self._gain = np.array(design.K)
        if not np.abs(np.linalg.eigvals(design.A + design.B @ self._gain)).max() < 1:
            Q, R = scenario.cost_weights
            self._gain = regulator_gain(design.A, design.B, np.diag(Q), np.diag(R))
        self._inputs = Gauge.from_rows(*scenario.control.inputs.rows())
        self._size = scenario.secrecy.candidates

    def candidates(self, x: Vector, /) -> tuple[Vector, ...]:
        """The same input M times."""
        return (clip((self._gain @ np.array(x)).tolist(), self._inputs),) * self._size

    def indices(self, X: Array, /) -> Indices:
        """0 for each state: this law knows no sets."""
        return np.zeros(len(X), dtype=np.int64)

    def candidates_many(self, X: Array, indices: Indices | None = None, /) -> Array:  # noqa: ARG002
        """The same input M times for each row of X, shape (R, M, m)."""
        return np.array([self.candidates(tuple(x)) for x in X.tolist()])


@dataclass(frozen=True, slots=True)
class Answer:
    """What a loop carries, what is secret of it, what it costs, and what a key would catch.

    Parameters
    ----------
    rate : Rate
        By the paper's rule, settled.
    secret : float
        Bits a second that Eve leaves at most: the limit of a 95 % interval.
    heard, named, agreed : int
        Runs that Eve heard, key symbols that she knew, and those that were agreed in these runs.
    cost, inputs, states : Interval
        Quadratic cost, root mean square of the inputs and of the states, each as a ratio to that of
        the loop under u = K x; 95 % intervals over runs.
    size : int
        M.
    unseen : str
        Why a spoofed sensor stays unseen under this law; empty where a keyed coin catches it.
    """

    rate: Rate
    secret: float
    heard: int
    named: int
    agreed: int
    cost: Interval
    inputs: Interval
    states: Interval
    size: int
    unseen: str

    def as_json(self) -> dict[str, Any]:
        """One object for machines."""
        ratios = {"cost": self.cost, "input_rms": self.inputs, "state_rms": self.states}
        found: dict[str, Any] = {
            "bits_per_second_by_the_papers_rule": self.rate.bits_per_second.as_json(),
            "secret_bits_per_second_at_most": self.secret,
            "no_interval": {"secret_bits_per_second_at_most": STATED},
            "eve": {"name": EVE, "runs": self.heard, "named": self.named, "agreed": self.agreed},
            "beside_plain_loop": {name: ratio.as_json() for name, ratio in ratios.items()},
        }
        if self.unseen:
            return {**found, "spoofed_sensor": {"why_unseen": self.unseen}}
        steps = self.size / (self.size - 1)
        seen = {"mean_steps_until_seen": steps, "no_interval": {"mean_steps_until_seen": COMPUTED}}
        return {**found, "spoofed_sensor": seen}

    def lines(self) -> list[str]:
        """Three lines for people."""
        rate = self.rate.bits_per_second.text(".3g")
        if self.agreed:
            eve = (
                f"truly secret: at most {self.secret:.2g} bit/s, as Eve names {self.named} of "
                f"{self.agreed} keys ({EVE}, {self.heard} runs)"
            )
        else:
            eve = "once settled no key is agreed, and nothing is secret"
        steps = self.size / (self.size - 1)
        seen = (
            f"attack: a spoofed sensor is seen after {steps:.3g} steps (mean) if a secret key "
            'draws the coin ([defence] coin = "keys"), and never where Eve has the key'
        )
        if self.unseen:
            seen = f"attack: a spoofed sensor stays unseen with or without a key: {self.unseen}"
        return [
            f"secrecy: {rate} bit/s by the paper's rule; {eve}",
            f"cost: {self.cost.text('.3g')} times that of the plain loop u = K x; input rms "
            f"{self.inputs.text('.3g')} times, state rms {self.states.text('.3g')} times",
            seen,
        ]


def answer(scenario: Scenario, design: Design, parts: "Sequence[Runs]", rate: Rate) -> Answer:
    """Hear the runs, run the plain loop beside them, and ask whether a key would catch anything.

    Parameters
    ----------
    scenario : Scenario
    design : Design
    parts : sequence of Runs
        Of :func:`wyner.advice.rate.long_runs`, with a record.
    rate : Rate
        That they settle at.
    """
    from wyner.simulate.engine import transfer
    from wyner.simulate.engine.taps import listen

    link = transfer(parts[-1], payloads=[])
    places = range(min(HEARD, len(parts[-1].runs)))
    heard = [listen(parts[-1], link, [EVE], place)[0] for place in places]
    named, agreed = sum(h.known for h in heard), sum(h.agreements for h in heard)
    size = scenario.secrecy.candidates
    secret = 0.0
    if agreed:
        carried = rate.bits_per_second
        most = carried.high if carried.known else carried.value
        secret = most * bits_left(1, size, wilson(named, agreed)).high / float(np.log2(size))
    ours = _squares(parts)
    plain = _squares(long_runs(scenario, PlainLaw(scenario, design), record=True))
    unseen = "" if scenario.defence.keyed else "; ".join(scenario.control.why_unseen())
    return Answer(
        rate=rate,
        secret=secret,
        heard=len(heard),
        named=named,
        agreed=agreed,
        cost=ratio_of_means(ours[0], plain[0]),
        inputs=ratio_of_means(ours[1], plain[1], root=True),
        states=ratio_of_means(ours[2], plain[2], root=True),
        size=size,
        unseen=unseen,
    )


def _squares(parts: "Sequence[Runs]") -> tuple[Array, Array, Array]:
    """Each run's mean a settled step of the quadratic cost, of |u|^2 and of |x|^2."""
    Q, R = parts[0].scenario.cost_weights
    costs, inputs, states = [], [], []
    for runs in parts:
        seen = runs.x if runs.truth is None else runs.truth
        assert seen is not None
        assert runs.u is not None
        x2, u2 = ((v[settling.BURN_IN :] ** 2).mean(axis=0) for v in (seen[1:], runs.u))
        costs.append(np.array(Q) @ x2 + np.array(R) @ u2)
        inputs.append(u2.sum(axis=0))
        states.append(x2.sum(axis=0))
    return np.concatenate(costs), np.concatenate(inputs), np.concatenate(states)


def ratio_of_means(above: Array, below: Array, *, root: bool = False) -> Interval:
    """Ratio of two means over runs, with its 95 % bootstrap interval.

    Parameters
    ----------
    above, below : array, shapes (R,) and (S,)
    root : bool
        Of the square root of the ratio.
    """
    power = 0.5 if root else 1.0
    draw = np.random.default_rng(1)
    tops = draw.choice(above, (DRAWS, len(above))).mean(axis=1)
    bottoms = draw.choice(below, (DRAWS, len(below))).mean(axis=1)
    low, high = np.quantile((tops / bottoms) ** power, (0.025, 0.975))
    return Interval(float((above.mean() / below.mean()) ** power), float(low), float(high))
