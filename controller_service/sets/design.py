"""Offline design: the terminal set T_0 and the one-step controllable sets T_1..T_N.

T_0 is an outer approximation of the minimal robust positively invariant set of
x+ = (A + B K) x + d, d in D_c; in the plane Rakovic's (Rakovic et al. 2005). Then
T_i = { x : there is u in U with A x + B u in T_{i-1} ~ D_c }, equation (26) read as (27) uses it:
eroded once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controller_service.sets.recursion import Recursion, recursion, support
from controller_service.sets.terminal import (
    SynthesisError,
    Terminal,
    TooSlowError,
    TooThinError,
    faster,
    feedback_gain,
    input_interval,
    set_corners,
    terminal_set,
)
from controller_service.sets.units import in_units
from controller_service.tolerances import SLOW_MARGINS, TERMINAL_MARGIN, THIN
from protocol.arrays import Array
from protocol.brief import Brief
from protocol.convex import Polytope, SetError, corners
from protocol.scenario import ConvexSet, Scenario

__all__ = [
    "Design",
    "Progress",
    "Start",
    "SynthesisError",
    "Terminal",
    "feedback_gain",
    "input_interval",
    "set_corners",
    "stated_start",
    "synthesise",
]

Progress = Callable[[int, int], None]

Start = tuple[Array, Polytope, Terminal]
"""K, T_0 and how it was made."""


@dataclass(frozen=True, eq=False, repr=False)
class Design(Brief):
    """The sets of one scenario.

    Parameters
    ----------
    A, B, K : array, shapes (n, n), (n, m), (m, n)
        Model and terminal gain.
    T : tuple of (H, h), shapes (r_i, n) and (r_i,)
        T_0..T_N, unit rows, irredundant; sorted by angle in the plane.
    targets : tuple of (H, h)
        T_i ~ D_c for i = 0..N, irredundant.
    terminal : Terminal
        How T_0 was made.
    gain_given : bool
        Whether K was stated (else it is a linear quadratic regulator's).
    margins : tuple of float
        Fraction by which the programs tighten each target; T_(i+1) was shrunk by twice that of
        target i, so that the tightened programs are feasible with as much to spare.
    seconds : float
        Time that the synthesis took.
    cached : bool
        Whether the design was read from the cache.
    stopped : bool
        Whether there are fewer sets than were asked because rounding would make more of them too
        large; else there are fewer where they stop growing.
    offsets : array, shape (M, m), optional
        Of a packed alphabet; the sets are then those of D' = D_c + B conv P and U' = U less conv P,
        and the targets T_i ~ D'.
    """

    A: Array
    B: Array
    K: Array
    T: tuple[tuple[Array, Array], ...]
    targets: tuple[tuple[Array, Array], ...]
    terminal: Terminal
    gain_given: bool
    margins: tuple[float, ...]
    seconds: float
    cached: bool = False
    stopped: bool = False
    offsets: Array | None = None

    def brief(self) -> dict[str, object]:
        """How many sets there are, how large, and K."""
        return {
            "horizon": self.horizon,
            "states": len(self.A),
            "inputs": self.B.shape[1],
            "facets": f"{min(self.facets)} to {max(self.facets)}",
            "K": self.K.tolist(),
        }

    @property
    def horizon(self) -> int:
        """N, the index of the largest set; below the scenario's when the sets stop growing."""
        return len(self.T) - 1

    @property
    def facets(self) -> tuple[int, ...]:
        """Number of facets of each T_i."""
        return tuple(len(h) for _, h in self.T)

    def set(self, i: int) -> tuple[Array, Array]:
        """T_i as (H, h)."""
        return self.T[i]

    def target(self, i: int) -> tuple[Array, Array]:
        """T_i ~ D_c as (H, h)."""
        return self.targets[i]


def candidate_target(design: Design, scenario: Scenario, i: int) -> tuple[Array, Array]:
    """Where each candidate of index i + 1 must lead: T_i ~ D_c as (H, h).

    With a packed alphabet the law's own target is smaller, T_i ~ D', for v that is no candidate.
    """
    if design.offsets is None:
        return design.target(i)
    H, h = design.set(i)
    return H, h - support(set_corners(scenario.control_set), H)


def _in_words(row: Array, allowed: ConvexSet, complaint: str) -> str:
    """What a row of a set bounds, as a reader of the file knows it."""
    name = "x" if complaint.startswith("control.states") else "u"
    places = np.flatnonzero(row)
    if allowed.half_widths is not None or len(places) == 1:
        j = int(places[0])
        scale = float(row[j])
        sign = "-" if scale < 0 else ""
        return f"{sign}{name}_{j + 1}" + ("" if abs(scale) == 1 else f" times {abs(scale):g}")
    terms = " ".join(f"{row[j]:+g} {name}_{j + 1}" for j in places)
    return terms.removeprefix("+")


def _remedy(complaint: str) -> str:
    if complaint.startswith("control.states"):
        return "; wider control.states, a smaller defender.disturbance or a faster K would do"
    return "; wider control.inputs, a smaller defender.disturbance or a softer K would do"


@dataclass(frozen=True, eq=False)
class InvariantSet:
    """A robust invariant set of u = K x, not yet held against the bounds.

    Parameters
    ----------
    K : array, shape (m, n)
    T0 : Polytope
        Robust invariant for D_c, with the programs' margin to spare.
    terminal : Terminal
        How it was made.
    reaches : tuple of array
        For each row of U, and of the state bounds where there are some: how far T_0 reaches, as a
        share of what the row allows. It grows in proportion to D_c.
    """

    K: Array
    T0: Polytope
    terminal: Terminal
    reaches: tuple[Array, ...]


def invariant_start(K: Array, scenario: Scenario) -> InvariantSet:
    """The terminal set of a gain, for a D_c that is larger by a margin.

    Raises
    ------
    SynthesisError
        When K gives none, or brings the state back too slowly.
    SetError
        When D_c is no compact set.
    """
    refused: SynthesisError | None = None
    for margin in (TERMINAL_MARGIN, *SLOW_MARGINS):
        larger = scenario.control_set.scaled(1 + margin)
        r = recursion(scenario)
        Ac = np.array(scenario.A) + np.array(scenario.B) @ K
        try:
            T0, terminal = terminal_set(Ac, larger)
            V = corners(T0.H, T0.h)
            _check_invariant(T0, Ac, r)
        except (TooSlowError, TooThinError) as error:
            refused = error
            continue
        reaches = []
        for points, allowed in _bounded(V, K, scenario):
            H, h = (np.array(a) for a in allowed.rows())
            reaches.append(support(points, H) / h)
        return InvariantSet(K, T0, terminal, tuple(reaches))
    assert refused is not None
    raise refused


def _bounded(V: Array, K: Array, scenario: Scenario) -> list[tuple[Array, ConvexSet]]:
    """The inputs and the states of T_0, whose corners are V, each with what bounds it."""
    control = scenario.control
    inputs = [(V @ K.T, control.inputs)]
    return inputs if control.states is None else [*inputs, (V, control.states)]


def _check_invariant(T0: Polytope, Ac: Array, r: Recursion) -> None:
    """T_0 is robust invariant under A + B K = Ac with the programs' margin to spare."""
    p = r.enter(T0)
    V, M = corners(p.H, p.h), in_units(Ac, r.units)
    added = support(r.DV, p.H)
    worst = float(((support(V @ M.T, p.H) + added) / p.h).max())
    # A state of T_0 then has u = K x as an answer to the programs with the tightened target 0.
    if not worst <= 1 - r.erode(p)[2]:
        if (added / p.h).min() < THIN:
            raise TooThinError(r.DV, np.abs(V @ M.T).max(axis=0))
        raise TooSlowError(
            f"control.gain: the terminal set is not invariant with a margin (reaches {worst:.9f} "
            f"of itself): K is too slow; {faster(Ac)}"
        )


def _check_bounds(found: InvariantSet, scenario: Scenario) -> None:
    """K T_0 within U, T_0 within X."""
    complaints = (
        "control.gain: K T_0 is not within control.inputs",
        "control.states: T_0 is not within the state bounds",
    )
    bounds = (scenario.control.inputs, scenario.control.states)
    for complaint, allowed, reach in zip(complaints, bounds, found.reaches, strict=False):
        if not (reach <= 1).all():
            assert allowed is not None  # it has a reach
            H, h = (np.array(a) for a in allowed.rows())
            j = int(reach.argmax())
            raise SynthesisError(
                f"{complaint}: {_in_words(H[j], allowed, complaint)} reaches "
                f"{reach[j] * h[j]:.6g}, expected at most {h[j]:.6g}{_remedy(complaint)}"
            )


def stated_start(scenario: Scenario) -> Start:
    """K and T_0 by the scenario's gain or regulator.

    Raises
    ------
    SynthesisError
        When they give no terminal set within the bounds.
    """
    K = feedback_gain(scenario)
    try:
        found = invariant_start(K, scenario)
    except SetError as error:
        raise SynthesisError(f"control.gain: no terminal set: {error}") from None
    _check_bounds(found, scenario)
    return K, found.T0, found.terminal


def synthesise(
    scenario: Scenario,
    progress: Progress | None = None,
    start: Callable[[Scenario], Start] = stated_start,
) -> Design:
    """Compute the sets for a scenario's D_c and U.

    Parameters
    ----------
    scenario : Scenario
    progress : callable, optional
        ``progress(done, total)`` is called after each set, T_0 among them.
    start : callable, optional
        K and T_0; by the scenario's gain or regulator if not given.

    Raises
    ------
    SynthesisError
        With one line: K does not stabilise, K T_0 not within U, an empty set at some index, or a
        plant with more states or inputs than the route serves.
    """
    import time

    begin = time.perf_counter()
    if scenario.n > 4 or scenario.m > 2:
        raise SynthesisError(
            f"plant: got {scenario.n} states and {scenario.m} inputs, expected 1 to 4 states and "
            "1 or 2 inputs; a law of your own may serve more, by sets of its own (control.law, "
            "docs/guides.md)"
        )
    r = recursion(scenario)
    K, T0, terminal = start(scenario)
    T: list[tuple[Array, Array]] = []
    targets: list[tuple[Array, Array]] = []
    margins: list[float] = []
    for i, p, q, deflation in r.run(T0, scenario.control.horizon):
        T.append((p.H, p.h))
        targets.append((q.H, q.h))
        margins.append(0.5 * deflation)
        if progress is not None:
            progress(i, scenario.control.horizon)
    return Design(
        A=np.array(scenario.A),
        B=np.array(scenario.B),
        K=K,
        T=tuple(T),
        targets=tuple(targets),
        terminal=terminal,
        gain_given=scenario.control.gain is not None,
        margins=tuple(margins),
        seconds=time.perf_counter() - begin,
        stopped=r.stopped,
    )
