"""The page of a run: read from its folder, judged by the same code as ``check`` and ``secrecy``."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Final

import numpy as np

from protocol.agreement import predict
from protocol.convex import corners
from protocol.files import write_atomically
from protocol.runtime.run_folder import MANIFEST, PLANT_TRACE
from protocol.runtime.trace import read_trace
from protocol.scenario import Scenario
from protocol.text import readable
from wyner.run_report.chart import Curve, Mark, chart, plane
from wyner.scoring.report import HEADINGS, rows
from wyner.scoring.report import report as report_of
from wyner.scoring.score import RunScore, Said, ScoreError, Truth, read_said, score, truth_of
from wyner.scoring.summary import in_short
from wyner.verify import check
from wyner.verify.clause import Finding
from wyner.verify.evidence import Evidence, Part, read_evidence
from wyner.verify.records import MissedLine, Told, TracedTransition, Walked
from wyner.verify.seal import FILES, ITSELF

PAGE: Final = Path("report.html")

STYLE: Final = """
:root { color-scheme: light dark; --ink: #1b1b1b; --faint: #8885; --paper: #fff; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e8e8; --paper: #16181c; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 800px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
svg { width: 100%; height: auto; } svg text { font-size: 11px; fill: var(--ink); }
.grid { stroke: var(--faint); stroke-width: .5; fill: none; }
.line { fill: none; stroke-width: 1.5; } .mark { stroke: var(--ink); stroke-width: .7; }
.star { fill: var(--ink); } .sample { width: 28px; height: 8px; }
.legend { display: flex; flex-wrap: wrap; gap: .2em 1.2em; margin: 0; font-size: .85em; }
table { border-collapse: collapse; font-size: .85em; width: 100%; }
td, th { text-align: left; vertical-align: top; padding: .2em .8em .2em 0;
  border-bottom: 1px solid var(--faint); }
pre { white-space: pre-wrap; overflow-wrap: anywhere; border-left: 3px solid var(--faint);
  padding-left: .8em; } .note { font-size: .85em; opacity: .8; }
.FAIL { font-weight: bold; }
"""

Step = TracedTransition | MissedLine


def write_report(run_dir: Path, output: Path | None = None) -> Path:
    """Write a run's page; returns its path.

    Raises
    ------
    FileNotFoundError, ScenarioError, TraceError
        When there is no run, or it cannot be read.
    OSError
        When the page cannot be written.
    """
    path = run_dir / PAGE if output is None else output
    evidence = read_evidence(run_dir)
    write_atomically(path, page(evidence, _said(run_dir)).encode())
    return path


def _said(run_dir: Path) -> list[Said] | str:
    """What the eavesdroppers said, or why that is not known."""
    try:
        return read_said(run_dir)
    except ScoreError as error:
        return str(error)


def page(e: Evidence, said: list[Said] | str) -> str:
    """The whole page."""
    recorded = _Recorded()
    findings = check(e, recorded.take)
    s = e.scenario
    if e.plant is None or isinstance(said, str):
        why = escape(said if isinstance(said, str) else "no plant trace")
        keys = secrecy = [f"<p>Not known: {why}.</p>"]
    else:
        truth = truth_of(read_trace(e.run_dir / PLANT_TRACE))
        keys, secrecy = list(_keys(e, truth, said)), list(_secrecy(e, truth, said))
    parts = [
        f"<h1>{escape(s.name)}</h1><p>{escape(s.description)}</p>",
        *_section("What was sent and what arrived", _message(e, recorded)),
        *_section("States and inputs", _loop(e, recorded)),
        *_section("One agreed step", _one_step(e, recorded)),
        *_section("Keys against taps", keys),
        *_section("The paper's claim and the truth", secrecy),
        *_section("Clauses of the check", _clauses(findings)),
        *_section("The run", _about(e)),
    ]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>wyner: {escape(s.name)}</title><style>{STYLE}</style></head><body>"
        f"{''.join(parts)}</body></html>\n"
    )


def _section(title: str, parts: Iterable[str]) -> Iterator[str]:
    yield f"<section><h2>{escape(title)}</h2>"
    yield from parts
    yield "</section>"


@dataclass
class _Recorded:
    """What the page shows of the traces: the plant's steps of its last life, and the messages."""

    steps: list[TracedTransition | MissedLine] = field(default_factory=list)
    payloads: dict[str, list[bytes]] = field(default_factory=dict)
    born_in: str = ""

    def take(self, part: Part) -> None:
        """Take a part of the run."""
        for item in (*part.plant, *part.controller):
            if isinstance(item, Told) and not item.again:
                self.payloads.setdefault(item.line.event, []).append(item.payload)
        for item in part.plant:
            if isinstance(item, Walked):
                self._step(item.t)
            elif isinstance(item, MissedLine):
                self._step(item)

    def _step(self, step: TracedTransition | MissedLine) -> None:
        if step.k == 0 and step.session != self.born_in:
            self.steps, self.born_in = [], step.session
        self.steps.append(step)


def _message(e: Evidence, recorded: _Recorded) -> Iterator[str]:
    sent, got = recorded.payloads.get("sent", []), recorded.payloads.get("recovered", [])
    steps = recorded.steps
    transitions = [t for t in steps if isinstance(t, TracedTransition)]
    keys = sum(t.symbol >= 0 for t in transitions)
    symbols = sum(t.message_symbol >= 0 for t in transitions)
    seconds = len(steps) * e.scenario.plant.period_s
    for title, payloads in (("Sent", sent), ("Recovered", got)):
        yield f"<p>{title}, {len(payloads)}:</p>"
        yield from (f"<pre>{escape(readable(p))}</pre>" for p in payloads[-5:])
    missed = len(steps) - len(transitions)
    rate = symbols * float(np.log2(e.rules.size)) / seconds if seconds else 0.0
    yield (
        f"<p>{len(steps)} steps ({missed} missed) in {seconds:g} s of plant time; {keys} key "
        f"symbols agreed, {symbols} message symbols carried, {rate:.3g} bits a second. That is "
        "what was sent; what stayed secret is below.</p>"
    )


def _loop(e: Evidence, recorded: _Recorded) -> Iterator[str]:
    steps = recorded.steps
    if not steps:
        yield "<p>The plant left no trace.</p>"
        return
    T = e.scenario.plant.period_s
    x = [(t.k * T, t.x) for t in steps]
    u = [(t.k * T, t.u or ()) for t in steps]
    marks = [Mark(t.k * T) for t in steps if isinstance(t, TracedTransition) and t.symbol >= 0]
    states = [Curve(f"x{i + 1}", [(at, v[i]) for at, v in x], i) for i in range(e.scenario.n)]
    inputs = [
        Curve(f"u{i + 1}", [(at, v[i]) for at, v in u if v], i, steps=True)
        for i in range(e.scenario.m)
    ]
    yield chart("States over time", states, "plant time (s)", "state", marks=marks)
    yield chart("Inputs over time", inputs, "plant time (s)", "input", marks=marks)
    yield '<p class="note">Ticks at the foot: steps on which a key symbol was agreed.</p>'


def _one_step(e: Evidence, recorded: _Recorded) -> Iterator[str]:
    agreed = [t for t in recorded.steps if isinstance(t, TracedTransition) and t.symbol >= 0]
    if not agreed:
        yield "<p>No key symbol was agreed.</p>"
        return
    t, s = agreed[len(agreed) // 2], e.scenario
    others = [g for i, g in enumerate(t.gauges) if i != t.symbol]
    yield (
        f"<p>Step {t.k}: the gauge of candidate {t.symbol} is {t.gauges[t.symbol]:.3g}, at most 1; "
        f"of the others {', '.join(f'{g:.3g}' for g in others)}, above 1 and at most "
        f"alpha = {s.secrecy.alpha:g}. So both ends know that candidate {t.symbol} was applied, "
        f"and an eavesdropper who knows no more than alpha D_c does not.</p>"
    )
    if s.n < 2:
        return
    ring = _outline(s)
    rings = []
    for i, u in enumerate(t.candidates):
        c = predict(e.rules.agreement.A, e.rules.agreement.B, t.x, u)
        for scale, who in ((1.0, "defender"), (s.secrecy.alpha, "eavesdropper")):
            points = [(c[0] + scale * a, c[1] + scale * b) for a, b in ring]
            rings.append((f"reach of candidate {i}, {who}", points, 2 * i + (who != "defender")))
    yield plane("One agreed step", rings, (t.x_next[0], t.x_next[1]), ("x1", "x2"))
    yield '<p class="note">Star: where the state came to.</p>'


def _outline(s: Scenario) -> list[tuple[float, float]]:
    """The outline of D_c in the first two states."""
    points = corners(*(np.array(a) for a in s.defender.disturbance.rows()))[:, :2]
    if s.n > 2:
        from scipy.spatial import ConvexHull

        points = points[ConvexHull(points).vertices]
    order = np.arctan2(points[:, 1], points[:, 0]).argsort()
    return [(float(a), float(b)) for a, b in points[order]]


def _keys(e: Evidence, truth: Truth, said: Sequence[Said]) -> Iterator[str]:
    T = e.scenario.plant.period_s
    steps = sorted(truth.keys, key=lambda at: at[1])
    if not steps:
        yield "<p>No key symbol was agreed.</p>"
        return

    def grown(right: Sequence[bool]) -> list[tuple[float, float]]:
        total = np.cumsum([0, *right]).tolist()
        times = [0.0, *(at[1] * T for at in steps)]
        return list(zip(times, total, strict=True))

    lines = [Curve("agreed by both ends", grown([True] * len(steps)), 6, steps=True)]
    for place, tap in enumerate(said):
        right = [tap.live.get(at) == truth.keys[at] for at in steps]
        lines.append(Curve(f"right, {tap.name}", grown(right), place, steps=True))
    yield chart("Key symbols over time", lines, "plant time (s)", "key symbols", floor=0.0)
    yield (
        f'<p class="note">Her first guess of each step; blind guessing has one in '
        f"{e.rules.size} right.</p>"
    )


def _secrecy(e: Evidence, truth: Truth, said: Sequence[Said]) -> Iterator[str]:
    scores = tuple(score(truth, one) for one in said)
    run_score = RunScore(e.run_dir.name, truth, scores)
    found = report_of([run_score])
    yield f"<p>{escape(found.verdict())}</p>"
    yield _table(HEADINGS, rows(found))
    for one in said:
        text = in_short(one.belief.message.decode("utf-8", errors="replace"))
        yield f"<p>{escape(one.name)} guessed:</p><pre>{escape(text)}</pre>"


def _clauses(findings: Sequence[Finding]) -> Iterator[str]:
    results = [f.result for f in findings]
    yield f"<p>{', '.join(f'{results.count(r)} {r}' for r in ('PASS', 'FAIL', 'SKIP'))}</p>"
    body = []
    for f in findings:
        first = "" if f.tally.first is None else f"; first: {f.tally.first.text}"
        note = f.tally.skipped or f"{f.tally.counted} {f.clause.of}"
        note += f"; {f.tally.note}" if f.tally.note else ""
        body.append((f.result, f.clause.name, f.clause.source, f.clause.says, note + first))
    yield _table(("result", "clause", "source", "says", "looked at"), body)


def _about(e: Evidence) -> Iterator[str]:
    try:
        manifest = json.loads((e.run_dir / MANIFEST).read_text(encoding="utf-8"))
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
