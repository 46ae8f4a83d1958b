"""The session of the controller's end: which one it serves, with which plant (rule 6)."""

from abc import ABC, abstractmethod
from typing import Final, Literal, NamedTuple

from protocol.link.ciphering import Ciphering
from protocol.link.keying import Keying
from protocol.link.records import SenderRecord
from protocol.link.session import CountedTransition, Rules
from protocol.messages import LARGEST_COUNT, ControllerHello, Measurement, Offer, PlantHello
from protocol.secret.blocks import BlockResult
from protocol.secret.nonces import Contribution

REMEMBERED_SESSIONS: Final = 16
"""Ended sessions a controller remembers, so that a delayed hello cannot bring one back."""


class SenderEffects(NamedTuple):
    """What the controller's shell must do, in this order: trace, save, publish.

    ``save`` asks for the record; ``append`` for the measurement and the ``offer`` in answer, beside
    the record before them, and then for the sender's ``finish_step``, once the offer is on its way.
    ``refusal`` is a line for the log; ``greet`` asks for a hello, because the plant speaks of a
    session that is not this process's. ``contribution`` is what the transition contributes to its
    key block, ``judged`` what the measurement's word says of blocks.
    """

    save: bool = False
    append: bool = False
    transition: CountedTransition | None = None
    delivered: int | None = None
    offer: Offer | None = None
    reply: ControllerHello | None = None
    refusal: str = ""
    greet: bool = False
    contribution: Contribution | None = None
    judged: tuple[BlockResult, ...] = ()


NOTHING: Final = SenderEffects()


def _after(incarnation: int) -> int:
    return min(incarnation + 1, LARGEST_COUNT)


class SenderSession(ABC):
    """The controller's end as a plant meets it; :class:`protocol.link.sender.Sender` has its steps.

    Parameters
    ----------
    rules : Rules
    instance : str
        Random id of this process.
    record : SenderRecord
        As read back from the journal.
    ciphering : Ciphering
    keying : Keying
    """

    def __init__(
        self,
        rules: Rules,
        instance: str,
        record: SenderRecord,
        ciphering: Ciphering,
        keying: Keying,
    ) -> None:
        self.rules = rules
        self.instance = instance
        state = rules.scheme.restore(record.state)
        self.record = record._replace(state=state, incarnation=_after(record.incarnation))
        self.keying = keying
        self._ciphering = ciphering
        self._plant: str | None = None
        self._elsewhere: str | None = None
        self._refused = False

    @abstractmethod
    def _rewind(self) -> None:
        """The record is another session's, or none's: forget what was worked out from it."""

    @property
    def plant(self) -> str | None:
        """The plant process whose session is taken up, if any."""
        return self._plant

    @property
    def refused(self) -> bool:
        """Whether the only plant there shares another model: there is nothing to go on with."""
        return self._refused

    def greeting(self) -> ControllerHello:
        """The first word after a start: asks the plant to say which session it is in.

        The record must have been saved before: no other process may greet as this life.
        """
        return self._hello("greeting")

    def heard_plant(self, hello: PlantHello, *, running: bool = False) -> SenderEffects:
        """The plant asks to take up a session (rule 6).

        ``running`` says that the plant whose session is taken up was heard just now: another one
        then has to wait.
        """
        record = self.record
        if hello.fingerprint != self.rules.fingerprint:
            self._refused = record.session is None and not record.ended
            return SenderEffects(
                reply=self._hello("other-model", hello),
                refusal=f"plant {hello.instance} shares another model",
            )
        ours = hello.session == record.session
        if running and not ours and self._plant not in (None, hello.instance):
            return SenderEffects(
                refusal=f"plant {hello.instance} speaks up while plant {self._plant} runs: "
                "two plants on one loop?"
            )
        if hello.controller is None:
            self._elsewhere = None
            behind = ours and hello.incarnation > record.incarnation
            if behind:  # the plant knows lives of this journal which it does not know itself
                self.record = record._replace(incarnation=_after(hello.incarnation))
            return SenderEffects(save=behind, reply=self.greeting())
        asked = hello.controller == self.instance
        late = ours and hello.applied_k < record.applied_k
        if late and (hello.instance == self._plant or not asked):
            return NOTHING  # it was overtaken
        if not asked and ours and hello.incarnation < record.incarnation:
            self._elsewhere = None
            return SenderEffects(greet=True)  # it asks a former life of this controller
        if not asked:
            return self._step_back(hello)
        self._elsewhere = None
        if ours:
            outstanding = record.offer.k if record.offer is not None else record.applied_k
            if hello.applied_k in (record.applied_k, outstanding):
                self._plant = hello.instance
                return SenderEffects(reply=self._hello("accepted", hello))
            return self._refuse(hello, "the journals do not fit together")
        if hello.transitions or hello.session in record.ended:
            return self._refuse(hello, "the plant is in a session this journal does not know")
        self._adopt(hello)
        return SenderEffects(save=True, reply=self._hello("accepted", hello))

    def unequal(self) -> SenderEffects:
        """The two ends hold different key blocks: end the session."""
        self._drop_session()
        return SenderEffects(
            save=True, greet=True, refusal="a key block differs from the plant's; session ended"
        )

    def _adopt(self, hello: PlantHello) -> None:
        """Begin a session; the frame under way starts again."""
        fresh = SenderRecord(
            session=hello.session,
            state=self.rules.scheme.initial,
            ended=self._ended_now(),
            message=self.record.message,
            k=-1,
            incarnation=self.record.incarnation,
        )
        first = self._ciphering.decide(fresh.state, 0, fresh.message, 0)
        self.record = fresh._replace(cipher=first.cipher)
        self._rewind()
        self.keying.begin(hello.session)
        self._plant = hello.instance

    def _ended_now(self) -> tuple[str, ...]:
        if self.record.session is None:
            return self.record.ended
        return (*self.record.ended, self.record.session)[-REMEMBERED_SESSIONS:]

    def _drop_session(self) -> None:
        """Forget the session and its half-agreed key, if there is one."""
        self._plant = None
        if self.record.session is None:
            return
        self.record = SenderRecord(
            ended=self._ended_now(),
            state=self.rules.scheme.initial,
            message=self.record.message,
            incarnation=self.record.incarnation,
        )
        self._rewind()
        self.keying.end()

    def _refuse(self, hello: PlantHello, why: str) -> SenderEffects:
        """Have the plant begin another session; the one here is over once it does.

        Whoever asks may be gone for long: its hello may come late, and end nothing.
        """
        return SenderEffects(reply=self._hello("unknown-session", hello), refusal=why)

    def _step_back(self, hello: PlantHello) -> SenderEffects:
        """The plant asks another controller, or is with one: offer nothing in that session.

        Who worked in that very session until now drops it: the other one has its journal.
        """
        overtaken = self._plant is not None and hello.session == self.record.session
        if overtaken:
            self._drop_session()
        self._plant = None
        self._elsewhere = hello.session
        return SenderEffects(
            save=overtaken,
            refusal=f"plant {hello.instance} is with controller {hello.controller}, and not with "
            f"this one, {self.instance}",
        )

    def _diverged(self, measurement: Measurement) -> SenderEffects:
        """The plant reports what this journal rules out: one of the two went back in time."""
        self._drop_session()
        return SenderEffects(
            save=True,
            greet=True,
            refusal=f"measurement {measurement.k} does not follow from the journal; session ended",
        )

    def _hello(
        self,
        verdict: Literal["greeting", "accepted", "unknown-session", "other-model"],
        hello: PlantHello | None = None,
    ) -> ControllerHello:
        return ControllerHello(
            instance=self.instance,
            incarnation=self.record.incarnation,
            fingerprint=self.rules.fingerprint,
            verdict=verdict,
            session=hello.session if hello else self.record.session,
            answers=hello.instance if hello else None,
        )
