"""The controller's side of a session, as data: whose session it serves, and what it answers.

Rule 6 says that a session is made by the plant, for the one controller that it asks to take it up.
Here is when a controller takes one up, keeps to it, and lets it go. What was heard is given a name
by :func:`heard`, relative to the record. :data:`TABLE` has a row for each state and name: the
answer, and the state after it. docs/protocol.md shows the same table, generated from this one.
"""

from typing import Final, Literal, NamedTuple, get_args

from protocol.link.records import SenderRecord
from protocol.messages import PlantHello

State = Literal["greeting", "serving", "elsewhere", "refused"]

STATES: Final[dict[State, str]] = {
    "greeting": "It serves no plant, and greets whoever speaks of a session.",
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
    "does not follow": "A measurement that the journal rules out: one end's journal was put back.",
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


TABLE: Final[dict[tuple[State, Heard], Row]] = {
    ("greeting", "to anyone"): Row("greet", "greeting"),
    ("greeting", "to anyone, of a later incarnation"): Row("catch up and greet", "greeting"),
    ("greeting", "asked, session fits"): Row("serve", "serving"),
    ("greeting", "asked, session does not fit"): Row("refuse", "greeting"),
    ("greeting", "asked, new session"): Row("adopt and serve", "serving"),
    ("greeting", "asked, session unknown"): Row("refuse", "greeting"),
    ("greeting", "overtaken"): Row("nothing", "greeting"),
    ("greeting", "to a former incarnation"): Row("remind", "greeting"),
    ("greeting", "to another, in the session"): Row("step back", "elsewhere"),
    ("greeting", "to another"): Row("step back", "elsewhere"),
    ("greeting", "second plant"): Row("nothing", "greeting"),
    ("greeting", "another model"): Row("say model", "greeting"),
    ("greeting", "another model, never met"): Row("give up", "refused"),
    ("greeting", "session not taken up"): Row("remind", "greeting"),
    ("greeting", "session elsewhere"): Row("nothing", "greeting"),
    ("greeting", "does not follow"): Row("nothing", "greeting"),
    ("greeting", "blocks differ"): Row("end and greet", "greeting"),
    ("serving", "to anyone"): Row("greet", "serving"),
    ("serving", "to anyone, of a later incarnation"): Row("catch up and greet", "serving"),
    ("serving", "asked, session fits"): Row("serve", "serving"),
    ("serving", "asked, session does not fit"): Row("refuse", "serving"),
    ("serving", "asked, new session"): Row("adopt and serve", "serving"),
    ("serving", "asked, session unknown"): Row("refuse", "serving"),
    ("serving", "overtaken"): Row("nothing", "serving"),
    ("serving", "to a former incarnation"): Row("remind", "serving"),
    ("serving", "to another, in the session"): Row("end and step back", "elsewhere"),
    ("serving", "to another"): Row("step back", "elsewhere"),
    ("serving", "second plant"): Row("log", "serving"),
    ("serving", "another model"): Row("say model", "serving"),
    ("serving", "another model, never met"): Row("give up", "refused"),
    ("serving", "session not taken up"): Row("remind", "serving"),
    ("serving", "session elsewhere"): Row("nothing", "serving"),
    ("serving", "does not follow"): Row("end and greet", "greeting"),
    ("serving", "blocks differ"): Row("end and greet", "greeting"),
    ("elsewhere", "to anyone"): Row("greet", "greeting"),
    ("elsewhere", "to anyone, of a later incarnation"): Row("catch up and greet", "greeting"),
    ("elsewhere", "asked, session fits"): Row("serve", "serving"),
    ("elsewhere", "asked, session does not fit"): Row("refuse", "greeting"),
    ("elsewhere", "asked, new session"): Row("adopt and serve", "serving"),
    ("elsewhere", "asked, session unknown"): Row("refuse", "greeting"),
    ("elsewhere", "overtaken"): Row("nothing", "elsewhere"),
    ("elsewhere", "to a former incarnation"): Row("remind", "greeting"),
    ("elsewhere", "to another, in the session"): Row("step back", "elsewhere"),
    ("elsewhere", "to another"): Row("step back", "elsewhere"),
    ("elsewhere", "second plant"): Row("nothing", "elsewhere"),
    ("elsewhere", "another model"): Row("say model", "elsewhere"),
    ("elsewhere", "another model, never met"): Row("give up", "refused"),
    ("elsewhere", "session not taken up"): Row("remind", "elsewhere"),
    ("elsewhere", "session elsewhere"): Row("nothing", "elsewhere"),
    ("elsewhere", "does not follow"): Row("nothing", "elsewhere"),
    ("elsewhere", "blocks differ"): Row("end and greet", "elsewhere"),
    **{("refused", name): Row("nothing", "refused") for name in get_args(Heard)},
}
"""(state, what was heard) to the answer and the next state. Some pairs cannot occur: there is no
second plant while none is served."""


def heard(
    hello: PlantHello,
    record: SenderRecord,
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
    record : SenderRecord
        The controller's.
    instance, fingerprint : str
        The controller process's id, and its model's.
    plant : str, optional
        The plant process that is served.
    running : bool
        Whether that one was heard just now: another one then has to wait.
    """
    if hello.fingerprint != fingerprint:
        met = record.session is not None or bool(record.ended)
        return "another model" if met else "another model, never met"
    in_session = hello.session == record.session
    if running and not in_session and plant not in (None, hello.instance):
        return "second plant"
    if hello.controller is None:
        later = in_session and hello.incarnation > record.incarnation
        return "to anyone, of a later incarnation" if later else "to anyone"
    asked = hello.controller == instance
    past = in_session and hello.applied_k < record.applied_k
    if past and (not asked or hello.instance == plant):
        return "overtaken"
    if asked and in_session:
        outstanding = record.applied_k if record.offer is None else record.offer.k
        fits = hello.applied_k in (record.applied_k, outstanding)
        return "asked, session fits" if fits else "asked, session does not fit"
    if asked:
        unknown = hello.transitions > 0 or hello.session in record.ended
        return "asked, session unknown" if unknown else "asked, new session"
    if not in_session:
        return "to another"
    former = hello.incarnation < record.incarnation
    return "to a former incarnation" if former else "to another, in the session"
