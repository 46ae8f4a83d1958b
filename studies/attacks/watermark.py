"""What a secret dither must cost, if a fabricator is to be caught (docs/findings.md, theorem 2).

One input, any D_c, any dither zeta, any test without false alarms. sigma is the longest step along
the input that D_c explains: the spacing that certainty needs. If one who does not know zeta passes
with probability at most mu, then Var zeta >= sigma^2 (mu^-2 - 1) / 12.
"""

import math
from collections.abc import Iterator
from statistics import NormalDist
from typing import Any, Final

import numpy as np

from controller_service.sets.separation import Separation
from controller_service.sets.terminal import feedback_gain
from protocol.scenario import Scenario
from runtime.scenario_file import scenario_of
from studies.capacity.price import dither_price
from studies.registry import study

SIZES: Final = (2, 3, 4, 5, 6, 8, 12, 16)
SCENARIO: Final = "packed"
COLUMNS: Final = "scenario dither M pass variance state_price input_price"


def least(mu: float) -> float:
    """(mu^-2 - 1) / 12: no dither of less variance, in sigma^2, is passed so seldom."""
    return (mu**-2 - 1) / 12


def packed(size: int) -> float:
    """Variance of M points a sigma apart, in sigma^2; each is passed with probability 1/M.

    Points so close may touch, so the project's alphabets stand a millionth farther apart.
    """
    return float(np.arange(size).var())


def gaussian(mu: float) -> float:
    """Variance of the normal dither that is passed with probability ``mu``, in sigma^2.

    Of its windows of length sigma the middle one holds the most, 2 Phi(sigma / 2 s) - 1.
    """
    return (2 * NormalDist().inv_cdf((1 + mu) / 2)) ** -2


def gaussian_passes(variance: float) -> float:
    """The other way: how often a normal dither of this variance, in sigma^2, is passed."""
    return 2 * NormalDist().cdf(0.5 / math.sqrt(variance)) - 1


def spacing(scenario: Scenario) -> float:
    """sigma of a scenario with one input."""
    return Separation.of(scenario.B, scenario.defender.disturbance).sigma()


@study("dither-price", COLUMNS)
def price_rows(_: None) -> Iterator[tuple[Any, ...]]:
    """What each dither adds to the means of x'x and u'u on the paper's plant, by 1/M."""
    scenario = scenario_of(SCENARIO)
    price = dither_price(np.array(scenario.A), np.array(scenario.B), feedback_gain(scenario))
    unit = spacing(scenario) ** 2
    for size in SIZES:
        mu = 1 / size
        for name, variance in (
            ("any, proved", least(mu)),
            ("packed", packed(size)),
            ("Gaussian", gaussian(mu)),
        ):
            cost = variance * unit
            yield SCENARIO, name, size, mu, variance, price.state[0] * cost, price.input[0] * cost
