"""The plant's side of a session, as data: how it stands with a controller, and what it answers.

Rule 6 says that a session belongs to the one controller that the plant asked to take it up. Here is
how the plant finds that one, keeps to it, and lets another in. What was heard is given a name by
:func:`heard`, relative to the record. :data:`TABLE` has a row for each state and name: the answer,
and the state after it. docs/protocol.md shows the same table, generated from this one.
"""

from typing import Final, Literal, NamedTuple, get_args

from protocol.link.records import ReceiverRecord
from protocol.messages import ControllerHello

State = Literal["looking", "returned", "asked", "unanswered", "accepted", "silent", "refused"]

STATES: Final[dict[State, str]] = {
    "looking": "It has asked nobody, and any controller will do.",
    "returned": "It is back with a session that has transitions, and has asked nobody yet.",
    "asked": "It has asked one controller process, which has not accepted yet.",
    "unanswered": "It has asked one in vain for two seconds: any other will do.",
    "accepted": "The controller that it asked works in its session.",
    "silent": "The controller that accepted has been silent for two seconds: any other will do.",
    "refused": "The only controller that it ever heard has another model: the plant ends.",
}

Heard = Literal[
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

HEARD: Final[dict[Heard, str]] = {
    "greeting of the one asked": "The controller process that was asked greets, in any session.",
    "greeting of a former incarnation": "A greeting names the session, and an incarnation before "
    "the one that was asked last.",
    "greeting in the session": "Another process greets, and names the session.",
    "greeting in another": "Another process greets, and names another session or none.",
    "greeting, session unused": "The same, while the session has no transition, and another "
    "controller was asked to take it up.",
    "accepted": "The controller that was asked takes up the session.",
    "unknown session": "The controller that was asked does not know the session.",
    "answer of another": "Another controller answers in place of the one asked.",
    "answer to another": "An answer to another plant process, or for another session.",
    "another model": "A controller has another fingerprint; the plant has met one of its own.",
    "another model, never met": "A controller has another fingerprint; the plant never met one of "
    "its own.",
    "silence": "The controller has not answered for two seconds.",
    "offer applied": "An offer was applied and counted.",
    "blocks differ": "A key block differs from the controller's.",
}

Answer = Literal[
    "nothing", "ask", "begin and ask", "begin anew", "work", "say whose", "say model", "give up"
]

ANSWERS: Final[dict[Answer, str]] = {
    "nothing": "Nothing is said.",
    "ask": "The plant notes who greeted, saves, and asks that one to take up the session.",
    "begin and ask": "A new session begins, and the one that greeted is asked to take it up.",
    "begin anew": "A new session begins, and the plant says hello again.",
    "work": "Measurements go out.",
    "say whose": "The plant logs both names, and its hello says whose the session is.",
    "say model": "The plant logs it, and answers a greeting with its hello.",
    "give up": "The plant logs it, and ends with exit code 2.",
}


class Row(NamedTuple):
    """What the plant answers, and how it stands afterwards."""

    answer: Answer
    next: State


TABLE: Final[dict[tuple[State, Heard], Row]] = {
    ("looking", "greeting of the one asked"): Row("nothing", "looking"),
    ("looking", "greeting of a former incarnation"): Row("nothing", "looking"),
    ("looking", "greeting in the session"): Row("ask", "asked"),
    ("looking", "greeting in another"): Row("ask", "asked"),
    ("looking", "greeting, session unused"): Row("begin and ask", "asked"),
    ("looking", "accepted"): Row("nothing", "looking"),
    ("looking", "unknown session"): Row("nothing", "looking"),
    ("looking", "answer of another"): Row("say whose", "looking"),
    ("looking", "answer to another"): Row("nothing", "looking"),
    ("looking", "another model"): Row("say model", "looking"),
    ("looking", "another model, never met"): Row("give up", "refused"),
    ("looking", "silence"): Row("nothing", "looking"),
    ("looking", "offer applied"): Row("nothing", "returned"),
    ("looking", "blocks differ"): Row("begin anew", "looking"),
    ("returned", "greeting of the one asked"): Row("nothing", "returned"),
    ("returned", "greeting of a former incarnation"): Row("nothing", "returned"),
    ("returned", "greeting in the session"): Row("ask", "asked"),
    ("returned", "greeting in another"): Row("nothing", "returned"),
    ("returned", "greeting, session unused"): Row("nothing", "returned"),
    ("returned", "accepted"): Row("nothing", "returned"),
    ("returned", "unknown session"): Row("nothing", "returned"),
    ("returned", "answer of another"): Row("say whose", "returned"),
    ("returned", "answer to another"): Row("nothing", "returned"),
    ("returned", "another model"): Row("say model", "returned"),
    ("returned", "another model, never met"): Row("give up", "refused"),
    ("returned", "silence"): Row("nothing", "looking"),
    ("returned", "offer applied"): Row("nothing", "returned"),
    ("returned", "blocks differ"): Row("begin anew", "returned"),
    ("asked", "greeting of the one asked"): Row("ask", "asked"),
    ("asked", "greeting of a former incarnation"): Row("say whose", "asked"),
    ("asked", "greeting in the session"): Row("ask", "asked"),
    ("asked", "greeting in another"): Row("say whose", "asked"),
    ("asked", "greeting, session unused"): Row("say whose", "asked"),
    ("asked", "accepted"): Row("work", "accepted"),
    ("asked", "unknown session"): Row("begin anew", "asked"),
    ("asked", "answer of another"): Row("say whose", "asked"),
    ("asked", "answer to another"): Row("nothing", "asked"),
    ("asked", "another model"): Row("say model", "asked"),
    ("asked", "another model, never met"): Row("give up", "refused"),
    ("asked", "silence"): Row("nothing", "unanswered"),
    ("asked", "offer applied"): Row("nothing", "asked"),
    ("asked", "blocks differ"): Row("begin anew", "asked"),
    ("unanswered", "greeting of the one asked"): Row("ask", "asked"),
    ("unanswered", "greeting of a former incarnation"): Row("say whose", "unanswered"),
    ("unanswered", "greeting in the session"): Row("ask", "asked"),
    ("unanswered", "greeting in another"): Row("ask", "asked"),
    ("unanswered", "greeting, session unused"): Row("begin and ask", "asked"),
    ("unanswered", "accepted"): Row("work", "accepted"),
    ("unanswered", "unknown session"): Row("begin anew", "asked"),
    ("unanswered", "answer of another"): Row("say whose", "unanswered"),
    ("unanswered", "answer to another"): Row("nothing", "unanswered"),
    ("unanswered", "another model"): Row("say model", "unanswered"),
    ("unanswered", "another model, never met"): Row("give up", "refused"),
    ("unanswered", "silence"): Row("nothing", "unanswered"),
    ("unanswered", "offer applied"): Row("nothing", "asked"),
    ("unanswered", "blocks differ"): Row("begin anew", "unanswered"),
    ("accepted", "greeting of the one asked"): Row("ask", "accepted"),
    ("accepted", "greeting of a former incarnation"): Row("say whose", "accepted"),
    ("accepted", "greeting in the session"): Row("ask", "asked"),
    ("accepted", "greeting in another"): Row("say whose", "accepted"),
    ("accepted", "greeting, session unused"): Row("say whose", "accepted"),
    ("accepted", "accepted"): Row("work", "accepted"),
    ("accepted", "unknown session"): Row("begin anew", "asked"),
    ("accepted", "answer of another"): Row("say whose", "accepted"),
    ("accepted", "answer to another"): Row("nothing", "accepted"),
    ("accepted", "another model"): Row("say model", "accepted"),
    ("accepted", "another model, never met"): Row("say model", "accepted"),
    ("accepted", "silence"): Row("nothing", "silent"),
    ("accepted", "offer applied"): Row("nothing", "accepted"),
    ("accepted", "blocks differ"): Row("begin anew", "asked"),
    ("silent", "greeting of the one asked"): Row("ask", "accepted"),
    ("silent", "greeting of a former incarnation"): Row("say whose", "silent"),
    ("silent", "greeting in the session"): Row("ask", "asked"),
    ("silent", "greeting in another"): Row("ask", "asked"),
    ("silent", "greeting, session unused"): Row("begin and ask", "asked"),
    ("silent", "accepted"): Row("work", "accepted"),
    ("silent", "unknown session"): Row("begin anew", "asked"),
    ("silent", "answer of another"): Row("say whose", "silent"),
    ("silent", "answer to another"): Row("nothing", "silent"),
    ("silent", "another model"): Row("say model", "silent"),
    ("silent", "another model, never met"): Row("say model", "silent"),
    ("silent", "silence"): Row("nothing", "silent"),
    ("silent", "offer applied"): Row("nothing", "accepted"),
    ("silent", "blocks differ"): Row("begin anew", "unanswered"),
    **{("refused", name): Row("nothing", "refused") for name in get_args(Heard)},
}
"""(state, what was heard) to the answer and the next state."""

TO_ANYONE: Final = frozenset[State](("looking", "unanswered", "silent"))
"""States in which the plant's hello names nobody, and any controller may greet."""

WORKING: Final = frozenset[State](("accepted", "silent"))
"""States in which the plant publishes measurements."""


def first_state(record: ReceiverRecord) -> State:
    """How a process stands that has just read ``record``, or made it."""
    return "returned" if record.transitions else "looking"


def heard(
    hello: ControllerHello,
    record: ReceiverRecord,
    *,
    instance: str,
    fingerprint: str,
    asked: str | None,
    met: bool,
) -> Heard:
    """What a controller's hello is to a plant.

    Parameters
    ----------
    hello : ControllerHello
    record : ReceiverRecord
        The plant's.
    instance, fingerprint : str
        The plant process's id, and its model's.
    asked : str, optional
        The controller process that this process asked last.
    met : bool
        Whether it ever met a controller of its own model.
    """
    if hello.fingerprint != fingerprint:
        return "another model" if met else "another model, never met"
    in_session = hello.session == record.session
    if hello.verdict == "greeting":
        if in_session and hello.incarnation < record.incarnation:
            return "greeting of a former incarnation"
        if hello.instance == asked:
            return "greeting of the one asked"
        if in_session:
            return "greeting in the session"
        promised = record.controller not in ("", hello.instance)
        if promised and not record.transitions:
            return "greeting, session unused"
        return "greeting in another"
    if hello.answers != instance or not in_session:
        return "answer to another"
    if hello.instance != asked:
        return "answer of another"
    return "accepted" if hello.verdict == "accepted" else "unknown session"
