"""A direction of the network: which message arrives, and when. Sans I/O; time is an argument.

Every draw is a function of (seed, direction, step, copy), so that the same message has the same
fate in the simulation, in the engine and live.
"""

import heapq
import random
from collections import OrderedDict
from math import inf
from typing import Final, Literal

from protocol.fates import Fates
from protocol.messages import FieldMessage, Message
from protocol.scenario import ChannelTable, Scenario

Direction = Literal["to_plant", "to_controller"]

REMEMBERED: Final = 64
"""Steps of which copies are counted; an older one starts from its first copy again."""

UNDER_WAY: Final = 4096
"""Messages that are on their way at most; one more is lost."""

COPIES: Final = 128
"""More than a step has with a deadline. In lock-step a step may have any number: after so many the
state goes on as in the step after it, so that no bad state lasts for ever."""


MOST_PERIODS: Final = 40
"""Periods for which a message under way is waited for; a later one counts as never."""


class Channel:
    """One direction of the network.

    Parameters
    ----------
    table : ChannelTable
    name : str
        What tells its draws from others': seed, run and direction.
    scale : float
        Seconds of the caller's clock in a second of the plant's.
    """

    def __init__(
        self,
        table: ChannelTable,
        name: str,
        scale: float = 1.0,
    ) -> None:
        self._table = table
        self._scale = scale
        self._fates = Fates(name)
        self._chain = table.chain
        self._copies: OrderedDict[int, int] = OrderedDict()
        self._state: tuple[int, float] = (-1, self._chain.loss_good)  # step, and its loss
        self._newest = -inf

    def arrival(self, k: int, now: float) -> float | None:
        """When a message of step ``k`` that is sent ``now`` arrives; None where it is lost."""
        table, copy = self._table, self._copies.pop(k, 0)
        self._copies[k] = copy + 1
        if len(self._copies) > REMEMBERED:
            self._copies.popitem(last=False)
        lost, late = self._fates.at(k, copy)
        if lost < self._loss(k + copy // COPIES):
            return None
        arrives = now + self._delay_s(late) * self._scale
        if not table.reordering:
            arrives = self._newest = max(arrives, self._newest)
        return arrives

    def _loss(self, k: int) -> float:
        if self._state[0] != k:
            self._state = (k, self._chain.loss_at(k, self._fates.of_step))
        return self._state[1]

    def _delay_s(self, uniform: float) -> float:
        """The delay that a uniform number stands for."""
        table = self._table
        if table.delay == "uniform":
            return table.delay_s + (2.0 * uniform - 1.0) * table.jitter_s
        if table.delay == "gamma":
            shape = (table.delay_s / table.jitter_s) ** 2
            # The number seeds a draw: Python has no quantile of the distribution.
            return random.Random(uniform).gammavariate(shape, table.delay_s / shape)
        return table.delay_s


class UnderWay:
    """The messages of one direction that are on their way, for the end where they arrive.

    Parameters
    ----------
    channel : Channel
        Of messages of the field bus; everything else arrives at once.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._messages: list[tuple[float, int, FieldMessage]] = []
        self._number = 0

    def takes(self, message: Message, now: float) -> bool:
        """Whether a message that was sent ``now`` is lost, or comes later."""
        if not isinstance(message, FieldMessage):
            return False
        arrives = self._channel.arrival(message.k, now)
        if arrives is None or len(self._messages) >= UNDER_WAY:
            return True
        if arrives <= now:
            return False
        self._number += 1
        heapq.heappush(self._messages, (arrives, self._number, message))
        return True

    @property
    def due_at(self) -> float:
        """When the next one arrives."""
        return self._messages[0][0] if self._messages else inf

    def arrived(self) -> FieldMessage:
        """The next one, which has arrived."""
        return heapq.heappop(self._messages)[2]


def channel_of(
    scenario: Scenario,
    to: Direction,
    *,
    scale: float = 1.0,
    seed: int | None = None,
    run: int = 0,
) -> Channel | None:
    """The channel of one direction; None where the scenario has no network.

    Parameters
    ----------
    scenario : Scenario
    to : {"to_plant", "to_controller"}
    scale : float
        Seconds of the end's clock in a second of the plant's.
    seed, run : int
        Of the experiment, beside the network's own seed.
    """
    network = scenario.network
    if network is None:
        return None
    table = network.to_plant if to == "to_plant" else network.to_controller
    return Channel(table, f"network {network.seed} {0 if seed is None else seed} {run} {to}", scale)


def round_trip_s(scenario: Scenario) -> float:
    """Seconds of the plant's clock within which a measurement is answered, but very rarely.

    At most `MOST_PERIODS` periods.
    """
    network = scenario.network
    if network is None:
        return 0.0
    longest = network.to_plant.longest_s + network.to_controller.longest_s
    return min(longest, MOST_PERIODS * scenario.plant.period_s)
