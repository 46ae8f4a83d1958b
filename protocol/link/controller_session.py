"""The controller's side of a session: whose it serves, and what it answers.

Rule 6 says that a session is made by the plant, for the one controller that it asks to take it up.
Here is when a controller takes one up, keeps to it, and lets it go. What happens is given a name
by :func:`event_of`, relative to the record. :data:`TABLE` has a row for each state and name: the
answer, and the state after it. docs/protocol.md shows the same table, generated from this one.
"""

from math import inf
from typing import Final, Literal, get_args

from protocol.link.records import ControllerRecord, ControllerSessionRecord
from protocol.link.session import SILENCE_S
from protocol.link.session_table import Row, whole
from protocol.messages import LARGEST_COUNT, ControllerHello, Measurement, PlantHello

GREETING_S: Final = 0.1
"""Seconds between greetings while the plant speaks of a session that is not this process's."""

REMEMBERED_SESSIONS: Final = 16
"""Ended sessions that a controller remembers, so that a delayed hello cannot revive one."""

SILENT_PERIODS: Final = 3
"""Periods of silence before a plant counts as away; :data:`SILENCE_S` at least."""

State = Literal["greeting", "serving", "elsewhere", "refused"]

Event = Literal[
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

DEFAULT: Final[dict[Event, tuple[Answer, State | None]]] = {
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

EXCEPT: Final[dict[tuple[State, Event], Row[Answer, State]]] = {
    ("serving", "to another, in the session"): Row("end and step back", "elsewhere"),
    ("serving", "second plant"): Row("log", "serving"),
    ("serving", "does not follow"): Row("end and greet", "greeting"),
    ("serving", "blocks differ"): Row("end and greet", "greeting"),
    ("elsewhere", "to anyone"): Row("greet", "greeting"),
    ("elsewhere", "to anyone, of a later incarnation"): Row("catch up and greet", "greeting"),
    ("elsewhere", "asked, session does not fit"): Row("refuse", "greeting"),
    ("elsewhere", "asked, session unknown"): Row("refuse", "greeting"),
    ("elsewhere", "to a former incarnation"): Row("remind", "greeting"),
    **{("refused", name): Row("nothing", "refused") for name in get_args(Event)},
}

TABLE: Final = whole(get_args(State), DEFAULT, EXCEPT)
"""(state, what happened) to the answer and the next state. Some pairs cannot occur: there is no
second plant while none is served."""


def event_of(
    hello: PlantHello,
    record: ControllerRecord,
    *,
    instance: str,
    fingerprint: str,
    plant: str | None,
    running: bool,
) -> Event:
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

    def on(self, event: Event) -> Answer:
        """What the table says to an event; its state follows."""
        answer, self.state = TABLE[self.state, event]
        return answer

    def answer(
        self, hello: PlantHello, record: ControllerRecord, now: float
    ) -> tuple[Event, Answer]:
        """The plant spoke: what that is, and what is to be answered."""
        what = event_of(
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
