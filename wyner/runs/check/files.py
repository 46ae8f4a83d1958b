"""Files: whole, of one scenario, and as far on as their journals."""

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from runtime.files import read_regular
from runtime.recording import decode, number_of, parts_of, raw_lines
from runtime.run_folder import CAPTURE, GUESSES, PLANT_JOURNAL, TAP_STATUS
from wyner.runs.check.evidence import Evidence, Finding, Findings, before, columns
from wyner.runs.journals import JournalState
from wyner.runs.lines import TRANSITION
from wyner.runs.marks import Segments
from wyner.runs.run import TRACES, guess_logs
from wyner.runs.seal import broken
from wyner.runs.trace import Trace


def traces(e: Evidence) -> Findings:
    """Lines as they should be, numbered without a gap, in rising steps."""
    for trace in e.ends():
        name, cut = f"{trace.side}'s trace", before(trace)
        for where, text in trace.problems:
            yield Finding("traces", "", -1, f"{name}, {where}: {text}")
        place = (-1, -1, -1) if cut is None else (0, cut.j, cut.k)  # of the transition before
        for rows in trace.chunks(TRANSITION):
            for session, j, k in zip(*columns(rows, "session", "j", "k"), strict=True):
                due, least = (place[1] + 1, place[2]) if session == place[0] else (0, -1)
                if j != due or k <= least:
                    text = f"{name}: j = {j}, expected {due}, and k above {least}"
                    yield Finding("traces", trace.sessions[session], k, text)
                place = session, j, k
    if not e.cut and not any(trace.transitions for trace in e.ends()):
        yield Finding("traces", "", -1, "no transition: nothing has happened in this run")


def whole(e: Evidence) -> Findings:
    """Every file is as its writer left it, of this scenario, and as far on as its journal."""
    sealed = (f"{name}: {wrong}" for name, wrong in broken(e.folder, e.run.manifest))
    for text in (*_identity(e), *_recorded(e), *_kept(e), *_as_the_tap_says(e), *sealed):
        yield Finding("whole", "", -1, text)


def _identity(e: Evidence) -> Iterator[str]:
    identity = e.scenario.identity()
    due = {name: identity[name] for name in ("scenario", "fingerprint", "loop")}
    told = [] if e.run.manifest is None else [("manifest.json", e.run.manifest, due)]
    for trace in e.ends():
        if trace.header:  # else killed before it, or it is gone
            told.append((f"{trace.side}'s trace", trace.header, due | {"vantage": trace.side}))
    for what, values, expected in told:
        for name, value in expected.items():
            if values.get(name) != value:
                yield f"{what}: {name} is {values.get(name)!r}, expected {value!r}"


def _recorded(e: Evidence) -> Iterator[str]:
    """What does not fit the marks of a recording."""
    parts = [part for trace in e.ends() for part in trace.parts]
    parts += [] if e.capture is None else e.capture.parts
    for path in (path for stem in guess_logs(e.folder) for path in parts_of(stem)):
        marks = Segments(path.name)
        deque(marks.read(path), maxlen=0)  # no rule reads the lines
        parts.append(marks)
    for marks in parts:
        yield from (f"{where}: {text}" for where, text in marks.problems)
    yield from _told_alike(e)


def _told_alike(e: Evidence) -> Iterator[str]:
    """The tap began what Eve heard and her guesses with one header: told what, how well."""
    captured, guessed = (_header(e.folder / name) for name in (CAPTURE, GUESSES))
    fields = captured.keys() | guessed.keys() if captured and guessed else set()
    for field in sorted(fields - {"started_ns"}):
        if captured.get(field, "none") != guessed.get(field, "none"):
            yield f"{CAPTURE} and {GUESSES}: their headers differ in {field}"


def _header(recording: Path) -> dict[str, Any]:
    """The header of a recording's first part; empty where it is gone."""
    first = next(iter(parts_of(recording)), None)
    if first is None or number_of(first):
        return {}
    _, raw, _ = next(raw_lines(first), (0, b"", False))
    return decode(raw) or {}


def _kept(e: Evidence) -> Iterator[str]:
    """Who has saved a transition has traced it; what one end counted the other has, too."""
    there = {trace.side: trace for trace in e.ends()}
    for side, journal in e.journals.items():
        trace, recording = there.get(side), TRACES[side]
        file = e.folder / recording.with_name(PLANT_JOURNAL.name)
        if isinstance(journal, str):
            yield f"{side}'s journal: {journal}"
        elif trace is None:
            if journal is not None and journal.transitions:
                text = f"it is gone, and {side}'s journal counts {journal.transitions} transitions"
                yield f"{recording}: {text}"
            elif e.run.manifest is not None and any(t.last for t in there.values()):
                yield f"{recording}: it is gone, and the manifest says that both ends ran here"
        elif journal is not None and journal.session is not None:
            if text := _behind(trace, journal, journal.session):
                yield f"{side}'s trace: {text}"
        elif trace.of_last and file.is_file():
            text = f"{side}'s journal holds nothing, its trace's last process"
            yield f"{text} {trace.of_last} transitions"


def _behind(trace: Trace, journal: JournalState, session: str) -> str:
    """In what a trace and its journal differ; empty where they fit."""
    counted, last = trace.transitions.get(session, 0), trace.last
    saved = journal.ahead >= 0 and trace.untraced is None
    due = journal.transitions + saved
    if counted != due:
        return f"it has {counted} transitions, its journal counts {due}"
    if last is None or last.session != session:
        return "it goes on after its journal's session" if journal.transitions else ""
    found, kept = (last.k, last.x), (journal.k, journal.x)
    if not saved:
        if last.s != journal.s:
            return f"it ends in state {last.s}, its journal in state {journal.s}"
        found, missed = (last.k + 1, last.x_next), trace.last_missed
        if missed is not None and missed.k > last.k and missed.session == session:
            found = missed.k + 1, missed.x_next
            if journal.k == missed.k and not trace.ended:
                return ""  # killed between the two: the step will be made again
    if trace.side == "controller" or found == kept:
        return ""
    return f"it ends with step and state {found}, its journal with {kept}"


def _as_the_tap_says(e: Evidence) -> Iterator[str]:
    """The capture has at least the messages that the tap had written by its last report."""
    path = e.folder / TAP_STATUS
    if not path.is_file():
        return
    told: dict[str, Any] = decode(read_regular(path)) or {}
    first, captured = told.get("first_part"), told.get("captured")
    if not isinstance(first, int) or not isinstance(captured, int):
        yield f"{TAP_STATUS}: expected first_part and captured"
        return
    if e.capture is None or e.capture.dropped_parts <= first:
        lines = {} if e.capture is None else e.capture.lines
        there = sum(count for part, count in lines.items() if part >= first)
        if there < captured:
            yield f"the capture has {there} messages, the tap had written {captured}"
