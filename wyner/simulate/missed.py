"""Which steps a network lets the plant miss: the messages' way in time, without what they say.

Both ends' rules of time are those of the cores: the plant repeats a measurement until its offer
comes, but once a late one has come, only after an offer in time; the controller answers the newest
step that it has heard of, each time that it hears it.
"""

import heapq
from collections.abc import Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from protocol.link.channel import Channel, channel_of
from protocol.scenario import Scenario

Flags = NDArray[np.bool_]


def missed_steps(scenario: Scenario, *, seed: int, runs: Sequence[int], steps: int) -> Flags | None:
    """Which steps are missed, shape (steps, R); None where the scenario has no network.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        Of the experiment.
    runs : sequence of int
    steps : int
    """
    if scenario.network is None:
        return None
    period, repeats = scenario.plant.period_s, scenario.link.repeats_per_period
    missed = np.empty((steps, len(runs)), dtype=bool)
    for place, run in enumerate(runs):
        up = channel_of(scenario, "to_controller", seed=seed, run=run)
        down = channel_of(scenario, "to_plant", seed=seed, run=run)
        assert up is not None
        assert down is not None
        missed[:, place] = of_one_run(up, down, period, repeats, steps)
    return missed


def of_one_run(
    to_controller: Channel, to_plant: Channel, period_s: float, repeats: int, steps: int
) -> list[bool]:
    """Which steps of one run are missed.

    Parameters
    ----------
    to_controller, to_plant : Channel
        New ones: they count the copies.
    period_s : float
    repeats : int
        How often a measurement goes out in a step while no offer comes.
    steps : int
    """
    missed: list[bool] = []
    under_way: list[tuple[float, int, bool, int]] = []  # when, number, an offer, step
    number = k = 0
    gap = period_s / repeats
    tick, repeat = period_s, 0.0
    waiting = once = False
    heard = applied = late = -1

    def send(channel: Channel, step: int, now: float, *, offer: bool) -> None:
        nonlocal number
        arrives = channel.arrival(step, now)
        if arrives is not None:
            number += 1
            heapq.heappush(under_way, (arrives, number, offer, step))

    while k < steps:
        due = tick if waiting else min(tick, repeat)
        if under_way and under_way[0][0] < due:
            now, _, offer, step = heapq.heappop(under_way)
            if not offer and step >= heard:
                heard = step
                send(to_plant, step, now, offer=True)
            elif offer and step == k and not waiting:
                waiting, once, applied = True, False, k
            elif offer and max(applied, late) < step < k:
                late, once = step, True
            continue
        if due == tick:
            missed.append(not waiting)
            k, waiting, repeat = k + 1, False, tick
            tick += period_s
        if not waiting and k < steps:
            now, repeat = repeat, repeat + gap
            if once or repeat > tick - 0.5 * gap:
                repeat = inf
            send(to_controller, k, now, offer=False)
    return missed
