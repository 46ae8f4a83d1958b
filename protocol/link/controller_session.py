"""The controller's side of a session: whose it serves, and what it answers.

Rule 6 says that a session is made by the plant, for the one controller that it asks to take it up.
Here is when a controller takes one up, keeps to it, and lets it go. What was heard is given a name
by :func:`heard`, relative to the record. :data:`TABLE` has a row for each state and name: the
answer, and the state after it. docs/protocol.md shows the same table, generated from this one.
"""

from math import inf
from typing import Final, Literal, NamedTuple, get_args

from protocol.link.records import ControllerRecord, ControllerSessionRecord
from protocol.link.session import SILENCE_S
from protocol.messages import LARGEST_COUNT, ControllerHello, Measurement, PlantHello

GREETING_S: Final = 0.1
"""Seconds between greetings while the plant speaks of a session that is not this process's."""

REMEMBERED_SESSIONS: Final = 16
"""Ended sessions that a controller remembers, so that a delayed hello cannot revive one."""

SILENT_PERIODS: Final = 3
"""Periods of silence before a plant counts as away; :data:`SILENCE_S` at least."""

State = Literal["greeting", "serving", "elsewhere", "refused"]

STATES: Final[dict[State, str]] = {
    "greeting": "It serves no plant, and greets each plant that speaks of a session.",
    "serving": "It has taken up a plant's session, and offers in it.",
    "elsewhere": "The plant is with another controller, or asks one: it offers nothing.",
    "refused": "The only plant that it ever heard has another model: the controller ends.",
}

Heard = Literal[
    "to anyone",
    "to anyone, of a later incarnation",
    "asked, session fits",
    "asked, session does not fit",
    "asked, new session",
    "asked, session unknown",
    "overtaken",
    "to a former incarnation",
    "to another, in the session",
    "to another",
    "second plant",
    "another model",
    "another model, never met",
    "session not taken up",
    "session elsewhere",
    "does not follow",
    "blocks differ",
]

HEARD: Final[dict[Heard, str]] = {
    "to anyone": "A plant's hello names no controller.",
    "to anyone, of a later incarnation": "The same, and it knows a later incarnation than this "
    "process takes itself for: the journal is an old copy.",
    "asked, session fits": "A hello asks this process to take up the session of its journal, and "
    "the plant has applied its last offer or the one before.",
    "asked, session does not fit": "The same, but the plant has applied another offer.",
    "asked, new session": "A hello asks it to take up a session that has no transition yet.",
    "asked, session unknown": "A hello asks it to take up a session that is over here, or has "
    "transitions that this journal does not know.",
    "overtaken": "A hello from before a transition that this journal has counted: from the plant "
    "served, or for somebody else.",
    "to a former incarnation": "A hello in the session asks a former process of this journal.",
    "to another, in the session": "A hello in the session asks another controller, which must "
    "have a copy of this journal.",
    "to another": "A hello of another session asks another controller.",
    "second plant": "A plant speaks of another session while the one served was heard just now.",
    "another model": "A plant has another fingerprint; the controller has met one of its own.",
    "another model, never met": "A plant has another fingerprint; the controller never met one of "
    "its own.",
    "session not taken up": "A measurement of a session that this process has not taken up.",
    "session elsewhere": "A measurement of the session for which it stepped back.",
    "does not follow": "A measurement that the journal rules out: a journal was restored.",
    "blocks differ": "A key block differs from the plant's.",
}

Answer = Literal[
    "nothing",
    "greet",
    "catch up and greet",
    "remind",
    "serve",
    "adopt and serve",
    "refuse",
    "step back",
    "end and step back",
    "end and greet",
    "log",
    "say model",
    "give up",
]

ANSWERS: Final[dict[Answer, str]] = {
    "nothing": "Nothing is said.",
    "greet": "The controller greets.",
    "catch up and greet": "It counts incarnations on from the plant's number, saves, and greets.",
    "remind": "It greets, once in 0.1 s at most.",
    "serve": "It says that it accepts the session, and offers in it.",
    "adopt and serve": "It drops the session before, saves the new one, and accepts it. The frame "
    "under way starts again.",
    "refuse": "It says that it does not know the session: the plant begins another one.",
    "step back": "It logs both names and offers nothing.",
    "end and step back": "The same, and it drops the session: the other one has its journal.",
    "end and greet": "It drops the session, saves, logs why, and greets.",
    "log": "It logs both plants' names.",
    "say model": "It says that the models differ, and logs it.",
    "give up": "The same, and it ends with exit code 2.",
}


class Row(NamedTuple):
    """What the controller answers, and how it stands afterwards."""

    answer: Answer
    next: State


DEFAULT: Final[dict[Heard, tuple[Answer, State | None]]] = {
    "to anyone": ("greet", None),
    "to anyone, of a later incarnation": ("catch up and greet", None),
    "asked, session fits": ("serve", "serving"),
    "asked, session does not fit": ("refuse", None),
    "asked, new session": ("adopt and serve", "serving"),
    "asked, session unknown": ("refuse", None),
    "overtaken": ("nothing", None),
    "to a former incarnation": ("remind", None),
    "to another, in the session": ("step back", "elsewhere"),
    "to another": ("step back", "elsewhere"),
    "second plant": ("nothing", None),
    "another model": ("say model", None),
    "another model, never met": ("give up", "refused"),
    "session not taken up": ("remind", None),
    "session elsewhere": ("nothing", None),
    "does not follow": ("nothing", None),
    "blocks differ": ("end and greet", None),
}
"""What is answered to what is heard, and the state after it (None: the same), unless :data:`EXCEPT`
says otherwise."""

EXCEPT: Final[dict[tuple[State, Heard], Row]] = {
    ("serving", "to another, in the session"): Row("end and step back", "elsewhere"),
    ("serving", "second plant"): Row("log", "serving"),
    ("serving", "does not follow"): Row("end and greet", "greeting"),
    ("serving", "blocks differ"): Row("end and greet", "greeting"),
    ("elsewhere", "to anyone"): Row("greet", "greeting"),
    ("elsewhere", "to anyone, of a later incarnation"): Row("catch up and greet", "greeting"),
    ("elsewhere", "asked, session does not fit"): Row("refuse", "greeting"),
    ("elsewhere", "asked, session unknown"): Row("refuse", "greeting"),
    ("elsewhere", "to a former incarnation"): Row("remind", "greeting"),
    **{("refused", name): Row("nothing", "refused") for name in get_args(Heard)},
}

TABLE: Final[dict[tuple[State, Heard], Row]] = {
    (state, event): EXCEPT.get((state, event), Row(answer, following or state))
    for state in get_args(State)
    for event, (answer, following) in DEFAULT.items()
}
"""(state, what was heard) to the answer and the next state. Some pairs cannot occur: there is no
second plant while none is served."""


def heard(
    hello: PlantHello,
    record: ControllerRecord,
    *,
    instance: str,
    fingerprint: str,
    plant: str | None,
    running: bool,
) -> Heard:
    """What a plant's hello is to a controller.

    Parameters
    ----------
    hello : PlantHello
    record : ControllerRecord
    instance, fingerprint : str
        The controller process's id, and its model's.
    plant : str, optional
        The plant process that is served.
    running : bool
        Whether that one was heard just now: another one then has to wait.
    """
    session, applied_k = record.session, record.link.applied_k
    if hello.fingerprint != fingerprint:
        met = session.id is not None or bool(session.ended)
        return "another model" if met else "another model, never met"
    in_session = hello.session == session.id
    if running and not in_session and plant not in (None, hello.instance):
        return "second plant"
    if hello.controller is None:
        later = in_session and hello.incarnation > session.incarnation
        return "to anyone, of a later incarnation" if later else "to anyone"
    asked = hello.controller == instance
    past = in_session and hello.applied_k < applied_k
    if past and (not asked or hello.instance == plant):
        return "overtaken"
    if asked and in_session:
        outstanding = applied_k if record.offer is None else record.offer.k
        fits = hello.applied_k in (applied_k, outstanding)
        return "asked, session fits" if fits else "asked, session does not fit"
    if asked:
        unknown = hello.transitions > 0 or hello.session in session.ended
        return "asked, session unknown" if unknown else "asked, new session"
    if not in_session:
        return "to another"
    former = hello.incarnation < session.incarnation
    return "to a former incarnation" if former else "to another, in the session"


class ControllerSession:
    """How one controller process stands with plants.

    Parameters
    ----------
    instance, fingerprint : str
        The process's id, and its model's.
    record : ControllerSessionRecord
        As it was read; this process is a later incarnation.
    period_s : float
        The plant's; one that has been silent for several of them is away.

    Attributes
    ----------
    record : ControllerSessionRecord
    state : State
    plant : str or None
        The plant process whose session is taken up, if any.
    plant_at, greeting_at : float
        When the plant measured, and when this process may greet again.
    running_s : float
        Seconds after which a plant that has not measured is away.
    """

    def __init__(
        self, instance: str, fingerprint: str, record: ControllerSessionRecord, period_s: float
    ) -> None:
        self.instance, self.fingerprint = instance, fingerprint
        self.record = record._replace(incarnation=_after(record.incarnation))
        self.state: State = "greeting"
        self.plant: str | None = None
        self.plant_at = self.greeting_at = -inf
        self.running_s = max(SILENCE_S, SILENT_PERIODS * period_s)
        self._elsewhere: str | None = None

    def on(self, event: Heard) -> Answer:
        """What the table says to an event; its state follows."""
        answer, self.state = TABLE[self.state, event]
        return answer

    def hears(
        self, hello: PlantHello, record: ControllerRecord, now: float
    ) -> tuple[Heard, Answer]:
        """The plant spoke: what that is, and what is to be answered."""
        what = heard(
            hello,
            record,
            instance=self.instance,
            fingerprint=self.fingerprint,
            plant=self.plant,
            running=now - self.plant_at < self.running_s,
        )
        answer = self.on(what)
        if answer == "catch up and greet":
            self.record = self.record._replace(incarnation=_after(hello.incarnation))
        if answer in ("step back", "end and step back"):
            self._elsewhere = hello.session
        elif self.state != "elsewhere":
            self._elsewhere = None
        return what, answer

    def begin(self, session: str | None) -> None:
        """Go on with another session, or with none; the one before is over."""
        record = self.record
        ended = record.ended
        if record.id is not None:
            ended = (*ended, record.id)[-REMEMBERED_SESSIONS:]
        self.record = record._replace(id=session, ended=ended)

    def serves(self, measurement: Measurement) -> bool:
        """Whether a measurement is of the session that was taken up."""
        return self.plant is not None and measurement.session == self.record.id

    def stranger(self, measurement: Measurement) -> Answer:
        """What is answered to a measurement of a session that was not taken up."""
        elsewhere = measurement.session == self._elsewhere
        return self.on("session elsewhere" if elsewhere else "session not taken up")

    def may_greet(self, now: float) -> bool:
        """Whether to greet unasked now; if so, the next time is later."""
        if now < self.greeting_at:
            return False
        self.greeting_at = now + GREETING_S
        return True

    def hello(
        self,
        verdict: Literal["greeting", "accepted", "unknown-session", "other-model"] = "greeting",
        answered: PlantHello | None = None,
    ) -> ControllerHello:
        """Ask the plant which session it is in, or answer its hello.

        The record must have been saved before: no other process may greet as this incarnation.
        """
        return ControllerHello(
            instance=self.instance,
            incarnation=self.record.incarnation,
            fingerprint=self.fingerprint,
            verdict=verdict,
            session=answered.session if answered else self.record.id,
            answers=answered.instance if answered else None,
        )


def _after(incarnation: int) -> int:
    return min(incarnation + 1, LARGEST_COUNT)
