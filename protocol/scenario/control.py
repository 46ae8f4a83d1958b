"""``[control]``: what every control law of (27) is told; a law of its own adds its own table."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Self

from pydantic import Discriminator, Field, Tag, model_validator

from protocol.knowledge import NotNegative, Policy, PolicyCost
from protocol.plugins import names_a_file
from protocol.scenario.parts import Positive, ScenarioTable, check_matrix, shape, shape_problem
from protocol.scenario.secrecy import Secrecy
from protocol.scenario.sets import ConvexSet, Resisted, set_problem
from protocol.vectors import FiniteMatrix


def _form(value: object) -> str:
    return "entries" if isinstance(value, list | tuple) else "number"


Weights = Annotated[
    Annotated[NotNegative, Tag("number")] | Annotated[tuple[NotNegative, ...], Tag("entries")],
    Discriminator(_form),
]
"""One weight for all components, or one for each; a wrong one is one error, not one a form."""


class Cost(ScenarioTable):
    """J(u) = (A x + B u)' diag(next_state) (A x + B u) + u' diag(input) u."""

    next_state: Weights = 0.0
    """Weight of the next state: one number, or one a state."""
    input: Weights = 0.0
    """Weight of the input: one number, or one an input."""


class Regulator(ScenarioTable):
    """Weights of the linear quadratic regulator that gives K where no gain is stated."""

    next_state: tuple[Annotated[float, Field(ge=0)], ...]
    """Weights of the state, n numbers."""
    input: tuple[Positive, ...]
    """Weights of the input, m numbers above 0; large ones make a slow loop and larger sets."""


class Performance(ScenarioTable):
    """Weights by which a loop is judged: x(k+1)' diag(next_state) x(k+1) + u' diag(input) u a step.

    They change nothing that the loop does.
    """

    next_state: tuple[NotNegative, ...]
    """Weights of the state that a step leads to, n numbers."""
    input: tuple[NotNegative, ...]
    """Weights of the input that was applied, m numbers."""


class Control(ScenarioTable):
    """The control law (27): sets, terminal gain, horizon and the costs.

    A law with fields of its own reads a subclass, :data:`protocol.scenario.kinds.LAWS`. The sets
    resist ``disturbance``, which contains D_c, and D_c itself where it is not given.
    """

    needs_gain: ClassVar[bool] = True
    knows_alpha: ClassVar[bool] = False
    law: str = "sustained"
    """How the candidates are computed: a shipped law, or ``path/to/file.py:Name``."""
    horizon: Annotated[int, Field(ge=1, le=10000)]
    """Sets T_1 to T_N to compute: from farther out the loop can start, and N costs time."""
    inputs: ConvexSet
    """U, which no input leaves."""
    states: ConvexSet | None = None
    """X, which no state may leave; none where not given."""
    disturbance: Resisted | None = None
    """What the sets resist; D_c where not given, and it contains D_c."""
    gain: FiniteMatrix | None = None
    """K of u = K x near the origin, m rows of n numbers; or `regulator`."""
    regulator: Regulator | None = None
    """Weights from which K is computed; or `gain`."""
    performance: Performance | None = None
    """Weights of the control cost that a run reports; the regulator's, or ones, where not given."""
    costs: tuple[Cost, ...] = (Cost(next_state=1.0), Cost(input=1.0))
    """One program a candidate: costs that differ keep the candidates apart."""

    @model_validator(mode="after")
    def _one_gain(self) -> Self:
        both, none = self.gain and self.regulator, not (self.gain or self.regulator)
        if both or (none and self.needs_gain):
            raise ValueError("expected gain = [[...]] or a table regulator, and one of them only")
        if self.gain is not None:
            check_matrix(self.gain)
        return self

    def problems(self, n: int, m: int, candidates: int) -> Iterator[str]:
        """What does not fit a plant of ``n`` states and ``m`` inputs, a line each."""
        yield from set_problem("control.inputs", self.inputs, m)
        if self.states is not None:
            yield from shape_problem("control.states", self.states.dimension, n)
        yield from set_problem("control.disturbance", self.disturbance, n)
        if self.gain is not None:
            yield from shape_problem("control.gain", shape(self.gain), (m, n))
        for name in ("regulator", "performance"):
            table: Regulator | Performance | None = getattr(self, name)
            if table is not None:
                at = f"control.{name}"
                yield from shape_problem(f"{at}.next_state", len(table.next_state), n)
                yield from shape_problem(f"{at}.input", len(table.input), m)
        yield from self.count_problems(candidates)
        for i, cost in enumerate(self.costs):
            for name, weights, size in (
                ("next_state", cost.next_state, n),
                ("input", cost.input, m),
            ):
                if isinstance(weights, tuple):
                    yield from shape_problem(f"control.costs.{i}.{name}", len(weights), size)

    def count_problems(self, candidates: int) -> Iterator[str]:
        """Whether the law makes as many candidates as ``secrecy.candidates`` says."""
        if len(self.costs) != candidates:
            yield (
                f"control.costs: got {len(self.costs)} costs, expected one for each of the "
                f"{candidates} candidates (secrecy.candidates)"
            )

    def why_unseen(self) -> Iterator[str]:
        """Why a coin that comes from keys would not catch a spoofed sensor under this law."""
        if not names_a_file(self.law):
            yield (
                f"control.law = {self.law!r} does not keep its candidates apart, expected 'packed'"
            )

    def design_key(self, secrecy: Secrecy) -> dict[str, Any]:  # noqa: ARG002
        """What of the law the synthesis depends on; its costs are only solved online."""
        return self.model_dump(
            exclude={"law", "costs", "disturbance", "performance"}, exclude_none=True
        )

    def policy(self, n: int, m: int) -> Policy:
        """The control policy (15) that Kerckhoffs grants the tap, without what depends on D_c."""
        costs = tuple(
            PolicyCost(next_state=_spread(cost.next_state, n), input=_spread(cost.input, m))
            for cost in self.costs
        )
        regulator = None
        if self.regulator is not None:
            regulator = PolicyCost(next_state=self.regulator.next_state, input=self.regulator.input)
        return Policy(law=self.law, costs=costs, gain=self.gain, regulator=regulator)


def _spread(weights: float | tuple[float, ...], size: int) -> tuple[float, ...]:
    return weights if isinstance(weights, tuple) else (weights,) * size
