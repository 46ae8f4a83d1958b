"""What an eavesdropper may know: a value that is handed to it.

The tap imports this and never :mod:`protocol.scenario`, so that nothing in it can look up D_c, the
message or a key. Every optional field left out is something Eve does not know.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from protocol.brief import Brief
from protocol.secret.bound import Assumption
from protocol.vectors import Matrix, Vector

Direction = Literal["both", "measurements", "offers"]
Loss = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Delay = Annotated[int, Field(ge=0, le=100_000)]
"""Limits of a tap view's settings, for the scenario's table and the options alike."""


class PolicyCost(BaseModel):
    """One cost: J(u) = (A x + B u)' diag(next_state) (A x + B u) + u' diag(input) u.

    Parameters
    ----------
    next_state : tuple of float, shape (n,)
    input : tuple of float, shape (m,)
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    next_state: Vector
    input: Vector


class Policy(BaseModel):
    """The control policy (15), which the paper's section 4.2 grants Eve after Kerckhoffs.

    Neither D_c nor the sets T_i, which depend on it, are part of it.

    Parameters
    ----------
    law : str
        The law's name.
    costs : tuple of PolicyCost
        J_0, J_1, ..., one for each candidate; or one, beside whose minimiser the candidates
        stand at fixed offsets.
    gain : tuple of tuple of float, shape (m, n), optional
        K of the terminal set; None where the designer did not state one.
    together : bool
        Whether every candidate is K x inside the terminal set.
    certain : bool
        Whether the candidates stand so far apart that every transition agrees.
    regulator : PolicyCost, optional
        Weights of the regulator from which K is computed, where the designer stated these instead.
    spacing : float, optional
        Distance of neighbouring candidates at fixed offsets, in half-lengths of D_c.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    law: str
    costs: tuple[PolicyCost, ...]
    gain: Matrix | None = None
    together: bool = False
    certain: bool = False
    regulator: PolicyCost | None = None
    spacing: float | None = None


class Knowledge(Brief, BaseModel):
    """An eavesdropper's model (10): f_c and D_e, after the paper's assumption 2.

    Parameters
    ----------
    scenario : str
        Name of the system, for the record.
    period_s : float
        Sampling time in seconds.
    candidates : int
        M, the number of candidates an offer carries; visible on the wire.
    scheme : str
        Which scheme both ends follow: an algorithm, and so public.
    A, B : tuple of tuple of float, shapes (n, n) and (n, m), optional
        Eve's nominal model; None when Eve has none.
    disturbance_H, disturbance_h : tuple, shapes (rows, n) and (rows,), optional
        D_e = { d : H d <= h }.
    policy : Policy, optional
        The control policy, as far as it does not depend on D_c.
    alpha : float, optional
        D_e over D_c, or over the shape that it has of its own. Only the oracle, which knows what
        the defender knows, is told.
    defender_H, defender_h : tuple, shapes (rows, n) and (rows,), optional
        D_c, where D_e has a shape of its own. Only the oracle is told.
    deviations : tuple of float, shape (n,), optional
        Of a Gaussian d as Eve takes it, alpha times the ends'; both ends take the likeliest
        candidate.
    noisy : bool
        The plant's sensors are noisy, which is public; how much they are is not.
    C : tuple of tuple of float, shape (r, n), optional
        What is read of the state, y = C x + n; None where all of it is.
    keys : Assumption, optional
        What is claimed of every tap, which is public; None where no keys are made.
    digits : int
        Digits of the key stream that an offer takes, which is public.
    noise, quantise : float
        Of Eve's own receiver: standard deviation of its noise, and the step to which it rounds.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    scenario: str
    period_s: float
    candidates: int
    scheme: str = "switched"
    A: Matrix | None = None
    B: Matrix | None = None
    disturbance_H: Matrix | None = None
    disturbance_h: Vector | None = None
    policy: Policy | None = None
    alpha: float | None = None
    defender_H: Matrix | None = None
    defender_h: Vector | None = None
    deviations: Vector | None = None
    noisy: bool = False
    C: Matrix | None = None
    keys: Assumption | None = None
    digits: int = 0
    noise: float = 0.0
    quantise: float = 0.0

    def without_secrets(self) -> "Knowledge":
        """The same for one who is no oracle: neither alpha nor D_c."""
        return self.model_copy(update={"alpha": None, "defender_H": None, "defender_h": None})

    def brief(self) -> dict[str, object]:
        """Of which system it is, and what of it Eve knows."""
        told = ("A", "B", "disturbance_H", "policy", "alpha", "keys")
        return {
            "scenario": self.scenario,
            "candidates": self.candidates,
            "scheme": self.scheme,
            "knows": [name for name in told if getattr(self, name) is not None],
        }
