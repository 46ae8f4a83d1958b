"""A controller's core alone: the test is its shell and its partner.

Time moves on by a second with each thing that is heard, so that no greeting comes too soon.
"""

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from typing import Any, NamedTuple
from zlib import crc32

from controller_service.chooser import Predict
from controller_service.core import ControllerCore
from protocol.agreement import NO_SYMBOL
from protocol.link.distiller import BlockEnded, Distiller
from protocol.link.effects import Effect, Notice, Publish, Save
from protocol.link.records import ControllerRecord, Loaded
from protocol.link.session import CountedTransition, Rules, reports
from protocol.link.step import IDLE, Answered
from protocol.messages import ControllerHello, Measurement, Offer, PlantHello
from protocol.secret.nonces import Contribution, NonceSource
from protocol.streams import SymbolSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import USAGE
from tests.support.asked import turns

PERIOD_S = 0.1


class OneMessage:
    """A queue of one message at most."""

    def __init__(self, payload: bytes | None = None) -> None:
        self._payload = payload
        self.queued = 0 if payload is None else 1

    def payload(self, number: int) -> bytes | None:
        return self._payload if number == 0 else None

    def crc_of(self, identifier: str) -> int | None:
        known = identifier == "only" and self._payload is not None
        return crc32(self._payload or b"") if known else None

    def identifier(self, number: int) -> str:
        return "only"


class Zeros:
    """Symbols that are no secret."""

    def symbol(self, transition: int, size: int) -> int:
        return 0


class Done(NamedTuple):
    """What a core asked for, of one event.

    ``append`` says that a step was saved before its offer, ``save`` that a record was at once.
    """

    save: bool = False
    append: bool = False
    transition: CountedTransition | None = None
    delivered: str | None = None
    offer: Offer | None = None
    reply: ControllerHello | None = None
    refusal: str = ""
    rows: tuple[Contribution, ...] = ()
    blocks: tuple[BlockEnded, ...] = ()


NOTHING = Done()


def done(effects: Sequence[Effect]) -> Done:
    """What ``effects`` come to."""
    said: dict[Any, Any] = {}
    events: list[Any] = []
    refusals: list[str] = []
    saves = [effect for effect in effects if isinstance(effect, Save)]
    for asked in turns(effects):
        for message in asked.publish:
            assert type(message) not in said
            said[type(message)] = message
        events += asked.events
        refusals += [notice.text for notice in asked.notices if notice.subject == "refusals"]
    transitions = [event for event in events if isinstance(event, CountedTransition)]
    delivered = [t.delivered.id for t in transitions if t.delivered is not None]
    assert len(transitions) <= 1
    assert len(refusals) <= 1
    save = any(save.step is IDLE for save in saves)
    return Done(
        save=save,
        append=any(save.step is not IDLE for save in saves),
        transition=transitions[0] if transitions else None,
        delivered=delivered[0] if delivered else None,
        offer=said.get(Offer),
        reply=said.get(ControllerHello),
        refusal=refusals[0] if refusals else "",
        rows=tuple(row for save in saves if save.step is IDLE for row in save.rows.contributions),
        blocks=tuple(event for event in events if isinstance(event, BlockEnded)),
    )


def reported(core: ControllerCore) -> int:
    """Transitions that the plant has reported, the one that waits to be counted included."""
    record, step = core.state.record, core.state.step
    counts = isinstance(step, Answered) and reports(record, step.measurement)
    return record.link.transitions + counts


class ControllerInHand:
    """A controller process that has read ``record``, and what followed it.

    Parameters
    ----------
    rules, propose, messages, fresh, instance, record, measurement, offer, contributions, nonces,
    predict
        As of :class:`controller_service.core.ControllerCore`.
    """

    def __init__(
        self,
        rules: Rules,
        propose: Callable[[Vector], tuple[Vector, ...]],
        instance: str,
        record: ControllerRecord | None = None,
        measurement: Measurement | None = None,
        offer: Offer | None = None,
        contributions: Iterable[Contribution] = (),
        *,
        messages: Any = None,
        fresh: SymbolSource | None = None,
        nonces: NonceSource = fresh_nonce,
        predict: Predict | None = None,
    ) -> None:
        self._now = 0.0
        self._rest: Iterable[Effect] = ()
        self.core = ControllerCore(
            rules,
            propose,
            OneMessage() if messages is None else messages,
            fresh or Zeros(),
            instance=instance,
            period_s=PERIOD_S,
            loaded=Loaded(
                record,
                IDLE if measurement is None or offer is None else Answered(measurement, offer),
                tuple(contributions),
            ),
            predict=predict,
            nonces=nonces,
        )

    @property
    def record(self) -> ControllerRecord:
        return self.core.state.record

    @property
    def instance(self) -> str:
        return self.core.instance

    @property
    def plant(self) -> str | None:
        return self.core.state.session.plant

    @property
    def refused(self) -> bool:
        assert (self.core.state.session.state == "refused") == (self.core.code == USAGE)
        return self.core.state.session.state == "refused"

    @property
    def carries(self) -> bool:
        state = self.core.state
        return state.rules.scheme.pad(state.link.state) != NO_SYMBOL

    @property
    def unfinished(self) -> bool:
        return self.core.state.step is not IDLE

    @property
    def keys(self) -> Distiller:
        return self.core.state.keys

    def greeting(self) -> ControllerHello:
        """Its greeting, as it was when it started."""
        said = done([*copy(self.core).start(self._now)]).reply  # which leaves nothing behind
        assert said is not None
        return said

    def heard_plant(self, hello: PlantHello, *, running: bool = False) -> Done:
        """The plant speaks; ``running`` says that the one served was heard just now."""
        self._now += 1.0 if running else 1000.0
        return done([*self.core.receive(PlantHello, hello.wire(), self._now)])

    def measured(self, measurement: Measurement) -> Done:
        """A measurement arrives.

        Raises
        ------
        ValueError
            When it says that the measurement is malformed.
        """
        self._now += 1.0
        self._rest = iter(self.core.receive(Measurement, measurement.wire(), self._now))
        effects = []
        for effect in self._rest:
            effects.append(effect)
            if isinstance(effect, Notice) and effect.subject == "malformed":
                raise ValueError(effect.text.removesuffix("; ignored"))
            if isinstance(effect, Publish) and isinstance(effect.message, Offer):
                break
        return done(effects)

    def finish_step(self) -> Done:
        """Count the step under way."""
        if self.unfinished and not self._rest:  # as it was read back
            *counted, _, _ = self.core.start(self._now)  # and then it greets, saved before
            return done(counted)
        return done([*self._rest])
