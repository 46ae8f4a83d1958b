"""Data of the noise figure on docs/findings.md: the bound beside taps, and the law as a lever."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from runtime.scenario_file import scenario_of
from studies.bound.loop import LinearLoop
from studies.bound.taps import block_left, text_left
from studies.registry import study
from studies.signalling import changed

SEED: Final = 7
RATIOS: Final = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
COINS, BLOCKS = 6, 4000
STEPS, RUNS = 400, 5
WEIGHTS: Final = (0.001, 0.005, 0.02, 0.1, 0.5, 2.0)
KEY_COINS, KEY_EPS = 1000, 1e-12

COLUMNS: Final = (
    "part tap weight noise ratio gain claimed bits error guess key_bits coins eps runs steps seed"
)


@study("noise-bound", COLUMNS)
def bound_rows(_: None) -> Iterator[tuple[Any, ...]]:
    """The paper's plant, M = 4: the bound, three taps, and the bound over the regulator."""
    scenario = scenario_of("packed")
    loop = LinearLoop.of(scenario)
    widths = np.array(scenario.plant.disturbance.half_widths)
    weights = scenario.control.regulator
    assert weights is not None
    for ratio in sorted({*RATIOS, *np.geomspace(RATIOS[0], RATIOS[-1], 33).round(4).tolist()}):
        yield _proved("noise", loop, weights.input[0], ratio)
    for ratio in RATIOS:
        noise = ratio * loop.half_width
        taps = {
            "told every d": (
                block_left(loop, widths, noise, COINS, BLOCKS, SEED, told=True),
                BLOCKS,
                COINS,
            ),
            "knows the law of d": (
                block_left(loop, widths, noise, COINS, BLOCKS, SEED, told=False),
                BLOCKS,
                COINS,
            ),
            "text": (text_left(scenario, noise, STEPS, RUNS, SEED), RUNS, STEPS),
        }
        for tap, (left, runs, steps) in taps.items():
            yield (
                "noise",
                tap,
                weights.input[0],
                noise,
                ratio,
                "",
                np.log2(len(loop.offsets)),
                left.bits,
                left.bits_error,
                left.whole,
                "",
                "",
                "",
                runs,
                steps,
                SEED,
            )
    for weight in WEIGHTS:
        regulator = {"next_state": [1.0, 1.0], "input": [weight]}
        other = LinearLoop.of(changed("packed", control={"regulator": regulator}))
        yield _proved("law", other, weight, 1.0)


def _proved(part: str, loop: LinearLoop, weight: float, ratio: float) -> tuple[Any, ...]:
    noise = ratio * loop.half_width
    coin = loop.coin(noise)
    return (
        part,
        "any, proved",
        weight,
        noise,
        ratio,
        1 / coin.deviation,
        np.log2(coin.size),
        coin.bits,
        0.0,
        coin.guess,
        coin.key_bits(KEY_COINS, KEY_EPS),
        KEY_COINS,
        KEY_EPS,
        "",
        "",
        "",
    )
