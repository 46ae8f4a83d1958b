"""The design for a packed alphabet: its candidates count as a disturbance.

The law solves one program for v and offers v + p for each offset p. With D' = D_c + B conv P and
U' = U less conv P every one of these inputs is in U and leads into the next set, whatever d in D_c.
"""

from dataclasses import replace

import numpy as np

from controller_service.sets.alphabet import (
    Alphabet,
    ceilings,
    choose_alphabet,
    control_allows,
    larger_disturbance,
    smaller_inputs,
)
from controller_service.sets.design import Start, stated_start
from controller_service.sets.gains import find_gain, plain_weights, with_gain
from controller_service.sets.recursion import Recursion, recursion, support
from controller_service.sets.separation import AlphabetError
from controller_service.sets.terminal import SynthesisError, Terminal, TooThinError
from controller_service.tolerances import LARGEST_SPREAD, TERMINAL_MARGIN
from protocol.convex import Polytope, SetError, corners
from protocol.scenario import Regulator, Scenario

WEIGHTS = sorted((10.0 ** (k / 5) for k in range(-15, 11)), key=lambda f: abs(float(np.log(f))))
"""Factors on a regulator's weights of the input, 0.001 to 100, the nearest to 1 first."""

STEPS = 200
"""Steps after which no invariant set is expected any more."""

MOST_ROWS = 50_000
"""Facets of all the sets that are met on the way to an invariant one, about 20 s of work with four
states; with two the steps end first."""

MOST_FACETS = 5_000
"""Facets of one of them."""


def alphabet_of(scenario: Scenario, spacing: float) -> Alphabet:
    """The alphabet of a scenario, its offsets ``spacing`` half-lengths of D_c apart.

    Raises
    ------
    SynthesisError
        With one line, where it does not fit; the line names the most candidates that do.
    """
    D_c, U = scenario.defender.disturbance, scenario.control.inputs
    try:
        limits = ceilings(scenario.A, scenario.B, scenario.control_set, U)

        def of(size: int) -> Alphabet:
            return choose_alphabet(
                scenario.B,
                D_c,
                U,
                alpha=scenario.secrecy.alpha,
                size=size,
                spacing=spacing,
                shape=scenario.secrecy.disturbance,
                tested=None if scenario.defender.noise is None else scenario.test_set,
            )

        size = scenario.secrecy.candidates
        alphabet = of(size)
        if control_allows(limits, scenario.B, alphabet.offsets):
            return alphabet
        while size > 1 and not control_allows(limits, scenario.B, of(size).offsets):
            size -= 1
    except (AlphabetError, SetError) as error:
        raise SynthesisError(str(error)) from None
    raise SynthesisError(
        f"secrecy.candidates: got {scenario.secrecy.candidates}, expected at most {size}: beside a "
        "larger alphabet control.inputs cannot hold the plant's unstable modes against D_c"
    )


def reduced(scenario: Scenario, alphabet: Alphabet) -> Scenario:
    """The scenario with D' for D_c (or for ``control.disturbance``) and U' for U."""
    inputs = smaller_inputs(scenario.control.inputs, alphabet.offsets)
    assert inputs is not None  # choose_alphabet saw to it
    disturbance = larger_disturbance(scenario.control_set, scenario.B, alphabet.offsets)
    return scenario.model_copy(
        update={
            "defender": scenario.defender.model_copy(
                update={"disturbance": disturbance, "noise": None}
            ),
            "control": scenario.control.model_copy(update={"inputs": inputs, "disturbance": None}),
        }
    )


def search_terminal(problem: Scenario) -> Start:
    """T_0 by the stated gain or regulator, the nearest regulator or one that decays, or no gain.

    Parameters
    ----------
    problem : Scenario
        With D' and U'.

    Raises
    ------
    SynthesisError
        When no bounded invariant set exists.
    """
    try:
        return stated_start(problem)
    except TooThinError:
        raise
    except SynthesisError:
        pass
    found = nearest_regulator(problem)
    if found is not None:
        return found
    decaying = find_gain(problem, shares=(1.0,))
    if decaying is not None:
        K, T0, terminal = stated_start(with_gain(problem, decaying.K))
        return K, T0, replace(terminal, decay=decaying.decay)
    T0, terminal = invariant_set(problem)
    return np.zeros((problem.m, problem.n)), T0, terminal


def nearest_regulator(problem: Scenario) -> Start | None:
    """K and T_0 by the regulator nearest to the stated weights that gives them, or None."""
    stated = problem.control.regulator
    weights = stated or plain_weights(problem)
    for factor in WEIGHTS:
        regulator = Regulator(
            next_state=weights.next_state, input=tuple(factor * w for w in weights.input)
        )
        control = problem.control.model_copy(update={"gain": None, "regulator": regulator})
        try:
            K, T0, terminal = stated_start(problem.model_copy(update={"control": control}))
        except SynthesisError:
            continue
        return K, T0, replace(terminal, weight=factor)
    return None


def invariant_set(problem: Scenario) -> tuple[Polytope, Terminal]:
    """The maximal robust controlled invariant set within the state bounds, with a margin.

    The recursion runs from the state bounds inwards, for a disturbance larger by
    ``TERMINAL_MARGIN``; it may end once every state can be kept against the disturbance itself.

    Raises
    ------
    SynthesisError
        When the bounds are not compact, or no set is left.
    """
    states = problem.control.states
    if states is None:
        raise SynthesisError(
            "control.states: got none, expected a compact set: no gain keeps a set, and without a "
            "gain the sets begin with the bounds"
        )
    larger = problem.defender.disturbance.scaled(1 + TERMINAL_MARGIN)
    wide = recursion(
        problem.model_copy(
            update={"defender": problem.defender.model_copy(update={"disturbance": larger})}
        )
    )
    exact = recursion(problem)
    try:
        corners(*(np.array(a) for a in states.rows()))
    except SetError as error:
        raise SynthesisError(f"control.states: {error}, expected a compact set") from None
    rows = wide.enter(Polytope.from_rows(*states.rows()))
    met = 0
    try:
        for step in range(STEPS):
            T, S, deflation = wide.erode(rows)
            met += T.facets
            if met > MOST_ROWS or T.facets > MOST_FACETS or wide.spread > LARGEST_SPREAD:
                break
            own = wide.leave(T)
            if step and kept(exact, exact.enter(own)):
                radius = float(np.abs(corners(own.H, own.h)).max())
                return own, Terminal("invariant", step, 0.0, radius)
            rows = wide.backward(S, deflation)
    except SetError:
        raise SynthesisError(
            "control.states: no state within them can be kept there against D_c and the alphabet, "
            "expected wider bounds, larger inputs or fewer candidates"
        ) from None
    raise SynthesisError(
        f"control.states: no invariant set after {step + 1} steps of the recursion from them, with "
        f"{met} facets in all; narrower bounds, wider control.inputs, a smaller "
        "defender.disturbance, fewer candidates, or a control.gain that keeps a set would do"
    )


def kept(r: Recursion, T: Polytope) -> bool:
    """Whether every state of T has an input into the target, tightened as the programs are."""
    T, S, deflation = r.erode(T)
    before = r.backward(S.scaled(1 - 2 * deflation), 0.0)
    return bool((support(corners(T.H, T.h), before.H) <= before.h).all())
