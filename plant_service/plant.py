"""The plant, pure: its dynamics, its coin and the receiving end, one step at a time.

Time, files and networks are the shell's (:mod:`plant_service.service`); the single-process
simulation drives the same class.
"""

from collections.abc import Callable, Iterable
from math import isfinite
from operator import add
from typing import NamedTuple

from plant_service.adapters.operated import Operated
from plant_service.disturbance import disturbance
from protocol.agreement import predict
from protocol.link.fallback import Fallback
from protocol.link.receiver import Receiver, ReceiverEffects
from protocol.link.records import ReceiverRecord
from protocol.link.session import rules_of
from protocol.messages import Measurement, Offer
from protocol.scenario import Scenario
from protocol.secret.nonces import Contribution
from protocol.streams import Stream, SymbolSource
from protocol.vectors import Vector
from runtime.errors import Failure


class PlantStep(NamedTuple):
    """One step of the plant: the input that was in force, and where it led.

    ``coin`` is b_r and ``effects`` what the receiver made of it; both are None on a missed step.
    """

    k: int
    x: Vector
    u: Vector
    x_next: Vector
    coin: int | None
    effects: ReceiverEffects | None


class Draw(NamedTuple):
    """What chance has decided for transition j and step k: the coin b_r and the disturbance d."""

    j: int
    k: int
    coin: int
    d: Vector


class Move(NamedTuple):
    """A step that was made and is not counted yet: the offer, the coin b_r, and x(k+1)."""

    offer: Offer
    coin: int
    x_next: Vector


def first_record(scenario: Scenario, session: str, x: Vector | None = None) -> ReceiverRecord:
    """The record of a plant that has not moved yet; ``x`` is its first reading, if it has one."""
    start = scenario.initial_state if x is None else x
    return ReceiverRecord(session=session, k=0, x=start, u=(0.0,) * scenario.m)


Advance = Callable[[int, Vector, Vector, Vector], Vector]
"""(k, x, u, d) -> x(k+1): a step that can be computed as often as one likes."""


def linear_advance(scenario: Scenario) -> Advance:
    """x+ = A x + B u + d, the sum of the prediction and the disturbance, by component."""
    A, B = scenario.plant_model

    def advance(k: int, x: Vector, u: Vector, d: Vector) -> Vector:
        x_next = tuple(map(add, predict(A, B, x, u), d))
        if not all(map(isfinite, x_next)):
            raise Failure(f"the state is no longer finite at step {k + 1}")
        return x_next

    return advance


def resuming_advance(operated: Operated, enters: str) -> Advance:
    """Of a simulated plant whose reading is all its state: it is put there, and stepped."""

    def advance(k: int, x: Vector, u: Vector, d: Vector) -> Vector:
        operated.resume(x, k)
        operated.apply(u, d if enters == "input" else None)
        return operated.sample(d if enters == "state" else None)

    return advance


class Plant:
    """A plant whose steps can be computed as often as one likes, with its receiver.

    Parameters
    ----------
    scenario : Scenario
    instance : str
        Random id of this process.
    coin : SymbolSource
        The plant's own coin b_r; draw j belongs to transition j.
    noise : Stream
        Uniform numbers for the disturbance; draw k belongs to step k.
    record : ReceiverRecord
        As read back from the journal, or a new session's.
    chunks : str
        Symbols of the frame under way that have left the record.
    raws : iterable of Raw
        Rows of key blocks that are not settled.
    said : Measurement, optional
        Of a step that is to be counted first.
    advance : Advance, optional
        One step; the linear plant's by default.
    """

    def __init__(
        self,
        scenario: Scenario,
        instance: str,
        coin: SymbolSource,
        noise: Stream,
        record: ReceiverRecord,
        chunks: str,
        contributions: Iterable[Contribution] = (),
        said: Measurement | None = None,
        advance: Advance | None = None,
    ) -> None:
        self.receiver = Receiver(rules_of(scenario), instance, record, chunks, contributions, said)
        self._plant = scenario.plant
        self._advance = advance or linear_advance(scenario)
        self._fallback = Fallback.of(scenario)
        self._size = scenario.secrecy.candidates
        self._coin = coin
        self._noise = noise
        self._drawn: Draw | None = None

    def move(self, offer: Offer) -> Move:
        """Choose one input of the current ``offer`` by the coin, and apply it (Fig. 5)."""
        record = self.receiver.record
        draw = self._drawn
        if draw is None or (draw.j, draw.k) != (record.transitions, record.k):
            draw = self._draw()
        x_next = self._advance(record.k, record.x, offer.candidates[draw.coin], draw.d)
        return Move(offer, draw.coin, x_next)

    def count(self, move: Move) -> PlantStep:
        """Count the transition that ``move`` made, and draw for the one to come."""
        offer, coin, x_next = move
        record = self.receiver.record
        effects = self.receiver.applied(offer, coin, x_next)
        self._drawn = self._draw()
        return PlantStep(record.k, record.x, offer.candidates[coin], x_next, coin, effects)

    def miss(self) -> PlantStep:
        """No offer came in time: apply the fallback (rule 4)."""
        record = self.receiver.record
        u = self._fallback.input(record.x, record.u)
        x_next = self._advance(record.k, record.x, u, self._disturbance(record.k))
        self.receiver.missed(u, x_next)
        return PlantStep(record.k, record.x, u, x_next, None, None)

    def _draw(self) -> Draw:
        """The coin of the next transition and the disturbance of the next step."""
        record = self.receiver.record
        j, k = record.transitions, record.k
        return Draw(j, k, self._coin.symbol(j, self._size), self._disturbance(k))

    def _disturbance(self, k: int) -> Vector:
        spec = self._plant.disturbance
        return disturbance(spec, k, self._noise.at(k)) if spec.half_widths else ()

    def safe(self, why: str) -> None:
        """Nothing moves that would have to be stopped."""

    def close(self) -> str:
        """Nothing is open, and nothing fails."""
        return ""
