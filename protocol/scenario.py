"""Scenario files: a plant, its sets, its control law and what the defender shares, in TOML.

The paper's numbers stand once, in ``scenarios/paper.toml``. A plant of one's own is a new file and
no code. Everything here is the defender's knowledge; an eavesdropper is handed a
:class:`protocol.knowledge.Knowledge` made from it, and never this.
"""

import hashlib
import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    ValidationError,
    field_validator,
    model_validator,
)

from protocol.knowledge import Knowledge, Policy, PolicyCost

Vector = tuple[FiniteFloat, ...]
Matrix = tuple[Vector, ...]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]

RULES_VERSION = 2
"""Version of agreement, automata and framing together; part of the fingerprint."""

DESIGN_VERSION = 1
"""Version of the synthesis; part of the key of a cached design."""


class ScenarioError(Exception):
    """A scenario that cannot be used; ``problems`` holds one line for each wrong field."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


class Part(BaseModel):
    """A table of a scenario file: unknown fields are errors, values cannot change."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _check_matrix(matrix: Matrix) -> Matrix:
    if not matrix or not matrix[0]:
        raise ValueError("expected at least one row and one column")
    if len({len(row) for row in matrix}) != 1:
        raise ValueError("expected rows of one length")
    return matrix


class ConvexSet(Part):
    """A compact convex set with the origin inside: a box or the polytope { v : H v <= h }.

    Parameters
    ----------
    half_widths : tuple of float, shape (n,), optional
        The box of vectors with ``abs(v_i) <= half_widths_i``.
    H, h : tuple, shapes (rows, n) and (rows,), optional
        The polytope; every entry of ``h`` positive, so that the origin is inside.
    """

    half_widths: tuple[Positive, ...] | None = None
    H: Matrix | None = None
    h: tuple[Positive, ...] | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.half_widths is not None:
            if self.H is not None or self.h is not None:
                raise ValueError("expected half_widths, or H and h, and not both")
            if not self.half_widths:
                raise ValueError("expected at least one half-width")
            return self
        if self.H is None or self.h is None:
            raise ValueError("expected half_widths = [...], or H = [[...], ...] and h = [...]")
        _check_matrix(self.H)
        if len(self.H) != len(self.h):
            raise ValueError(f"expected as many entries in h as rows in H ({len(self.H)})")
        return self

    @property
    def dimension(self) -> int:
        """Number of components of the set's vectors."""
        if self.half_widths is not None:
            return len(self.half_widths)
        assert self.H is not None
        return len(self.H[0])

    def rows(self) -> tuple[Matrix, Vector]:
        """The set as (H, h) with H v <= h, for a box the rows e_i and -e_i in turn."""
        if self.half_widths is None:
            assert self.H is not None
            assert self.h is not None
            return self.H, self.h
        n = len(self.half_widths)
        unit = [tuple(1.0 if j == i else 0.0 for j in range(n)) for i in range(n)]
        rows = [row for e in unit for row in (e, tuple(-v for v in e))]
        return tuple(rows), tuple(w for w in self.half_widths for _ in range(2))

    def scaled(self, factor: float) -> "ConvexSet":
        """The set ``factor`` times as large."""
        if self.half_widths is not None:
            return ConvexSet(half_widths=tuple(factor * w for w in self.half_widths))
        assert self.h is not None
        return ConvexSet(H=self.H, h=tuple(factor * b for b in self.h))


class Disturbance(Part):
    """What the simulated plant really suffers: d(k), drawn from ``n`` uniform numbers a step.

    ``uniform`` draws from the box D; ``corners`` from its corners; ``truncated-gaussian`` and
    ``gaussian`` have standard deviation ``deviation`` times the half-width (the second leaves D);
    ``constant`` is the corner ``bias`` times the half-width; ``sinusoid`` has the half-width as its
    amplitude and ``cycle_steps`` steps to a cycle.
    """

    kind: Literal[
        "uniform", "corners", "truncated-gaussian", "gaussian", "constant", "sinusoid"
    ] = "uniform"
    half_widths: tuple[Annotated[float, Field(ge=0, allow_inf_nan=False)], ...]
    deviation: Positive = 0.5
    bias: Annotated[float, Field(ge=-1, le=1)] = 1.0
    cycle_steps: Annotated[int, Field(ge=2)] = 20
    may_leave_defender_set: bool = False


class Plant(Part):
    """The plant that is simulated: x+ = A x + B u + d, every ``period_s`` seconds."""

    A: Matrix
    B: Matrix
    period_s: Positive
    initial_state: Vector
    disturbance: Disturbance

    _matrices = field_validator("A", "B")(_check_matrix)


class Defender(Part):
    """The identified model (5): A and B (the plant's own where not given) and D_c."""

    A: Matrix | None = None
    B: Matrix | None = None
    disturbance: ConvexSet


Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]


def _form(value: object) -> str:
    return "entries" if isinstance(value, list | tuple) else "number"


Weights = Annotated[
    Annotated[Weight, Tag("number")] | Annotated[tuple[Weight, ...], Tag("entries")],
    Discriminator(_form),
]
"""One weight for all components, or one for each; a wrong one is one error, not one a form."""


class Cost(Part):
    """J(u) = (A x + B u)' diag(next_state) (A x + B u) + u' diag(input) u."""

    next_state: Weights = 0.0
    input: Weights = 0.0


class Regulator(Part):
    """Weights of the linear quadratic regulator that gives K where no gain is stated."""

    next_state: tuple[Annotated[float, Field(ge=0)], ...]
    input: tuple[Positive, ...]


class Control(Part):
    """The control law (27): sets, terminal gain, horizon and the two costs."""

    law: Literal["paper", "sustained"] = "sustained"
    horizon: Annotated[int, Field(ge=1, le=10000)]
    inputs: ConvexSet
    states: ConvexSet | None = None
    gain: Matrix | None = None
    regulator: Regulator | None = None
    terminal_order: Annotated[int, Field(ge=1, le=200)] | None = None
    costs: tuple[Cost, ...] = (Cost(next_state=1.0), Cost(input=1.0))

    @model_validator(mode="after")
    def _one_gain(self) -> Self:
        if (self.gain is None) == (self.regulator is None):
            raise ValueError("expected gain = [[...]] or a table regulator, and one of them only")
        if self.gain is not None:
            _check_matrix(self.gain)
        return self


class Secrecy(Part):
    """The agreement rule's public-by-assumption half: D_e = alpha D_c, and M candidates."""

    alpha: Annotated[float, Field(ge=1, allow_inf_nan=False)]
    candidates: Annotated[int, Field(ge=2, le=256)] = 2


class Link(Part):
    """How the loop behaves when the network does not."""

    fallback: Literal["hold", "zero"] = "hold"
    repeats_per_period: Annotated[int, Field(ge=1, le=100)] = 4


class TapView(Part):
    """What the tap sees of the field bus, and how well."""

    eavesdroppers: tuple[str, ...] = ()
    view: Literal["both", "measurements", "offers"] = "both"
    loss: Annotated[float, Field(ge=0, le=1)] = 0.0
    noise: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    quantise: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    delay: Annotated[int, Field(ge=0)] = 0
    model_error: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0


class Scenario(Part):
    """One system: plant, defender's model, law, agreement rule, link and tap."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]
    description: str = ""
    source: str = ""
    plant: Plant
    defender: Defender
    control: Control
    secrecy: Secrecy
    link: Link = Link()
    tap: TapView = TapView()

    @property
    def A(self) -> Matrix:
        """State matrix of the defender's model f_c, shape (n, n)."""
        return self.defender.A or self.plant.A

    @property
    def B(self) -> Matrix:
        """Input matrix of the defender's model f_c, shape (n, m)."""
        return self.defender.B or self.plant.B

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.plant.A)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.plant.B[0])

    @model_validator(mode="after")
    def _shapes_fit(self) -> Self:
        problems = list(_shape_problems(self))
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def fingerprint(self) -> str:
        """SHA-256 (hex) over what both ends must share for their verdicts to be the same.

        Compared over ops only: on the field bus it would let an eavesdropper test her guesses.
        """
        return _digest(
            {
                "rules": RULES_VERSION,
                "A": self.A,
                "B": self.B,
                "D_c": self.defender.disturbance.model_dump(exclude_none=True),
                "U": self.control.inputs.model_dump(exclude_none=True),
                "alpha": self.secrecy.alpha,
                "candidates": self.secrecy.candidates,
                "period_s": self.plant.period_s,
            }
        )

    def design_fingerprint(self) -> str:
        """SHA-256 (hex) over what the synthesis depends on; the key of a cached design."""
        control = self.control.model_dump(exclude={"law", "costs"}, exclude_none=True)
        return _digest(
            {
                "design": DESIGN_VERSION,
                "A": self.A,
                "B": self.B,
                "D_c": self.defender.disturbance.model_dump(exclude_none=True),
                "control": control,
            }
        )

    def knowledge(self) -> Knowledge:
        """What the paper's eavesdropper knows: f_c, D_e and the control policy, not D_c."""
        H, h = self.defender.disturbance.scaled(self.secrecy.alpha).rows()
        return Knowledge(
            scenario=self.name,
            period_s=self.plant.period_s,
            candidates=self.secrecy.candidates,
            A=self.A,
            B=self.B,
            disturbance_H=H,
            disturbance_h=h,
            policy=self._policy(),
        )

    def _policy(self) -> Policy:
        """The control policy (15) without what depends on D_c."""
        costs = tuple(
            PolicyCost(
                next_state=_spread(cost.next_state, self.n), input=_spread(cost.input, self.m)
            )
            for cost in self.control.costs
        )
        return Policy(law=self.control.law, costs=costs, gain=self.control.gain)

    def oracle_knowledge(self) -> Knowledge:
        """What the defender knows, in the form a tap reads: the control of the measurement."""
        return self.knowledge().model_copy(update={"alpha": self.secrecy.alpha})


def _spread(weights: float | tuple[float, ...], size: int) -> tuple[float, ...]:
    return weights if isinstance(weights, tuple) else (weights,) * size


def _digest(value: object) -> str:
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


def _shape(matrix: Matrix) -> tuple[int, int]:
    return len(matrix), len(matrix[0])


def _shape_problems(s: Scenario) -> list[str]:
    n, m = s.n, s.m
    problems = []

    def expect(path: str, got: object, expected: object) -> None:
        if got != expected:
            problems.append(f"{path}: got shape {got}, expected {expected}")

    expect("plant.A", _shape(s.plant.A), (n, n))
    expect("plant.B", _shape(s.plant.B), (n, m))
    expect("plant.initial_state", len(s.plant.initial_state), n)
    expect("plant.disturbance.half_widths", len(s.plant.disturbance.half_widths), n)
    if s.defender.A is not None:
        expect("defender.A", _shape(s.defender.A), (n, n))
    if s.defender.B is not None:
        expect("defender.B", _shape(s.defender.B), (n, m))
    expect("defender.disturbance", s.defender.disturbance.dimension, n)
    expect("control.inputs", s.control.inputs.dimension, m)
    if s.control.states is not None:
        expect("control.states", s.control.states.dimension, n)
    if s.control.gain is not None:
        expect("control.gain", _shape(s.control.gain), (m, n))
    if s.control.regulator is not None:
        expect("control.regulator.next_state", len(s.control.regulator.next_state), n)
        expect("control.regulator.input", len(s.control.regulator.input), m)
    if len(s.control.costs) != s.secrecy.candidates:
        problems.append(
            f"control.costs: got {len(s.control.costs)} costs, expected one for each of the "
            f"{s.secrecy.candidates} candidates (secrecy.candidates)"
        )
    for i, cost in enumerate(s.control.costs):
        for name, weights, size in (
            ("next_state", cost.next_state, n),
            ("input", cost.input, m),
        ):
            if isinstance(weights, tuple):
                expect(f"control.costs.{i}.{name}", len(weights), size)
    if not problems:
        problems += _disturbance_problems(s)
    return problems


def _disturbance_problems(s: Scenario) -> list[str]:
    d = s.plant.disturbance
    if d.may_leave_defender_set or d.kind == "gaussian":
        return []
    H, h = s.defender.disturbance.rows()
    for row, bound in zip(H, h, strict=True):
        reach = sum(abs(a) * w for a, w in zip(row, d.half_widths, strict=True))
        if reach > bound * (1 + 1e-12):
            return [
                f"plant.disturbance.half_widths: got {list(d.half_widths)}, expected a box inside "
                "defender.disturbance (D within D_c), or may_leave_defender_set = true"
            ]
    return []


def describe_errors(error: ValidationError, source: str) -> list[str]:
    """One line for each wrong field: the file, the field's path, the value, what was expected."""
    lines = []
    for item in error.errors(include_url=False):
        path = ".".join(str(part) for part in item["loc"] if part not in ("number", "entries"))
        message = item["msg"].removeprefix("Value error, ")
        if item["type"] == "value_error" and not path:
            lines += [f"{source}: {part}" for part in message.split("; ")]
            continue
        try:
            value = json.dumps(item["input"], default=str)
        except ValueError:  # 0x... may be longer than Python writes out
            value = "an endless number"
        shown = value if len(value) <= 60 else value[:57] + "..."
        got = "" if item["type"] == "missing" else f" got {shown},"
        lines.append(f"{source}: {path}:{got} {message[0].lower()}{message[1:]}")
    return lines


def parse_scenario(data: dict[str, Any], source: str) -> Scenario:
    """Build a scenario from parsed TOML.

    Raises
    ------
    ScenarioError
        With one line for each wrong field; shapes are compared once every field by itself is right.
    """
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(describe_errors(error, source)) from None


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file.

    Raises
    ------
    ScenarioError
        When the file cannot be read, is not TOML, or has a wrong field.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ScenarioError([f"{path}: cannot be read: {reason}"]) from None
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of a huge number, or of nested brackets
        raise ScenarioError([f"{path}: not TOML: {error}"]) from None
    return parse_scenario(data, str(path))
