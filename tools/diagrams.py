"""Diagrams and tables of the documents, made from what the programs use.

``python -m tools.diagrams`` puts them between their marks, with the tables of the studies; a test
says when they are stale.
"""

import ast
import inspect
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from typing import Any, Final, NamedTuple, get_args

from protocol.agreement import NO_SYMBOL
from protocol.link import controller_session as controllers
from protocol.link import plant_session as plants
from protocol.messages import ADVERSARY, FIELD, MANAGEMENT, Message
from protocol.messages.base import Part
from protocol.schemes.base import Scheme
from protocol.schemes.registry import SCHEMES, make_scheme, scheme_named
from protocol.topics import key_of
from studies.registry import Lines, pages, table
from tools import worked_step  # noqa: F401  (its table)
from wyner.runs.check import RULES
from wyner.runs.lines import EVENTS, EventLine, MissedLine, TracedTransition
from wyner.runs.seal import READ, SEAL_ALONE
from wyner.sweeps.code import ROOT

AGREED: Final = "agreed"
NOT_AGREED: Final = "not agreed"


class Arrow(NamedTuple):
    """What a scheme does in state ``s`` on a verdict: the next state, and what both ends do."""

    s: int
    event: str
    following: int
    action: str


def arrows_of(scheme: Scheme[Any]) -> list[Arrow]:
    """Every arrow of a scheme, in order of appearance from its initial state."""
    found: dict[Arrow, None] = {}
    reached, waiting = {scheme.initial}, [scheme.initial]
    while waiting:
        state = waiting.pop(0)
        for verdict in (*range(scheme.alphabet), NO_SYMBOL):
            after, carry = scheme.advance(state, verdict)
            action = ["m[p] = c - key"] if carry.pad != NO_SYMBOL else []
            action += ["keep the key"] if carry.agreed != NO_SYMBOL else []
            action += ["next c = m[p] + key" if scheme.pad(after) != NO_SYMBOL else "next c random"]
            event = NOT_AGREED if verdict == NO_SYMBOL else AGREED
            found[Arrow(state[0], event, after[0], ", ".join(action))] = None
            if after not in reached:
                reached.add(after)
                waiting.append(after)
    return list(found)


def state_diagram(scheme: Scheme[Any]) -> str:
    """A scheme as a Mermaid state diagram; arrows between the same states share a line."""
    drawn: dict[tuple[int, int, str], list[str]] = {}
    for arrow in arrows_of(scheme):
        drawn.setdefault((arrow.s, arrow.following, arrow.action), []).append(arrow.event)
    lines = ["```mermaid", "stateDiagram-v2", "    direction LR"]
    lines.append(f"    [*] --> s{scheme.initial[0]}")
    lines += [f"    s{s} : s = {s}" for s in sorted({s for s, _, _ in drawn})]
    for (s, following, action), events in drawn.items():
        event = "always" if len(events) == 2 else events[0]
        lines.append(f"    s{s} --> s{following} : {event}<br/>{action}")
    return "\n".join([*lines, "```"])


def wire_table(kinds: Sequence[type[Message]]) -> Lines:
    """Messages of a bus: the key they travel on, and their fields, those of their parts too."""
    lines = [("message", "key", "fields")]
    for kind in kinds:
        names = ", ".join(f"`{name}`" for name in _names(kind))
        lines.append((f"`{kind.__name__}`", f"`{key_of(kind, 'LOOP')}`", names))
    return lines


def _names(part: type[Part], before: str = "") -> Iterator[str]:
    for name, field in part.model_fields.items():
        kinds = (field.annotation, *get_args(field.annotation))
        parts = [kind for kind in kinds if inspect.isclass(kind) and issubclass(kind, Part)]
        if parts:
            yield from _names(parts[0], f"{before}{name}.")
        else:
            yield f"{before}{name}"


def session_table(rules: dict[Any, Any]) -> Lines:
    """What comes of what happens to an end, state by state."""
    columns = [state for state in dict.fromkeys(state for state, _ in rules) if state != "refused"]
    lines = [("what happens, in state", *(f"*{state}*" for state in columns))]
    for what in dict.fromkeys(what for _, what in rules):
        lines.append((what, *(_cell(state, rules[state, what]) for state in columns)))
    return lines


def _cell(state: str, row: tuple[str, str]) -> str:
    """A row of the table: the answer, and the next state where it is another one."""
    answer, following = row
    words = ["" if answer == "nothing" else f"**{answer}**"]
    words.append("" if following == state else f"*{following}*")
    return ", ".join(filter(None, words)) or "–"


@table("checks", "protocol")
def check_table() -> Lines:
    """The rules of `wyner check`: where each comes from, and what must hold."""
    head = ("rule", "source", "what must hold")
    return [head, *((rule.name, rule.source, rule.says) for rule in RULES)]


@table("evidence", "guides")
def evidence_table() -> Lines:
    """The files of a run's folder that are evidence, and what holds them to what they were."""
    held = {"rules that read them, and the seal": READ, "the seal alone": SEAL_ALONE}
    lines = [("held by", "files")]
    return lines + [(by, ", ".join(f"`{one}`" for one in files)) for by, files in held.items()]


@table("events", "guides")
def event_table() -> Lines:
    """The lines of a trace: who writes them, their fields, and what their class says of them."""
    return [("event", "of", "fields", "what it says"), *_events()]


def _events() -> Iterator[tuple[str, str, str, str]]:
    for kind in (TracedTransition, MissedLine, *get_args(EventLine)):
        sides = [side for side, kinds in EVENTS.items() if kind in kinds.values()]
        events = [event for event, made in EVENTS[sides[0]].items() if made is kind]
        names = [field.name for field in fields(kind)] if is_dataclass(kind) else kind._fields
        names = [name for name in names if name != "event"]
        yield (
            ", ".join(f"`{event}`" for event in events),
            "both" if len(sides) == 2 else sides[0],
            ", ".join(f"`{name}`" for name in names),
            " ".join((inspect.getdoc(kind) or "").split()).replace("``", "`"),
        )


ROOMS: Final = (
    "protocol",
    "runtime",
    "controller_service",
    "plant_service",
    "tap_service",
    "attacker_service",
    "wyner",
    "studies",
)
"""The importable names, each of which imports those above it at most."""


@table("rooms", "architecture")
def rooms() -> str:
    """The folders of code, each with the first line of what its package says of itself."""
    lines = ["```text"]
    for room in ROOMS:
        for package in sorted((ROOT / room).rglob("__init__.py")):
            folder = package.parent.relative_to(ROOT)
            said = ast.get_docstring(ast.parse(package.read_text(encoding="utf-8"))) or ""
            name = "  " * (len(folder.parts) - 1) + folder.name + "/"
            lines.append(f"{name:<22} {said.splitlines()[0]}")
    return "\n".join([*lines, "```"])


for scheme in SCHEMES:
    if not scheme_named(scheme).corrects:  # one that corrects has a state for each word
        table(scheme, "architecture")(partial(state_diagram, make_scheme(scheme, 2)))
for bus, messages in {"field": FIELD, "management": MANAGEMENT, "adversary": ADVERSARY}.items():
    table(bus, "architecture")(partial(wire_table, messages))
table("plant-session", "protocol")(partial(session_table, plants.TABLE))
table("controller-session", "protocol")(partial(session_table, controllers.TABLE))


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
