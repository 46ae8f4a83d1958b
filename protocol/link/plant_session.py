"""The plant's side of a session: how it stands with a controller, and what it answers.

Rule 6 says that a session belongs to the one controller that the plant asked to take it up. Here is
how the plant finds that one, keeps to it, and lets another in. What happens is given a name by
:func:`event_of`, relative to the record. :data:`TABLE` has a row for each state and name: the
answer, and the state after it. docs/protocol.md says what the names mean, and shows the same table.
"""

from math import inf
from typing import Final, Literal, get_args

from protocol.link.records import LinkRecord, PlantRecord
from protocol.link.session import SILENCE_S
from protocol.link.session_table import Row, whole
from protocol.messages import ControllerHello, PlantHello

HELLO_S: Final = 0.1
"""Seconds between hellos until the controller answers."""

State = Literal["looking", "returned", "asked", "unanswered", "accepted", "silent", "refused"]

Event = Literal[
    "greeting of the one asked",
    "greeting of a former incarnation",
    "greeting in the session",
    "greeting in another",
    "greeting, session unused",
    "accepted",
    "unknown session",
    "answer of another",
    "answer to another",
    "another model",
    "another model, never met",
    "silence",
    "offer applied",
    "blocks differ",
]

Answer = Literal[
    "nothing", "ask", "begin and ask", "begin anew", "work", "say whose", "say model", "give up"
]

DEFAULT: Final[dict[Event, tuple[Answer, State | None]]] = {
    "greeting of the one asked": ("nothing", None),
    "greeting of a former incarnation": ("say whose", None),
    "greeting in the session": ("ask", "asked"),
    "greeting in another": ("ask", "asked"),
    "greeting, session unused": ("begin and ask", "asked"),
    "accepted": ("work", "accepted"),
    "unknown session": ("begin anew", "asked"),
    "answer of another": ("say whose", None),
    "answer to another": ("nothing", None),
    "another model": ("say model", None),
    "another model, never met": ("give up", "refused"),
    "silence": ("nothing", None),
    "offer applied": ("nothing", None),
    "blocks differ": ("begin anew", None),
}
"""What is answered to what is heard, and the state after it (None: the same), unless :data:`EXCEPT`
says otherwise."""

EXCEPT: Final[dict[tuple[State, Event], Row[Answer, State]]] = {
    ("looking", "greeting of a former incarnation"): Row("nothing", "looking"),
    ("looking", "accepted"): Row("nothing", "looking"),
    ("looking", "unknown session"): Row("nothing", "looking"),
    ("looking", "offer applied"): Row("nothing", "returned"),
    ("returned", "greeting of a former incarnation"): Row("nothing", "returned"),
    ("returned", "greeting in another"): Row("nothing", "returned"),
    ("returned", "greeting, session unused"): Row("nothing", "returned"),
    ("returned", "accepted"): Row("nothing", "returned"),
    ("returned", "unknown session"): Row("nothing", "returned"),
    ("returned", "silence"): Row("nothing", "looking"),
    ("asked", "greeting of the one asked"): Row("ask", "asked"),
    ("asked", "greeting in another"): Row("say whose", "asked"),
    ("asked", "greeting, session unused"): Row("say whose", "asked"),
    ("asked", "silence"): Row("nothing", "unanswered"),
    ("unanswered", "greeting of the one asked"): Row("ask", "asked"),
    ("unanswered", "offer applied"): Row("nothing", "asked"),
    ("accepted", "greeting of the one asked"): Row("ask", "accepted"),
    ("accepted", "greeting in another"): Row("say whose", "accepted"),
    ("accepted", "greeting, session unused"): Row("say whose", "accepted"),
    ("accepted", "another model, never met"): Row("say model", "accepted"),
    ("accepted", "silence"): Row("nothing", "silent"),
    ("accepted", "blocks differ"): Row("begin anew", "asked"),
    ("silent", "greeting of the one asked"): Row("ask", "accepted"),
    ("silent", "another model, never met"): Row("say model", "silent"),
    ("silent", "offer applied"): Row("nothing", "accepted"),
    ("silent", "blocks differ"): Row("begin anew", "unanswered"),
    **{("refused", name): Row("nothing", "refused") for name in get_args(Event)},
}

TABLE: Final = whole(get_args(State), DEFAULT, EXCEPT)
"""(state, what happened) to the answer and the next state."""

TO_ANYONE: Final = frozenset[State](("looking", "unanswered", "silent"))
"""States in which the plant's hello names nobody, and any controller may greet."""

WORKING: Final = frozenset[State](("accepted", "silent"))
"""States in which the plant publishes measurements."""


def first_state(link: LinkRecord) -> State:
    """How a process stands that has just read its journal, or made one."""
    return "returned" if link.transitions else "looking"


def event_of(
    hello: ControllerHello,
    record: PlantRecord,
    *,
    instance: str,
    fingerprint: str,
    asked: str | None,
    met: bool,
) -> Event:
    """What a controller's hello is to a plant.

    Parameters
    ----------
    hello : ControllerHello
    record : PlantRecord
    instance, fingerprint : str
        The plant process's id, and its model's.
    asked : str, optional
        The controller process that this process asked last.
    met : bool
        Whether it ever met a controller of its own model.
    """
    if hello.fingerprint != fingerprint:
        return "another model" if met else "another model, never met"
    session = record.session
    in_session = hello.session == session.id
    if hello.verdict == "greeting":
        if in_session and hello.incarnation < session.incarnation:
            return "greeting of a former incarnation"
        if hello.instance == asked:
            return "greeting of the one asked"
        if in_session:
            return "greeting in the session"
        promised = session.controller not in ("", hello.instance)
        if promised and not record.link.transitions:
            return "greeting, session unused"
        return "greeting in another"
    if hello.answers != instance or not in_session:
        return "answer to another"
    if hello.instance != asked:
        return "answer of another"
    return "accepted" if hello.verdict == "accepted" else "unknown session"


class PlantSession:
    """How one plant process stands with controllers, and when it says hello.

    Parameters
    ----------
    instance, fingerprint : str
        The process's id, and its model's.
    record : PlantRecord
        As it was read, or made.
    now : float

    Attributes
    ----------
    record : PlantSessionRecord
    state : State
    controller : str or None
        The controller process that this process asked last, if any.
    hello_at, answered_at : float
        When a hello is due, and when the controller was heard.
    """

    def __init__(self, instance: str, fingerprint: str, record: PlantRecord, now: float) -> None:
        self.instance, self.fingerprint = instance, fingerprint
        self.record = record.session
        self.controller: str | None = None
        self.state: State = first_state(record.link)
        self.hello_at = -inf
        self.answered_at = now
        self._met = record.link.transitions > 0 or record.session.sessions > 1
        self._taken_up = ("", "")

    @property
    def accepted(self) -> bool:
        """Whether the controller asked has accepted this session since this process began."""
        return self.state in WORKING

    def on(self, event: Event) -> Answer:
        """What the table says to an event; its state follows."""
        answer, self.state = TABLE[self.state, event]
        return answer

    def answer(self, hello: ControllerHello, record: PlantRecord, now: float) -> Answer:
        """The controller spoke: what is to be answered."""
        what = event_of(
            hello,
            record,
            instance=self.instance,
            fingerprint=self.fingerprint,
            asked=self.controller,
            met=self._met,
        )
        answer = self.on(what)
        if answer in ("ask", "begin and ask"):
            self.controller = hello.instance
            self.record = self.record._replace(
                controller=hello.instance, incarnation=hello.incarnation
            )
        if hello.instance == self.controller:
            self.answered_at = now
        return answer

    def begin(self, session: str) -> None:
        """Begin a session."""
        self.record = self.record._replace(id=session, sessions=self.record.sessions + 1)

    def took_up(self) -> bool:
        """The controller has taken up the session; True where that is news."""
        self._met = True
        before, self._taken_up = self._taken_up, (self.controller or "", self.record.id)
        return before != self._taken_up

    def due_at(self, *, waiting: bool) -> float:
        """When a hello is due, or the controller has been silent for long.

        While an applied offer waits for its tick nobody expects it to speak.
        """
        if not self.accepted:
            return self.hello_at
        return inf if waiting else max(self.hello_at, self.answered_at + SILENCE_S)

    def hello_due(self, now: float) -> bool:
        """Whether to say hello now; if so, the next one is due later."""
        silent = now >= self.answered_at + SILENCE_S  # as in due_at, to the last bit
        if silent:
            self.on("silence")
        due = (silent or not self.accepted) and now >= self.hello_at
        if due:
            self.hello_at = now + HELLO_S
        return due

    def hello(self, link: LinkRecord) -> PlantHello:
        """Ask the controller to take up this session, or look for one."""
        return PlantHello(
            instance=self.instance,
            session=self.record.id,
            controller=None if self.state in TO_ANYONE else self.controller,
            incarnation=self.record.incarnation,
            fingerprint=self.fingerprint,
            transitions=link.transitions,
            applied_k=link.applied_k,
        )
