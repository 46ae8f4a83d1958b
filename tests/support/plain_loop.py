"""The plain way to run the loop, as the paper's own toolbox does: another road to the same runs.

One step solves both programs by OSQP, set up afresh on all rows of the target, and asks four linear
programs whether x(k+1) is in each candidate's Reach^c and Reach^e (remark 3 of the paper). The
index is found by scanning the sets. It shares nothing with the engine but the model and the sets.
"""

from dataclasses import dataclass

import numpy as np
import osqp
from scipy.optimize import linprog
from scipy.sparse import csc_matrix, eye, vstack

from controller_service.sets.design import Design, input_interval
from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.scenario import Scenario
from wyner.simulate.engine.draws import SeededDraws


@dataclass(frozen=True, eq=False)
class PlainRun:
    """One run.

    Parameters
    ----------
    symbols : list of int
        The key symbol of each transition in Diff, or -1.
    x : array, shape (n,)
        The last state.
    """

    symbols: list[int]
    x: Array


def reach_contains(centre: Array, H: Array, h: Array, x_next: Array) -> bool:
    """Whether some d with H d <= h has centre + d = x_next, by linear program."""
    n = len(centre)
    result = linprog(
        np.zeros(n), A_ub=H, b_ub=h, A_eq=np.eye(n), b_eq=x_next - centre, bounds=(None, None)
    )
    return bool(result.status == 0)


def solve(P: Array, q: Array, G: Array, b: Array, low: float, high: float) -> Array:
    """Minimise 1/2 u' P u + q' u with G u <= b and every u in [low, high], by OSQP."""
    m = len(q)
    solver = osqp.OSQP()
    solver.setup(
        P=csc_matrix(np.triu(P)),
        q=q,
        A=vstack([csc_matrix(G), eye(m)], format="csc"),
        l=np.concatenate([np.full(len(b), -np.inf), np.full(m, low)]),
        u=np.concatenate([b, np.full(m, high)]),
        eps_abs=1e-8,
        eps_rel=1e-8,
        max_iter=20000,
        verbose=False,
    )
    return np.asarray(solver.solve(raise_error=False).x)


def plain_run(scenario: Scenario, design: Design, *, seed: int, run: int, steps: int) -> PlainRun:
    """One run of the law ``sustained`` for a plant with one input and costs J_0 and J_1.

    Takes the same random draws as the engine's run of the same number.
    """
    A, B = design.A, design.B
    low, high = input_interval(scenario.control.inputs)
    Hc, hc = (np.array(a) for a in scenario.defender.disturbance.rows())
    He, he = (np.array(a) for a in scenario.eavesdropper_set.rows())
    d, coins = SeededDraws(scenario, seed, range(run, run + 1)).block(0, steps)
    forms = ((2 * B.T @ B, 2 * B.T @ A), (2 * np.eye(B.shape[1]), np.zeros_like(B.T)))
    x = np.array(scenario.initial_state)
    symbols = []
    for k in range(steps):
        i = next(j for j, (H, h) in enumerate(design.T) if (H @ x <= h).all())
        H, h = design.targets[max(i - 1, 0)]
        b = h * (1 - 1e-9) - H @ A @ x
        candidates = [solve(P, F @ x, H @ B, b, low, high) for P, F in forms]
        x_next = A @ x + B @ candidates[int(coins[k, 0])] + d[k, :, 0]
        predictions = [A @ x + B @ u for u in candidates]
        defender = [reach_contains(c, Hc, hc, x_next) for c in predictions]
        eavesdropper = [reach_contains(c, He, he, x_next) for c in predictions]
        in_diff = all(eavesdropper) and sum(defender) == 1
        symbols.append(defender.index(True) if in_diff else NO_SYMBOL)
        x = x_next
    return PlainRun(symbols, x)
