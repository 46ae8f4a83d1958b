"""The files' checks: whole, of one scenario, and as far on as their journals."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from runtime.files import read_regular
from runtime.recording import CONTINUED, END, HEADER, decode, parts_of, raw_lines
from runtime.run_folder import (
    ANALYSIS_GUESSES,
    CAPTURE,
    CONTROLLER_JOURNAL,
    CONTROLLER_TRACE,
    GUESSES,
    PLANT_JOURNAL,
    PLANT_TRACE,
    TAP_STATUS,
)
from wyner.runs.check.base import Check, Counter
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.journals import JournalState
from wyner.runs.check.records import Walked
from wyner.runs.check.sides import Segments, SideReader
from wyner.runs.seal import broken, went_on_in

IDENTITY: Final = ("scenario", "fingerprint", "loop")


class Traces(Check):
    """Lines as they should be, numbered without a gap, in rising steps."""

    name = "traces"
    source = "rule 5"
    says = "transitions are whole and numbered without a gap"
    of = "transitions"

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._last: dict[str, tuple[str, int, int]] = {}

    def feed(self, part: Part) -> None:
        for name, items in part.sides():
            for item in items:
                if not isinstance(item, Walked):
                    continue
                t = item.t
                session, j, k = self._last.get(name) or cut_at(self.evidence, name)
                place, least = (j + 1, k) if session == t.session else (0, -1)
                holds = t.j == place and t.k > least
                text = f"{name}'s trace: expected j = {place} and k above {least}"
                self.counter.count(holds, t.session, t.j, t.k, text)
                self._last[name] = (t.session, t.j, t.k)

    def finish(self) -> None:
        e, counter = self.evidence, self.counter
        torn = overwritten = behind = 0
        for name, reader in e.readers():
            torn += sum(part.torn for part in reader.parts)
            overwritten += reader.overwritten
            behind += reader.behind
            for problem in reader.problems:
                counter.fail("", -1, -1, f"{name}'s trace, {problem.where}: {problem.text}")
        if counter.counted == 0 and not e.cut:
            counter.fail("", -1, -1, "no transition: nothing has happened in this run")
        counter.note = f"{torn} torn lines, {overwritten} written again after a kill"
        if behind:
            counter.note += f", {behind} by an end whose journal was put back from an older copy"
        if e.cut:
            counter.note += f"; {e.cut}"


def cut_at(e: Evidence, side: str) -> tuple[str, int, int]:
    """Session, transition and step after which a side's trace is given out."""
    cut = next((reader.cut for name, reader in e.readers() if name == side), None)
    return ("", -1, -1) if cut is None else (cut.session, cut.j, cut.k)


class ScenarioIdentity(Check):
    """The scenario in the folder is the one that every file was made under."""

    name = "scenario"
    source = "rule 6"
    says = "every file was made under the scenario that is there"
    of = "comparisons"

    def finish(self) -> None:
        e, counter = self.evidence, self.counter
        if e.manifest == {}:
            counter.fail("", -1, -1, "manifest.json: expected a JSON object")
        elif e.manifest is not None and not e.manifest.keys() >= set(IDENTITY):
            counter.fail("", -1, -1, "manifest.json: it does not say of which scenario it is")
        self._compare("manifest.json", e.manifest or {})
        for name, reader in e.readers():
            if not reader.header:
                continue  # killed before it, or it is gone: another check says
            what = f"{name}'s trace"
            self._compare(what, reader.header)
            if not reader.header.keys() >= set(IDENTITY):
                counter.fail("", -1, -1, f"{what}: line 1 does not say of which scenario it is")
            if reader.header.get("vantage") != name:
                counter.fail("", -1, -1, f"{what}: vantage is {reader.header.get('vantage')!r}")
        for name, journal in (("plant", e.plant_journal), ("controller", e.controller_journal)):
            if isinstance(journal, str):
                counter.count(False, "", -1, -1, f"{name}'s journal: {journal}")
            elif journal is not None:
                counter.count(True, "", -1, -1)

    def _compare(self, what: str, told: dict[str, Any]) -> None:
        expected = self.evidence.scenario.identity()
        for name in IDENTITY:
            if name in told:
                text = f"{what}: {name} is {told[name]}, the scenario's is {expected[name]}"
                self.counter.count(told[name] == expected[name], "", -1, -1, text)


class Whole(Check):
    """Every recording holds what its writer counted, and goes as far as its journal; the seal."""

    name = "whole"
    source = "rule 6"
    says = "every file is as its writer left it, every trace as far on as its journal"
    of = "files"

    def finish(self) -> None:
        e, counter = self.evidence, self.counter
        killed = 0
        for marks in _recordings(e):
            killed += marks.unended
            counter.count(not marks.problems, "", -1, -1, _first(marks))
        for name, reader in e.readers():
            journal = e.plant_journal if name == "plant" else e.controller_journal
            path = e.run_dir / (PLANT_JOURNAL if name == "plant" else CONTROLLER_JOURNAL)
            if reader.of_last and path.is_file() and _holds_nothing(journal):
                text = f"{name}'s journal holds nothing, its trace's last process"
                counter.count(False, "", -1, -1, f"{text} {reader.of_last} transitions")
            elif isinstance(journal, JournalState):
                text = _behind(reader, journal)
                counter.count(not text, journal.session or "", -1, -1, f"{name}'s trace: {text}")
        _all_there(e, counter)
        _as_the_tap_says(e, counter)
        for name, wrong in broken(e.run_dir, e.manifest):
            counter.count(not wrong, "", -1, -1, f"{name}: {wrong}")
        counter.note = f"{killed} processes without an end mark: killed, or still running"
        if again := sorted(went_on_in(e.run_dir, e.manifest)):
            counter.note += f"; started again since the seal: {', '.join(again)}"


def _all_there(e: Evidence, counter: Counter) -> None:
    """Who has saved a transition has traced it; what one end counted the other has, too."""
    there = dict(e.readers())
    for side, path, journal in (
        ("plant", PLANT_TRACE, e.plant_journal),
        ("controller", CONTROLLER_TRACE, e.controller_journal),
    ):
        if side in there:
            continue
        if isinstance(journal, JournalState) and journal.transitions:
            text = f"{path}: it is gone, and {side}'s journal counts {journal.transitions}"
            counter.count(False, journal.session or "", -1, -1, f"{text} transitions")
        elif e.manifest is not None and any(reader.last for reader in there.values()):
            text = f"{path}: it is gone, and the manifest says that both ends ran here"
            counter.count(False, "", -1, -1, text)


def _first(marks: Segments) -> str:
    return f"{marks.problems[0].where}: {marks.problems[0].text}" if marks.problems else ""


def _recordings(e: Evidence) -> Iterator[Segments]:
    for _, reader in e.readers():
        yield from reader.parts
    if e.wire is not None:
        yield from e.wire.parts
    for stem in (GUESSES, ANALYSIS_GUESSES):
        for path in parts_of(e.run_dir / stem):
            yield _segments_of(path)


def _segments_of(path: Path) -> Segments:
    """The marks of a recording whose lines no check reads."""
    marks = Segments(path.name)
    for number, raw, finished in raw_lines(path):
        marks.newline = finished
        value = decode(raw)
        if value is None:
            marks.malformed(number)
        elif value.get("event") in (HEADER, CONTINUED, END):
            marks.mark(number, raw, value)
        else:
            marks.line(number, raw)
    marks.finish()
    return marks


def _holds_nothing(journal: JournalState | str | None) -> bool:
    """Whether a journal that is there was never written in."""
    return journal is None or (isinstance(journal, JournalState) and journal.session is None)


def _behind(reader: SideReader, journal: JournalState) -> str:
    """In what a trace and its journal differ; empty where they fit."""
    session = journal.session
    if session is None:
        return ""
    counted = reader.transitions.get(session, 0)
    if counted != journal.transitions:
        return f"it has {counted} transitions, its journal counts {journal.transitions}"
    last = reader.last
    if last is None or last.session != session:
        return "" if not journal.transitions else "it goes on after its journal's session"
    if last.s != journal.s:
        return f"it ends in state {last.s}, its journal in state {journal.s}"
    if reader.side == "plant":
        return _elsewhere(reader, journal)
    return ""


def _elsewhere(reader: SideReader, journal: JournalState) -> str:
    """Whether a plant's trace ends where its journal does, to the last missed step."""
    t, missed = reader.last, reader.last_missed
    assert t is not None
    k, x = t.k, t.x_next
    if missed is not None and missed.k > k and missed.session == t.session:
        k, x = missed.k, missed.x_next
        if journal.k == k and not reader.ended:
            return ""  # killed between the two: the step will be made again
    if (k + 1, x) != (journal.k, journal.x):
        return (
            f"it ends in x({k + 1}) = {list(x)}, its journal has x({journal.k}) = {list(journal.x)}"
        )
    return ""


def _as_the_tap_says(e: Evidence, counter: Counter) -> None:
    """The capture has at least the messages that the tap had written by its last report."""
    path = e.run_dir / TAP_STATUS
    if not path.is_file():
        return
    told = decode(read_regular(path)) or {}
    first, captured = told.get("first_part"), told.get("captured")
    if not isinstance(first, int) or not isinstance(captured, int):
        counter.count(False, "", -1, -1, f"{TAP_STATUS}: expected first_part and captured")
    elif e.wire is None:
        text = f"{CAPTURE}: it is gone, the tap had written {captured} messages"
        counter.count(not captured, "", -1, -1, text)
    elif e.wire.dropped_parts <= first:
        there = sum(count for part, count in e.wire.lines.items() if part >= first)
        text = f"the capture has {there} messages, the tap had written {captured}"
        counter.count(there >= captured, "", -1, -1, text)
