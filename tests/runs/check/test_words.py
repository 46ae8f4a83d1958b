"""What the check says of a wrong run, word for word: check, count, place, text and note.

One thing is made wrong at a time, and every finding that differs from the honest run's stands in
``words.txt``. ``WYNER_REWRITE=1`` writes the file anew; look at the difference.
"""

import base64
import copy
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from protocol.link.peer import Actions
from protocol.messages import SendCommand
from runtime.journal import ControllerJournal, PlantJournal
from runtime.recording import part_path
from runtime.run_folder import (
    CAPTURE,
    CONTROLLER_JOURNAL,
    CONTROLLER_TRACE,
    GUESSES,
    MANIFEST,
    PLANT_JOURNAL,
    PLANT_TRACE,
    TAP_STATUS,
)
from tests.support.ended_run import ended_run
from tests.support.lines import unmark
from tests.support.small_run import Lines, SmallRun, read_lines, write_lines
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

WORDS = Path(__file__).with_name("words.txt")
PLANT, CONTROLLER = PLANT_TRACE, CONTROLLER_TRACE
Line = dict[str, Any]
Edit = Callable[[Lines], object]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> SmallRun:
    """Marked by its writers no more, so that each change is seen by what it means."""
    made = ended_run(tmp_path_factory.mktemp("runs") / "words", (b"a", b"b"))
    shutil.copytree(made.folder, made.folder.with_name("marked"))
    for name in (PLANT, CONTROLLER, CAPTURE):
        unmark(made.folder / name)
    return made


def findings(folder: Path) -> dict[str, str]:
    """What each check says, and each line of the traces that cannot be so."""
    said = {}
    evidence = read_evidence(folder)
    for finding in check(evidence):
        told = finding.as_json()
        first = told["first"]
        where = "" if first is None else f" [{first['session'][-2:]} {first['j']} {first['k']}] "
        text = where + ("" if first is None else first["text"])
        head = f"{told['result']} {told['counted']} {told['of']}, {told['failures']} wrong"
        line = f"{told['name']}: {head}{text} | {told['note']}"
        said[told["name"]] = line.replace(f"{folder}/", "").replace(str(folder), "").strip(" |")
    for side, reader in evidence.readers():
        for problem in reader.problems + [p for marks in reader.parts for p in marks.problems]:
            said[f"{side} {problem.where}"] = f"  {side}: {problem.where}: {problem.text}"
    return said


# --- places in a recording ------------------------------------------------------------------------


def nth(lines: Lines, event: str, number: int = 0, **fields: object) -> Line:
    """The body of the ``number``-th line of an event or topic with these fields."""
    found: list[Line] = []
    for line in lines:
        body = line.get("message", line)
        if event in (line["event"], line.get("topic")) and all(
            body.get(name) == value for name, value in fields.items()
        ):
            found.append(body)
    return found[number]


def put(event: str, number: int = 0, /, *, where: Line | None = None, **fields: object) -> Edit:
    """Change fields of a line; a function is given what was there."""

    def edit(lines: Lines) -> None:
        line = nth(lines, event, number, **(where or {}))
        for name, value in fields.items():
            line[name] = value(line[name]) if callable(value) else value

    return edit


def before(event: str, number: int, *new: Line, **where: object) -> Edit:
    """Insert lines before one."""

    def edit(lines: Lines) -> None:
        line = nth(lines, event, number, **where)
        at = next(i for i, each in enumerate(lines) if each.get("message", each) is line)
        lines[at:at] = copy.deepcopy(list(new))

    return edit


def drop(event: str, number: int = 0, **where: object) -> Edit:
    def edit(lines: Lines) -> None:
        line = nth(lines, event, number, **where)
        lines[:] = [each for each in lines if each.get("message", each) is not line]

    return edit


def again(event: str, number: int = 0, **where: object) -> Edit:
    """A line stands there twice."""

    def edit(lines: Lines) -> None:
        line = nth(lines, event, number, **where)
        at = next(i for i, each in enumerate(lines) if each.get("message", each) is line)
        lines.insert(at, copy.deepcopy(lines[at]))

    return edit


def text_of(payload: bytes) -> str:
    return base64.b64encode(payload).decode()


def flip(symbol: int) -> int:
    return 1 - symbol


def up(number: float) -> float:
    return number + 1


def far(x: list[float]) -> list[float]:
    return [*x[:-1], x[-1] + 0.5]


def twice(lines: Lines) -> int:
    """Where a transition stands that was written before."""
    known: set[object] = set()
    for i, line in enumerate(lines):
        if line["event"] == "transition":
            at = (line["session"], line["j"])
            if at in known:
                return i
            known.add(at)
    raise AssertionError("none was written again")


def last_gone(lines: Lines) -> None:
    """Two of the first session: the controller has counted one of them."""
    first = next(line["session"] for line in lines if line["event"] == "transition")
    for _ in range(2):
        drop("transition", -1, session=first)(lines)


def refused(lines: Lines) -> None:
    """In place of the message that was recovered."""
    line = nth(lines, "recovered")
    line.clear()
    line.update(event="refused", session="0" * 16, p=1)


def missed_by_an_older_copy(lines: Lines) -> None:
    """Its journal was put back: it misses the step that it had made, and goes on as before."""
    t = nth(lines, "transition", 59)
    missed = nth(lines, "missed", 1) | {name: t[name] for name in ("session", "k", "x")}
    resumed = {"event": "session", "session": t["session"], "reason": "resumed"}
    before("transition", 60, {"event": "continued"}, resumed, missed)(lines)


def interrupted(lines: Lines, u: list[float] | None = None) -> None:
    """A missed step was under way when the plant's process died, with the input in force."""
    missed = nth(lines, "missed", 1)
    last = next(t for t in lines if t.get("x_next") == missed["x"] and t["event"] == "transition")
    missed.update(event="interrupted", u=u or last["u"])


def empty(lines: Lines) -> None:
    lines[:] = [line for line in lines if line["event"] in ("header", "session")][:2]


def made_otherwise(lines: Lines) -> None:
    """Killed when it had traced a missed step, the plant makes that one anew with its offer."""
    t = nth(lines, "transition", 60)
    missed = nth(lines, "missed", 1) | {name: t[name] for name in ("session", "k", "x")}
    resumed = {"event": "session", "session": t["session"], "reason": "resumed"}
    before("transition", 60, missed, {"event": "continued"}, resumed)(lines)


def reordered(lines: Lines) -> None:
    """It says the same."""
    offer = nth(lines, "offer", 60)
    line = next(one for one in lines if one.get("message") is offer)
    line["event"] = line.pop("event")


AGREED = {"role": "test", "s": 2}
CARRIES = {"role": "message"}
SEALED = {
    "topic": "sealed",
    "message": {"v": 3, "id": "m", "key_ids": ["a"], "cipher": "aGk=", "tag": "0" * 32},
}
SENT = {"event": "sent", "id": "m7", "payload": text_of(b"c")}

EDITS: dict[str, tuple[tuple[Path, Edit], ...]] = {
    "nothing": (),
    # traces
    "transition with another j": ((PLANT, put("transition", 60, j=up)),),
    "transition with an earlier k": ((CONTROLLER, put("transition", 60, k=0)),),
    "transition gone": ((PLANT, drop("transition", 60)),),
    "transition twice": ((PLANT, again("transition", 60)),),
    "transition with a field more": ((PLANT, put("transition", 60, y=1)),),
    "transition without u": ((PLANT, put("transition", 60, u=None)),),
    "transition with a coin at the controller": ((CONTROLLER, put("transition", 60, coin=0)),),
    "x too short": ((PLANT, put("transition", 60, x=[0.0])),),
    "x_next too short": ((PLANT, put("transition", 60, x_next=[0.0])),),
    "one candidate": ((PLANT, put("transition", 60, candidates=[[0.0]])),),
    "one gauge": ((PLANT, put("transition", 60, gauges=[0.0])),),
    "cipher beyond": ((PLANT, put("transition", 60, cipher=2)),),
    "counts beyond": ((PLANT, put("transition", 60, counts=4)),),
    "coin beyond": ((PLANT, put("transition", 60, coin=2)),),
    "predictions": ((PLANT, put("transition", 60, predictions=[[0.0, 0.0]] * 2)),),
    "missed too short": ((PLANT, put("missed", 1, u=[])),),
    "missed beyond 64 bits": ((PLANT, put("missed", 1, k=2**64)),),
    "missed with candidates": ((PLANT, put("missed", 1, candidates=[[0.0]] * 2)),),
    "unknown event": ((PLANT, before("transition", 60, {"event": "hello"})),),
    "event no text": ((PLANT, before("transition", 60, {"event": 3})),),
    "payload no base64": ((PLANT, put("recovered", payload="a")),),
    "payload no text": ((PLANT, put("recovered", payload=1)),),
    "session announced twice": ((PLANT, again("session", 2)),),
    "session not announced": ((PLANT, put("session", 2, session="f" * 16)),),
    "session gone": ((PLANT, drop("session", 2)),),
    "session gone at the controller": ((CONTROLLER, drop("session")),),
    "the last transitions of a session gone": ((PLANT, last_gone),),
    "a missed step that was made after a restart": ((PLANT, made_otherwise),),
    "a step missed that an older copy had made": ((PLANT, missed_by_an_older_copy),),
    "an interrupted step": ((PLANT, interrupted),),
    "an interrupted step with another input": ((PLANT, lambda ls: interrupted(ls, [0.1])),),
    "nothing has happened": ((PLANT, empty), (CONTROLLER, empty)),
    "continued and no session": ((PLANT, before("transition", 60, {"event": "continued"})),),
    "a second header": ((PLANT, before("transition", 60, {"event": "header"})),),
    "an end in the middle": (
        (PLANT, before("transition", 60, {"event": "end", "lines": 1, "sha256": ""})),
    ),
    "two ends": ((PLANT, lambda ls: ls.extend([{"event": "end", "lines": 1, "sha256": ""}] * 2)),),
    # the loop
    "k too far": ((PLANT, put("transition", 60, k=up)), (CONTROLLER, put("transition", 60, k=up))),
    "x elsewhere": (
        (PLANT, put("transition", 60, x=far)),
        (CONTROLLER, put("transition", 60, x=far)),
    ),
    "x_next out of reach": (
        (PLANT, put("transition", 60, x_next=far)),
        (CONTROLLER, put("transition", 60, x_next=far)),
    ),
    "u no candidate": ((PLANT, put("transition", 60, u=[0.1])),),
    "a wrong fallback": ((PLANT, put("missed", 1, u=[0.1])),),
    "the last input stands where zero is agreed": (
        (PLANT, lambda ls: nth(ls, "missed", 1).update(u=nth(ls, "transition", -11)["u"])),
    ),
    "a missed step out of reach": ((PLANT, put("missed", 1, x_next=far)),),
    "a candidate beyond U": tuple(
        (p, put("transition", 60, candidates=lambda c: [c[0], [9.0]])) for p in (PLANT, CONTROLLER)
    ),
    "a candidate that leads too far": tuple(
        (p, put("transition", 60, candidates=lambda c: [c[0], [5.9]])) for p in (PLANT, CONTROLLER)
    ),
    "a candidate beyond U that leads no further than it may": tuple(
        (p, put("transition", 60, x=[-8.0, -3.0], candidates=[[5.9], [6.05]]))
        for p in (PLANT, CONTROLLER)
    ),
    "a state beyond every set": tuple(
        (p, put("transition", 60, x=[1e6, 0.0])) for p in (PLANT, CONTROLLER)
    ),
    "a state that is no number": tuple(
        (p, put("transition", 60, x=[1e200, -1e200])) for p in (PLANT, CONTROLLER)
    ),
    # the keys
    "another gauge": ((CONTROLLER, put("transition", 60, gauges=far)),),
    "another symbol": ((PLANT, put("transition", 0, where=AGREED, symbol=flip)),),
    "a symbol where none was agreed": ((PLANT, put("transition", 30, where={"s": 1}, symbol=0)),),
    "another coin": ((PLANT, put("transition", 0, where=AGREED, coin=flip)),),
    "another state": ((CONTROLLER, put("transition", 60, s=lambda s: 3 - s)),),
    "another role": ((PLANT, put("transition", 4, where=CARRIES, role="test")),),
    "another key": ((PLANT, put("transition", 4, where=CARRIES, key=flip)),),
    "another message symbol": ((PLANT, put("transition", 4, where=CARRIES, message_symbol=flip)),),
    "another p": ((CONTROLLER, put("transition", 60, p=up)),),
    "a key twice": tuple(
        (p, put("transition", 0, where={"role": "test", "s": 1}, role="message", key=1))
        for p in (PLANT, CONTROLLER)
    ),
    # the message
    "recovered otherwise": ((PLANT, put("recovered", payload=text_of(b"x"))),),
    "recovered gone": ((PLANT, drop("recovered")),),
    "recovered early": (
        (PLANT, before("transition", 60, {"event": "recovered", "payload": text_of(b"a")})),
    ),
    "a frame refused": (
        (PLANT, drop("recovered")),
        (
            PLANT,
            before("transition", -9, {"event": "refused", "session": "0" * 16, "p": 1}),
        ),
    ),
    "a frame refused, and none recovered": ((PLANT, refused),),
    "a symbol that was never sent": (
        (CONTROLLER, put("transition", 4, where=CARRIES, role="test")),
    ),
    "queued twice": ((CONTROLLER, lambda ls: ls.extend([SENT, SENT])),),
    "queued otherwise": ((CONTROLLER, put("sent", 0, payload=text_of(b"x"))),),
    "delivered otherwise": ((CONTROLLER, put("delivered", payload=text_of(b"x"))),),
    "delivered under another name": ((CONTROLLER, put("delivered", id="m9")),),
    "delivered and never arrived": (
        (
            CONTROLLER,
            before("transition", 60, {"event": "delivered", "id": "m1", "payload": text_of(b"b")}),
        ),
    ),
    # written twice, after a kill
    "written again otherwise": ((PLANT, put("transition", 21, cipher=flip, p=up)),),
    "written again, and again without a restart": (
        (PLANT, lambda ls: ls.insert(twice(ls), copy.deepcopy(ls[twice(ls)]))),
    ),
    # the capture
    "a cipher changed": ((CAPTURE, put("offer", 60, cipher=flip)),),
    "a cipher of an offer that was lost changed": ((CAPTURE, put("offer", 9, cipher=flip)),),
    "a cipher that is none": ((CAPTURE, put("offer", 60, cipher="1")),),
    "other candidates": ((CAPTURE, put("offer", 60, candidates=[[0.0], [1.0]])),),
    "another x": ((CAPTURE, put("measurement", 60, x=far)),),
    "another x, after the last step": ((CAPTURE, put("measurement", -1, x=far)),),
    "another state after": ((CAPTURE, put("measurement", 60, x_after=far)),),
    "another x, and another state after": ((CAPTURE, put("measurement", 60, x=far, x_after=far)),),
    "another step applied": ((CAPTURE, put("measurement", 60, applied_k=0)),),
    "a step beyond": ((CAPTURE, put("measurement", 60, k=100_000)),),
    "two steps beyond, of one number and unlike": (
        (CAPTURE, put("measurement", 60, k=100_000)),
        (CAPTURE, put("measurement", 61, k=100_000)),
    ),
    "an unknown session": ((CAPTURE, put("offer", 60, session="f" * 16)),),
    "a field more": ((CAPTURE, put("offer", 60, key=1)),),
    "a field in another order": (
        (CAPTURE, lambda ls: [m.update(v=m.pop("v")) for m in [nth(ls, "offer", 60)]]),
    ),
    "a line of the capture in another order": ((CAPTURE, reordered),),
    "no object": (
        (
            CAPTURE,
            before("offer", 60, {"event": "field", "t_ns": 1, "topic": "offer", "message": 3}),
        ),
    ),
    "an unknown topic": (
        (CAPTURE, before("offer", 60, {"event": "field", "t_ns": 1, "topic": "x", "message": {}})),
    ),
    "an unknown line": ((CAPTURE, before("offer", 60, {"event": "hum"})),),
    "a sealed message where no keys are made": (
        (CAPTURE, before("offer", 60, {"event": "field", "t_ns": 1, **SEALED})),
    ),
    "malformed": (
        (
            CAPTURE,
            before("offer", 60, {"event": "malformed", "t_ns": 1, "key": "k", "base64": "aGk="}),
        ),
    ),
    "garbage without bytes": (
        (CAPTURE, before("offer", 60, {"event": "malformed", "base64": "a"})),
    ),
    "a message gone": ((CAPTURE, drop("offer", 60)),),
    "answered twice, differently": (
        (CAPTURE, again("offer", 60)),
        (CAPTURE, put("offer", 60, candidates=lambda c: [c[0], far(c[1])])),
    ),
    "a capture of another part": ((CAPTURE, put("header", part=2)),),
    "a capture of another format": ((CAPTURE, put("header", format="x", capture_version=9)),),
    "a blurred capture": (
        (CAPTURE, put("header", view=lambda v: v | {"noise": 0.1})),
        (CAPTURE, put("measurement", 60, x=far)),
    ),
    # whose it is
    "a trace of another scenario": ((PLANT, put("header", scenario="paper")),),
    "a trace of another model": ((CONTROLLER, put("header", fingerprint="0" * 16)),),
    "a trace of no scenario": ((PLANT, lambda ls: [ls[0].pop(n) for n in ("scenario", "loop")]),),
    "a trace of the other side": ((PLANT, put("header", vantage="controller")),),
    "a trace of another version": ((PLANT, put("header", version=99)),),
    "a trace that ends early": ((PLANT, lambda ls: ls.__delitem__(slice(-4, None))),),
    "a trace that ends in a missed step": (
        (
            PLANT,
            lambda ls: ls.append(nth(ls, "missed", -1) | {"k": nth(ls, "transition", -1)["k"] + 1}),
        ),
    ),
}


def journal_received(folder: Path, run: SmallRun) -> None:
    with PlantJournal(folder / PLANT_JOURNAL, run.scenario.fingerprint()) as journal:
        journal.save(Actions(record=run.receiver.record, received=b"z"))


def journal_queue(folder: Path, run: SmallRun) -> None:
    with ControllerJournal(folder / CONTROLLER_JOURNAL, run.scenario.fingerprint()) as journal:
        journal.save(Actions(record=run.sender.record, queued=SendCommand(id="m5", payload=b"e")))


def journal_behind(folder: Path, run: SmallRun, **fields: Any) -> None:
    with PlantJournal(folder / PLANT_JOURNAL, run.scenario.fingerprint()) as journal:
        journal.save(Actions(record=run.receiver.record._replace(**fields)))


def rewrite_json(name: Path, **fields: object) -> Callable[[Path, SmallRun], None]:
    def change(folder: Path, _run: SmallRun) -> None:
        old = json.loads((folder / name).read_text())
        new = {k: v for k, v in (old | fields).items() if v is not None}
        (folder / name).write_text(json.dumps(new))

    return change


def of_record(name: str, change: Callable[[Any], Any]) -> Callable[[Path, SmallRun], None]:
    return lambda folder, run: journal_behind(
        folder, run, **{name: change(getattr(run.receiver.record, name))}
    )


Change = Callable[[Path, SmallRun], object]


def edited(edits: tuple[tuple[Path, Edit], ...]) -> Change:
    def change(folder: Path, _run: SmallRun) -> None:
        for file, edit in edits:
            lines = read_lines(folder / file)
            edit(lines)
            write_lines(folder / file, lines)

    return change


def of_another_model(folder: Path, _run: SmallRun) -> None:
    (folder / CONTROLLER_JOURNAL).unlink()
    ControllerJournal(folder / CONTROLLER_JOURNAL, "f" * 16).close()


def missed_and_further_on(folder: Path, run: SmallRun) -> None:
    edited(EDITS["a trace that ends in a missed step"])(folder, run)
    journal_behind(folder, run, k=run.receiver.record.k + 5)


def without_a_beginning(folder: Path, _run: SmallRun) -> None:
    lines = read_lines(folder / PLANT)
    (folder / PLANT).unlink()
    write_lines(part_path(folder / PLANT, 1), lines[1:])


def cut_and_received(folder: Path, run: SmallRun) -> None:
    """What is left of the plant's trace begins after its first twenty transitions."""
    lines = read_lines(folder / PLANT)
    at = lines.index(nth(lines, "transition", 20))
    (folder / PLANT).unlink()
    write_lines(part_path(folder / PLANT, 1), [lines[0] | {"part": 1, "oldest": 1}, *lines[at:]])
    journal_received(folder, run)


FOLDERS: dict[str, Change] = {
    "the plant's journal has received more": journal_received,
    "the controller's journal has queued more": journal_queue,
    "the plant's journal is a step on": of_record("k", up),
    "the plant's journal is elsewhere": of_record("x", lambda x: (x[0] + 1e-9, x[1])),
    "the plant's journal counts more": of_record("transitions", up),
    "the plant's journal is in the other state": of_record(
        "state", lambda s: s._replace(s=3 - s.s)
    ),
    "the plant's journal is of another session": of_record("session", lambda _s: "e" * 16),
    "no journal at the plant": lambda folder, _run: (folder / PLANT_JOURNAL).write_bytes(
        b"none" * 99
    ),
    "a journal of another model": of_another_model,
    "no manifest": lambda folder, _run: (folder / MANIFEST).unlink(),
    "a manifest that is none": lambda folder, _run: (folder / MANIFEST).write_text("[]"),
    "a manifest of no scenario": rewrite_json(MANIFEST, scenario=None),
    "a manifest of the identity alone": rewrite_json(MANIFEST, wyner=None),
    "a manifest of another loop": rewrite_json(MANIFEST, loop="other"),
    "no capture": lambda folder, _run: (folder / CAPTURE).unlink(),
    "no plant's trace": lambda folder, _run: (folder / PLANT).unlink(),
    "no controller's trace": lambda folder, _run: (folder / CONTROLLER).unlink(),
    "no words of the tap": lambda folder, _run: (folder / TAP_STATUS).write_text("{}"),
    "the tap had written more": rewrite_json(TAP_STATUS, captured=100_000),
    "the first parts were dropped": lambda folder, _run: (folder / CAPTURE).rename(
        (folder / CAPTURE).with_name("capture.0003.jsonl")
    ),
    "guesses torn in the middle": lambda folder, _run: (folder / GUESSES).write_bytes(
        b'{"event":"header"}\n{"a\n{"event":"guess"}\n'
    ),
    "guesses without a header": lambda folder, _run: (folder / GUESSES).write_bytes(
        b'{"event":"guess"}\n{"event":"end","lines":7}\n'
    ),
    "a line of the plant's that is none": lambda folder, _run: (folder / PLANT).write_bytes(
        (folder / PLANT).read_bytes().replace(b'"j":30,', b'"j":,', 1)
    ),
    "a last line without its end": lambda folder, _run: (folder / PLANT).write_bytes(
        (folder / PLANT).read_bytes()[:-9]
    ),
    "the first part gone, and the second without a header": without_a_beginning,
    "cut, and the plant's journal has received more": cut_and_received,
    "a trace that ends in a missed step, its journal further on": missed_and_further_on,
    "no header, and another scenario at the other side": edited(
        ((PLANT, lambda ls: ls.__delitem__(0)), (CONTROLLER, put("header", scenario="paper")))
    ),
    "marked": edited(()),
    "marked, and torn before the end": lambda folder, _run: (folder / PLANT).write_bytes(
        (folder / PLANT).read_bytes().replace(b'\n{"event":"end"', b'\n{"a\n{"event":"end"')
    ),
    "marked, and a capture's number changed": edited(EDITS["another x"]),
    "marked, and an empty line more": lambda folder, _run: (folder / PLANT).write_bytes(
        (folder / PLANT).read_bytes() + b"\n"
    ),
    "marked, and a message after the end": lambda folder, _run: (folder / CAPTURE).write_bytes(
        (folder / CAPTURE).read_bytes() + (folder / CAPTURE).read_bytes().splitlines(True)[-2]
    ),
    "a capture's line that is none": lambda folder, _run: (folder / CAPTURE).write_bytes(
        (folder / CAPTURE).read_bytes().replace(b'"k":30,', b'"k":,', 1)
    ),
}


CHANGES = {name: edited(edits) for name, edits in EDITS.items()} | FOLDERS


def written() -> dict[str, str]:
    """The findings by what is wrong."""
    sections = WORDS.read_text().removeprefix("# ").split("\n\n# ")
    return {name: said.strip("\n") for name, _, said in (s.partition("\n") for s in sections)}


@pytest.fixture(scope="module")
def honest(run: SmallRun) -> dict[str, str]:
    return findings(run.folder)


@pytest.mark.parametrize("name", ["honest", *CHANGES])
def test_what_is_said_of_everything_that_can_be_wrong(
    name: str, run: SmallRun, honest: dict[str, str], tmp_path: Path
) -> None:
    marked = name.startswith("marked")
    source = run.folder.with_name("marked") if marked else run.folder
    folder = Path(shutil.copytree(source, tmp_path / "run"))
    if name != "honest":
        CHANGES[name](folder, run)
    found = findings(folder)
    said = "\n".join(v for k, v in found.items() if name == "honest" or v != honest.get(k))
    if os.environ.get("WYNER_REWRITE"):
        now = (written() if WORDS.exists() else {}) | {name: said}
        texts = [f"# {n}\n{now[n]}".strip() for n in ["honest", *CHANGES] if n in now]
        WORDS.write_text("\n\n".join(texts) + "\n")
    assert said == written()[name], "WYNER_REWRITE=1 writes it anew"
