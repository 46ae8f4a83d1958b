"""How far an end is with a step: what its journal has beside the record."""

from enum import Enum
from typing import Final, NamedTuple

from protocol.messages import Measurement, Offer


class Idle(Enum):
    """No step is under way."""

    IDLE = "idle"


IDLE: Final = Idle.IDLE


class Begun(NamedTuple):
    """At the plant: an offer was taken, and the coin chose its candidate ``coin``."""

    offer: Offer
    coin: int


class Read(NamedTuple):
    """At the plant: the step is over, and ``report`` says where it led. It is to be counted."""

    offer: Offer
    coin: int
    report: Measurement


class Answered(NamedTuple):
    """At the controller: ``offer`` answers ``measurement``. What that reports is to be counted."""

    measurement: Measurement
    offer: Offer


Step = Idle | Begun | Read | Answered
