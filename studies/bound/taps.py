"""Taps that watch the linear loop through noise, measured beside the bound: none may be below it.

`told d` is no tap that there is: she is told every disturbance, and so is as strong as the bound's
own. `law of d` knows the model and the deviation of d, and takes it for Gaussian. Both weigh every
sequence of a short block of coins, so nothing is left out. `text` is the project's own, on a
run of the same loop of which she hears the measurements through the same noise.
"""

import itertools
import math
from typing import Final, NamedTuple

import numpy as np

from controller_service.laws.registry import cached_design, make_law
from protocol.arrays import Array
from protocol.scenario import Scenario
from studies.bound.loop import LinearLoop
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.text import Text
from wyner.simulate.engine import simulate_runs

TAIL: Final = 16
"""Steps that she goes on watching after a block's last coin."""

LEAST: Final = 1e-3
"""Probability below which a tap's posterior of a symbol is taken to be no surer."""


class Left(NamedTuple):
    """What a tap leaves of a coin, and the share of blocks that she has whole (a coin: `text`).

    Parameters
    ----------
    bits, bits_error : float
        Cross-entropy of her posterior at the truth, a coin, and its standard error.
    whole, whole_error : float
    """

    bits: float
    bits_error: float
    whole: float
    whole_error: float


def response(F: Array, B: Array, steps: int, times: int) -> Array:
    """x(1), ..., x(steps), of pushes through B at 0, ..., times - 1; shape (n steps, m times)."""
    n, m = B.shape
    out = np.zeros((steps, n, times, m))
    power = np.eye(n)
    for lag in range(1, steps + 1):
        block = power @ B
        for t in range(min(times, steps - lag + 1)):
            out[t + lag - 1, :, t] = block
        power = F @ power
    return out.reshape(n * steps, m * times)


def block_left(
    loop: LinearLoop,
    disturbance: Array,
    noise: float,
    coins: int,
    draws: int,
    seed: int,
    *,
    told: bool,
) -> Left:
    """What one leaves who weighs every sequence of ``coins`` coins; d uniform in a box.

    Parameters
    ----------
    loop : LinearLoop
    disturbance : array, shape (n,)
        Half-widths of the box of d.
    noise : float
        Standard deviation on every state that she reads.
    coins, draws : int
        Of a block, and how many blocks are drawn.
    seed : int
    told : bool
        Whether she is told every d, or its deviation alone.
    """
    rng = np.random.default_rng(seed)
    F, n = loop.A + loop.B @ loop.K, len(loop.A)
    M, m = loop.offsets.shape
    steps = coins + TAIL
    S = response(F, loop.B, steps, coins)
    G = response(F, np.eye(n), steps, steps)
    covariance = noise**2 * np.eye(n * steps)
    if not told:
        covariance = covariance + G @ np.diag(np.tile(disturbance**2 / 3, steps)) @ G.T
    weights = np.linalg.solve(covariance, S)  # covariance^-1 S
    words = np.array(list(itertools.product(range(M), repeat=coins)))
    sent = loop.offsets[words].reshape(len(words), coins * m)
    energy = 0.5 * ((sent @ (S.T @ weights)) * sent).sum(axis=1)
    drawn = rng.integers(0, len(words), draws)
    d = rng.uniform(-1, 1, (draws, steps, n)) * disturbance
    y = sent[drawn] @ S.T + noise * rng.standard_normal((draws, n * steps))
    if not told:
        y = y + d.reshape(draws, -1) @ G.T
    surprise, right = np.empty(draws), np.empty(draws)
    for first in range(0, draws, 500):
        part = slice(first, min(first + 500, draws))
        score = (y[part] @ weights) @ sent.T - energy
        score -= score.max(axis=1, keepdims=True)
        posterior = np.exp(score)
        posterior /= posterior.sum(axis=1, keepdims=True)
        true = posterior[np.arange(len(posterior)), drawn[part]]
        surprise[part] = -np.log2(np.maximum(true, 1e-300)) / coins
        # the mean of the largest posterior is P_g, where the posterior is the true one
        right[part] = posterior.max(axis=1) if told else posterior.argmax(axis=1) == drawn[part]
    return Left(*_mean(surprise), *_mean(right))


def text_left(scenario: Scenario, noise: float, steps: int, runs: int, seed: int) -> Left:
    """What `text` leaves, who is told the policy and hears measurements alone.

    The loop begins at the origin, where no constraint is ever active.
    """
    rng = np.random.default_rng(seed)
    view = View(view="measurements", noise=noise)
    start = {"initial_state": (0.0,) * scenario.n}
    there = scenario.model_copy(update={"plant": scenario.plant.model_copy(update=start)})
    law = make_law(there, cached_design(there))
    made = simulate_runs(there, law, seed=seed, runs=range(runs), steps=steps, record=True)
    assert made.x is not None
    bits, whole = [], []
    for place in range(runs):
        x, coins = made.x[:, :, place], made.coin[:, place].tolist()
        heard = [tuple(v) for v in (x + noise * rng.standard_normal(x.shape)).tolist()]
        tap = Text(view.knowledge(scenario.knowledge()))
        for k in range(steps):
            tap.observe(Transition("noise", k, heard[k], None, None, heard[k + 1], start=k == 0))
        said = {g.k: g.symbol for g in tap.review()}
        own = np.array([said[k][coins[k]] for k in range(steps)])
        # of equals each is taken as often as any other
        share = [(said[k][coins[k]] == max(said[k])) / said[k].count(max(said[k])) for k in said]
        bits.append(float(-np.log2(np.maximum(own, LEAST)).mean()))
        whole.append(float(np.mean(share)))
    return Left(*_mean(np.array(bits)), *_mean(np.array(whole)))


def _mean(values: Array) -> tuple[float, float]:
    if len(values) < 2:
        return float(values.mean()), math.nan
    return float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values))
