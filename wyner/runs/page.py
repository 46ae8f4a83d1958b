"""A run on one page of HTML, judged by the same code as ``wyner check`` and ``wyner score``.

What draws is imported where it draws: matplotlib takes 30 MB, and by then the check has given back
what it took of a long run.
"""

import base64
import json
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import jinja2
import numpy as np

from protocol.text import readable
from runtime.files import write_atomically
from wyner.runs.check import counts, judge
from wyner.runs.check.evidence import Evidence, read_evidence
from wyner.runs.lines import TRANSITION
from wyner.runs.score.attacked import attack_lines, attacked
from wyner.runs.score.counts import mean_cost, truth_of
from wyner.runs.score.report import report
from wyner.runs.score.score import (
    EavesdropperScore,
    RunScore,
    ScoreError,
    TapOutput,
    Truth,
    read_said,
    read_truth,
    score,
)
from wyner.runs.score.summary import in_short
from wyner.runs.score.words import GUESSES, NOTE, SECRECY, guess_rows, remarks, secrecy_rows
from wyner.runs.seal import FILES, ITSELF
from wyner.runs.trace import Trace

PAGE: Final = Path("report.html")

SHOWN: Final = 5
"""Messages that are shown, the last."""

WIDE, SMALL = (7.6, 2.6), (7.6, 2.0)
"""Sizes of figures, in inches."""


class Figure(NamedTuple):
    """A picture for an ``img`` tag, and what it shows for those who cannot see it."""

    alt: str
    base64: str


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
    write_atomically(path, page(read_evidence(run_dir)).encode())
    return path


def page(e: Evidence) -> str:
    """The whole page."""
    results = judge(e)  # first: it takes most room, and gives it back
    attack = attacked(e.run)
    e.run.forget("controller")  # what follows needs the room for matplotlib
    scored = _scored(e)
    flags = [] if attack is None else _flags(attack, e)
    loop = {} if e.plant is None else _loop(e, e.plant, flags)
    secrecy: dict[str, Any] = {"unscored": scored}
    if not isinstance(scored, str):
        secrecy = _secrecy(e, *scored)
    told = {
        "scenario": e.scenario,
        "size": e.rules.size,
        "counts": counts(results),
        "rules": [
            (r.result, r.rule.name, r.rule.source, r.rule.says, [*r.findings, r.note][0])
            for r in results
        ],
        "attack": None if attack is None else _attack(attack),
        "messages": _messages(e),
        "manifest": _manifest(e),
        **loop,
        **secrecy,
        "figures": {**loop.get("figures", {}), **secrecy.get("figures", {})},
    }
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
    )
    return templates.get_template("report.html.j2").render(told)


def _base64(svg: bytes) -> str:
    return base64.b64encode(svg).decode()


def _attack(found: dict[str, Any]) -> dict[str, Any]:
    """What an attack came to."""
    lines = [line.removeprefix("Attack").strip() for line in attack_lines(found)]
    return {"lines": lines, "fields": [(name, json.dumps(v)) for name, v in found.items()]}


def _flags(found: dict[str, Any], e: Evidence) -> list[tuple[float, str]]:
    """Onset and alarm of an attack."""
    period_s, onset, alarm = e.scenario.plant.period_s, found["onset"], found["alarm_k"]
    flags = [(onset * period_s, f"attack, step {onset}")]
    if alarm >= 0:
        flags.append((alarm * period_s, f"alarm, step {alarm}: after {found['delay']}"))
    return flags


def _messages(e: Evidence) -> dict[str, dict[str, Any]]:
    """How many messages were sent and recovered, and the last of them."""
    told: dict[str, dict[str, Any]] = {}
    for title, event in (("Sent", "sent"), ("Recovered", "recovered")):
        payloads = [line.payload for trace in e.ends() for line in trace.told(event)]
        told[title] = {"count": len(payloads), "last": map(readable, payloads[-SHOWN:])}
    return told


def _loop(e: Evidence, plant: Trace, flags: list[tuple[float, str]]) -> dict[str, Any]:
    """The steps since the plant last began: their count, and the figures of states and inputs."""
    from wyner.drawing.run import draw_over_time
    from wyner.drawing.style import svg_of

    begun = np.flatnonzero(
        (plant.rows["k"] == 0) & (np.diff(plant.rows["session"], prepend=-1) != 0)
    )
    rows = plant.rows[begun[-1] if len(begun) else 0 :]
    if not len(rows):
        return {}
    s, period_s = e.scenario, e.scenario.plant.period_s
    seconds, carried = len(rows) * period_s, int((rows["message_symbol"] >= 0).sum())
    read = "x" if e.rules.outputs is None else "y"
    states = {f"{read}{i + 1}": column for i, column in enumerate(rows["x"].T)}
    true = truth_of(rows)
    if true is not None:
        # the truth that a row tells is of its end, and so of the next row's beginning
        before = np.vstack([np.full((1, true.shape[1]), np.nan), true[:-1]])
        states |= {f"x{i + 1} in truth": column for i, column in enumerate(before.T)}
    inputs = {f"u{i + 1}": column for i, column in enumerate(rows["u"].T)}
    time_s, agreed = rows["k"] * period_s, rows["symbol"] >= 0

    def drawn(title: str, lines: Mapping[str, Any], *, held: bool) -> Figure:
        shown = partial(draw_over_time, agreed_s=time_s[agreed], flags=flags, held=held)
        svg = svg_of(WIDE, lambda axes: shown(axes, time_s, lines))
        return Figure(f"{title} over time: {', '.join(lines)}", _base64(svg))

    return {
        "steps": {
            "count": len(rows),
            "missed": int((rows["kind"] != TRANSITION).sum()),
            "seconds": f"{seconds:g}",
            "agreed": int(agreed.sum()),
            "carried": carried,
            "rate": f"{carried * float(np.log2(e.rules.size)) / seconds:.3g}",
            "cost": f"{mean_cost(rows, s.cost_weights):.4g}",
        },
        "figures": {
            "states": drawn("States", states, held=False),
            "inputs": drawn("Inputs", inputs, held=True),
        },
    }


def _scored(e: Evidence) -> tuple[Truth, list[TapOutput]] | str:
    """The truth, and what the eavesdroppers of the run said; or why nobody knows."""
    if e.plant is None:
        return "no plant trace"
    try:
        return read_truth(e.run), read_said(e.run)
    except ScoreError as error:
        return str(error)


def _secrecy(e: Evidence, truth: Truth, said: list[TapOutput]) -> dict[str, Any]:
    """The report of a run's eavesdroppers, with its figures."""
    from wyner.drawing.secrecy import draw_report
    from wyner.drawing.style import svg_of

    scores = tuple(score(truth, one) for one in said)
    found = report([RunScore(e.run.name, truth, scores)])
    names = ", ".join(tap.name for tap in found.taps)
    figures = {
        "secrecy": Figure(
            f"Bits that count as secret, and that are left at most by: {names}",
            _base64(svg_of(SMALL, lambda axes: draw_report(axes, found))),
        )
    }
    if truth.keys:
        figures["symbols"] = _keys(e, truth, zip(said, scores, strict=True))
    return {
        "figures": figures,
        "report": {
            "verdict": found.verdict(),
            "tables": [
                (GUESSES, guess_rows(found.taps)),
                (SECRECY, secrecy_rows(found.taps)),
            ],
            "note": NOTE,
            "remarks": [f"{t.name}: {remark}" for t in found.taps for remark in remarks(t)],
            "guesses": [
                (one.name, in_short(one.belief.message.decode("utf-8", errors="replace")))
                for one in said
            ],
        },
    }


def _keys(
    e: Evidence, truth: Truth, scored: Iterable[tuple[TapOutput, EavesdropperScore]]
) -> Figure:
    """Key symbols over time: those that were agreed, and what each eavesdropper got right."""
    from wyner.drawing.run import draw_keys
    from wyner.drawing.style import svg_of

    steps = np.fromiter((k for _, k in truth.keys), np.int64, len(truth.keys))
    order = steps.argsort(kind="stable")
    right = {}
    for tap, its in scored:
        relabelled = its.known.labels
        labels = dict(enumerate(relabelled[0] if relabelled else range(truth.size)))
        mine = (labels.get(tap.live.get(at, -1)) == key for at, key in truth.keys.items())
        right[f"right, {tap.name}"] = np.fromiter(mine, np.bool_, len(steps))[order]
    agreed_s = steps[order] * e.scenario.plant.period_s
    svg = svg_of(WIDE, lambda axes: draw_keys(axes, agreed_s, right))
    return Figure(f"Key symbols over time: agreed; {', '.join(right)}", _base64(svg))


def _manifest(e: Evidence) -> list[tuple[str, str]]:
    """What the run's manifest says of it, without the files' digests."""
    told = [
        (k, json.dumps(v)) for k, v in (e.run.manifest or {}).items() if k not in (FILES, ITSELF)
    ]
    return [*told, ("fingerprint", e.rules.fingerprint)]
