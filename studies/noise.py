"""Data of the noise figure on docs/findings.md: the bound beside taps."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from runtime.scenario_file import scenario_of
from studies.bound.loop import LinearLoop
from studies.bound.taps import block_left, text_left
from studies.registry import study

SEED: Final = 7
RATIOS: Final = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
COINS, BLOCKS = 6, 4000
STEPS, RUNS = 400, 5
KEY_COINS, KEY_EPS = 1000, 1e-12

COLUMNS: Final = "tap noise ratio gain claimed bits error guess key_bits coins eps runs steps seed"


@study("noise-bound", COLUMNS)
def bound_rows(_: None) -> Iterator[dict[str, Any]]:
    """The paper's plant, M = 4: the bound, and three taps."""
    scenario = scenario_of("packed")
    loop = LinearLoop.of(scenario)
    widths = np.array(scenario.plant.disturbance.half_widths)
    nothing = dict.fromkeys(COLUMNS.split())
    for ratio in sorted({*RATIOS, *np.geomspace(RATIOS[0], RATIOS[-1], 33).round(4).tolist()}):
        noise = ratio * loop.half_width
        coin = loop.coin(noise)
        yield nothing | {
            "tap": "any, proved",
            "noise": noise,
            "ratio": ratio,
            "gain": 1 / coin.deviation,
            "claimed": np.log2(coin.size),
            "bits": coin.bits,
            "error": 0.0,
            "guess": coin.guess,
            "key_bits": coin.key_bits(KEY_COINS, KEY_EPS),
            "coins": KEY_COINS,
            "eps": KEY_EPS,
        }
    for ratio in RATIOS:
        noise = ratio * loop.half_width
        blocks = {
            name: block_left(loop, widths, noise, COINS, BLOCKS, SEED, told=told)
            for name, told in (("told every d", True), ("knows the law of d", False))
        }
        taps = [(name, left, BLOCKS, COINS) for name, left in blocks.items()]
        taps.append(("text", text_left(scenario, noise, STEPS, RUNS, SEED), RUNS, STEPS))
        for tap, left, runs, steps in taps:
            yield nothing | {
                "tap": tap,
                "noise": noise,
                "ratio": ratio,
                "claimed": np.log2(len(loop.offsets)),
                "bits": left.bits,
                "error": left.bits_error,
                "guess": left.whole,
                "runs": runs,
                "steps": steps,
                "seed": SEED,
            }
