"""The page of a run: read from its folder, judged by the same code as ``check`` and ``secrecy``."""

import json
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from protocol.text import readable
from runtime.files import read_regular, write_atomically
from runtime.run_folder import MANIFEST
from wyner.runs.check import Result, judge
from wyner.runs.check.evidence import Evidence, read_evidence
from wyner.runs.page.chart import Curve, Flag, Mark, Points, Series, chart
from wyner.runs.run import Run
from wyner.runs.score.attacked import attack_lines, attacked
from wyner.runs.score.counts import costs, total, truth_of
from wyner.runs.score.report import HEADINGS, NOTE, remarks, rows
from wyner.runs.score.report import report as report_of
from wyner.runs.score.score import (
    RunScore,
    ScoreError,
    TapOutput,
    Truth,
    read_said,
    read_truth,
    score,
)
from wyner.runs.score.summary import in_short
from wyner.runs.seal import FILES, ITSELF
from wyner.runs.trace import AT_ONCE, TRANSITION, Rows

PAGE: Final = Path("report.html")

STYLE: Final = """
:root { color-scheme: light dark; --ink: #1b1b1b; --faint: #8885; --paper: #fff; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e8e8; --paper: #16181c; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 800px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
svg { width: 100%; height: auto; } svg text { font-size: 11px; fill: var(--ink); }
.grid { stroke: var(--faint); stroke-width: .5; fill: none; }
.line { fill: none; stroke-width: 1.5; }
.flag { stroke: var(--ink); stroke-dasharray: 2 2; fill: none; }
.mark { stroke: var(--ink); stroke-width: .7; }
.star { fill: var(--ink); } .sample { width: 28px; height: 8px; }
.legend { display: flex; flex-wrap: wrap; gap: .2em 1.2em; margin: 0; font-size: .85em; }
table { border-collapse: collapse; font-size: .85em; width: 100%; }
td, th { text-align: left; vertical-align: top; padding: .2em .8em .2em 0;
  border-bottom: 1px solid var(--faint); }
pre { white-space: pre-wrap; overflow-wrap: anywhere; border-left: 3px solid var(--faint);
  padding-left: .8em; } .note { font-size: .85em; opacity: .8; }
.band { stroke: none; fill-opacity: .35; } .FAIL { font-weight: bold; }
"""

SHOWN: Final = 5
"""Messages that are shown, the last."""


def write_report(run_dir: Path, output: Path | None = None) -> Path:
    """Write a run's page; returns its path.

    Parameters
    ----------
    run_dir : Path
    output : Path, optional
        ``report.html`` in the run's folder if not given.

    Raises
    ------
    FileNotFoundError, ScenarioError, TraceError
        When there is no run, or it cannot be read.
    OSError
        When the page cannot be written.
    """
    path = run_dir / PAGE if output is None else output
    evidence = read_evidence(run_dir)
    write_atomically(path, page(evidence, _outputs(evidence.run)).encode())
    return path


def _outputs(run: Run) -> list[TapOutput] | str:
    """What the eavesdroppers said, or why that is not known."""
    try:
        return read_said(run)
    except ScoreError as error:
        return str(error)


def page(e: Evidence, said: list[TapOutput] | str) -> str:
    """The whole page."""
    results = judge(e)  # first: it takes most room, and gives it back
    recorded = _Recorded(e)
    s, attack = e.scenario, attacked(e.run).as_json()
    period_s = s.plant.period_s
    if e.plant is None or isinstance(said, str):
        why = escape(said if isinstance(said, str) else "no plant trace")
        keys = secrecy = [f"<p>Not known: {why}.</p>"]
    else:
        truth = read_truth(e.run)
        keys, secrecy = list(_keys(e, truth, said)), list(_secrecy(e, truth, said))
    parts = [
        f"<h1>{escape(s.name)}</h1><p>{escape(s.description)}</p>",
        f"<p>Rules, below: {_counts(results)}.</p>",
        *_section("What counts as secret by the paper's rule, and what is", secrecy),
        *_attack(attack),
        *_section("What was sent and what arrived", _message(e, recorded)),
        *_section("States and inputs", _loop(e, recorded, _flags(attack, period_s))),
        *_section("Keys against taps", keys),
        *_section("Rules", _rules(results)),
        *_section("The run", _about(e)),
    ]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>wyner: {escape(s.name)}</title><style>{STYLE}</style></head><body>"
        f"{''.join(parts)}</body></html>\n"
    )


def _attack(found: dict[str, Any] | None) -> Iterator[str]:
    """What an attack came to; nothing where nobody attacked."""
    if found is None:
        return
    lines = [
        f"<p>{escape(line.removeprefix('Attack').strip())}</p>" for line in attack_lines(found)
    ]
    table = _table(("parameter", "value"), [(k, json.dumps(v)) for k, v in found.items()])
    yield from _section("The attack", [*lines, table])


def _flags(found: dict[str, Any] | None, step_s: float = 1.0) -> list[Flag]:
    """Onset and alarm of an attack, where a step takes ``step_s`` of an axis."""
    if found is None:
        return []
    onset, alarm, delay = found["onset"], found["alarm_k"], found["delay"]
    flags = [Flag(onset * step_s, f"attack, step {onset}")]
    if alarm >= 0:
        flags.append(Flag(alarm * step_s, f"alarm, step {alarm}: after {delay}"))
    return flags


def _counts(results: Sequence[Result]) -> str:
    kinds = [r.result for r in results]
    return ", ".join(f"{kinds.count(r)} {r}" for r in ("PASS", "FAIL", "SKIP"))


def _section(title: str, parts: Iterable[str]) -> Iterator[str]:
    yield f"<section><h2>{escape(title)}</h2>"
    yield from parts
    yield "</section>"


class _Recorded:
    """What the page shows of the traces: the steps since the plant last began, and the messages.

    Of each line it keeps what is drawn, so that a page of a million steps is made like any other.
    """

    def __init__(self, e: Evidence) -> None:
        self.payloads = {name: deque[bytes](maxlen=SHOWN) for name in ("sent", "recovered")}
        self.messages = dict.fromkeys(self.payloads, 0)
        for trace in e.ends():
            for told in trace.told(*self.payloads):
                self.payloads[told.line.event].append(told.payload)
                self.messages[told.line.event] += 1
        s = self._scenario = e.scenario
        self.steps = self.missed = self.symbols = 0
        self.cost = 0.0
        self.states = [Series() for _ in range(s.readings)]
        self.inputs = [Series() for _ in range(s.m)]
        self.true_states = [Series() for _ in range(s.n)]
        self.agreed: list[int] = []
        if e.plant is not None:
            rows = e.plant.rows
            begun = np.flatnonzero((rows["k"] == 0) & (np.diff(rows["session"], prepend=-1) != 0))
            for first in range(begun[-1] if len(begun) else 0, len(rows), AT_ONCE):
                self._take(rows[first : first + AT_ONCE])

    def _take(self, rows: Rows) -> None:
        counted = rows["kind"] == TRANSITION
        self.steps += len(rows)
        self.missed += int((~counted).sum())
        self.symbols += int((rows["message_symbol"] >= 0).sum())
        self.agreed += rows["k"][rows["symbol"] >= 0].tolist()
        self.cost = total(self.cost, costs(self._scenario.cost_weights, rows))
        at = rows["k"] * self._scenario.plant.period_s
        later = at + self._scenario.plant.period_s
        for series, times, values in (
            (self.states, at, rows["x"]),
            (self.inputs, at, rows["u"]),
            (self.true_states, later, truth_of(rows)),
        ):
            for line, column in zip(series, values.T if values is not None else (), strict=False):
                for point in zip(times.tolist(), column.tolist(), strict=True):
                    if point[1] == point[1]:
                        line.add(*point)


def _message(e: Evidence, recorded: _Recorded) -> Iterator[str]:
    seconds = recorded.steps * e.scenario.plant.period_s
    for title, name in (("Sent", "sent"), ("Recovered", "recovered")):
        yield f"<p>{title}, {recorded.messages[name]}:</p>"
        yield from (f"<pre>{escape(readable(p))}</pre>" for p in recorded.payloads[name])
    rate = recorded.symbols * float(np.log2(e.rules.size)) / seconds if seconds else 0.0
    yield (
        f"<p>{recorded.steps} steps ({recorded.missed} missed) in {seconds:g} s of plant time; "
        f"{len(recorded.agreed)} key symbols agreed, {recorded.symbols} message symbols carried, "
        f"{rate:.3g} bits a second. That is what was sent, counted and so without an interval; "
        "what stayed secret is above.</p>"
    )
    if recorded.steps:
        yield f"<p>Control cost: {recorded.cost / recorded.steps:.4g} a step, x' Q x + u' R u.</p>"


def _loop(e: Evidence, recorded: _Recorded, flags: Sequence[Flag]) -> Iterator[str]:
    if not recorded.steps:
        yield "<p>The plant left no trace.</p>"
        return
    T = e.scenario.plant.period_s
    read = "x" if e.rules.outputs is None else "y"
    states = [
        Curve(f"{read}{i + 1}", line.points(), i, banded=True)
        for i, line in enumerate(recorded.states)
    ]
    states += [
        Curve(f"x{i + 1} in truth", points, e.rules.states + i, banded=True)
        for i, line in enumerate(recorded.true_states)
        if (points := line.points())
    ]
    inputs = [
        Curve(f"u{i + 1}", line.points(), i, steps=True, banded=True)
        for i, line in enumerate(recorded.inputs)
    ]
    for title, lines, what in (
        ("States over time", states, "state"),
        ("Inputs over time", inputs, "input"),
    ):
        marks = (Mark(k * T) for k in recorded.agreed)
        yield chart(title, lines, "plant time (s)", what, marks=marks, flags=flags)
    yield (
        '<p class="note">Ticks at the foot: steps on which a key symbol was agreed. Of a long run '
        "a band shows the range in each stretch.</p>"
    )


def _keys(e: Evidence, truth: Truth, said: Sequence[TapOutput]) -> Iterator[str]:
    if not truth.keys:
        yield "<p>No key symbol was agreed.</p>"
        return
    steps = np.fromiter((k for _, k in truth.keys), np.int64, len(truth.keys))
    order = steps.argsort(kind="stable")
    times = steps[order] * e.scenario.plant.period_s

    def grown(right: Iterable[bool]) -> Points:
        series = Series([(0.0, 0.0)])
        total = np.fromiter(right, np.int64, len(steps))[order].cumsum()
        for at, count in zip(times, total, strict=True):
            series.add(float(at), float(count))
        return series.points()

    lines = [Curve("agreed by both ends", grown(True for _ in steps), 6, steps=True)]
    for place, tap in enumerate(said):
        relabelled = score(truth, tap).known.labels
        labels = dict(enumerate(relabelled[0] if relabelled else range(truth.size)))
        right = (labels.get(tap.live.get(at, -1)) == key for at, key in truth.keys.items())
        lines.append(Curve(f"right, {tap.name}", grown(right), place, steps=True))
    yield chart("Key symbols over time", lines, "plant time (s)", "key symbols", floor=0.0)
    yield (
        f'<p class="note">The first guess of each step, up to one relabelling of the symbols for '
        f"the run; blind guessing has one in {e.rules.size} right.</p>"
    )


def _secrecy(e: Evidence, truth: Truth, said: Sequence[TapOutput]) -> Iterator[str]:
    scores = tuple(score(truth, one) for one in said)
    run_score = RunScore(e.folder.name, truth, scores)
    found = report_of([run_score])
    yield f"<p>{escape(found.verdict())}</p>"
    yield _table(HEADINGS, rows(found))
    yield f'<p class="note">{escape(NOTE)}</p>'
    for tap in found.taps:
        for remark in remarks(tap):
            yield f"<p>{escape(tap.name)}: {escape(remark)}.</p>"
    for one in said:
        text = in_short(one.belief.message.decode("utf-8", errors="replace"))
        yield f"<p>{escape(one.name)} guessed:</p><pre>{escape(text)}</pre>"


def _rules(results: Sequence[Result]) -> Iterator[str]:
    yield f"<p>{_counts(results)}</p>"
    body = []
    for r in results:
        first = str(r.findings[0]) if r.findings else r.note
        body.append((r.result, r.rule.name, r.rule.source, r.rule.says, first))
    yield _table(("result", "rule", "source", "says", "first finding"), body)


def _about(e: Evidence) -> Iterator[str]:
    try:
        manifest = json.loads(read_regular(e.folder / MANIFEST))
    except (OSError, ValueError):
        manifest = {}
    told = {name: value for name, value in manifest.items() if name not in (FILES, ITSELF)}
    body = [(str(k), json.dumps(v, ensure_ascii=False)) for k, v in told.items()]
    body.append(("fingerprint", e.rules.fingerprint))
    yield _table(("field", "value"), body)


def _table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(v)}</th>" for v in head)
    lines = "".join(
        f"<tr>{''.join(f'<td>{escape(str(v))}</td>' for v in row)}</tr>" for row in body
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{lines}</tbody></table>"
