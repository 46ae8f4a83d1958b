"""Any step of a run by its number: stretches that are opened by a click, and in them each step.

A page has no script. What is shown follows from its address: ``#stretch-200`` shows the stretch
that begins at step 200, ``#step-213`` that step and its stretch; links lead from one to the next.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

import numpy as np
import numpy.typing as npt

from protocol.agreement import INSIDE, predict
from protocol.box_observer import Box
from protocol.convex import corners
from protocol.link.session import Rules
from protocol.scenario import ConvexSet, Scenario
from protocol.vectors import Vector
from wyner.runs.check.records import MissedLine, TracedTransition
from wyner.runs.page.chart import COLOURS, Curve, Door, Flag, Mark, chart, legend, number
from wyner.runs.score.score import TapOutput

Step = TracedTransition | MissedLine

STYLE: Final = """
.stretch, .step { display: none; }
.stretch:target, .stretch:has(:target), .step:target, .first { display: block; }
.walk:has(:target) .first { display: none; }
@supports not selector(:has(*)) { .stretch, .step { display: block; } }
.walk nav { font-size: .8em; line-height: 1.7; } .walk nav a { margin-right: .5em; }
.walk a { color: inherit; } .step { border-left: 3px solid var(--faint); padding-left: .8em; }
.door { fill: transparent; } .door:hover { fill: var(--faint); }
.flag { stroke: var(--ink); stroke-dasharray: 2 2; fill: none; }
.dc { fill: none; stroke-width: 1.6; } .de { fill: none; stroke-dasharray: 3 4; }
"""

WIDTH, HEIGHT, FOOT = 640, 300, 22
AIR: Final = 1.06
"""How much wider a step's frame is than what must be in it."""


def outline(disturbance: ConvexSet, axes: tuple[int, int]) -> list[tuple[float, float]]:
    """The outline of a set of disturbances along two states, ``axes``; of one state a bar."""
    points = corners(*(np.array(a) for a in disturbance.rows()))
    if disturbance.dimension == 1:
        low, high = float(points.min()), float(points.max())
        return [(low, -1.0), (high, -1.0), (high, 1.0), (low, 1.0)]
    points = points[:, list(axes)]
    if disturbance.dimension > 2:
        from scipy.spatial import ConvexHull

        points = points[ConvexHull(points).vertices]
    order = np.arctan2(points[:, 1], points[:, 0]).argsort()
    return [(float(a), float(b)) for a, b in points[order]]


def axes_of(scenario: Scenario, B: npt.NDArray[np.float64]) -> tuple[int, int]:
    """The two states that an input moves furthest, in widths of D_c; of one state -1 for none."""
    points = corners(*(np.array(a) for a in scenario.defender.disturbance.rows()))
    moved = np.abs(B).sum(axis=1) / np.abs(points).max(axis=0)
    order = [int(i) for i in np.argsort(-moved, kind="stable")]
    return (order[0], order[1]) if len(order) > 1 else (order[0], -1)


@dataclass(frozen=True, slots=True)
class Frame:
    """Where a step's picture lies: half its ranges, about the middle of the predictions."""

    across: float
    up: float

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of a point whose distance from the middle is given."""
        return (
            WIDTH / 2 * (1 + x / self.across),
            (HEIGHT - FOOT) / 2 * (1 - y / self.up),
        )


class Walk:
    """The steps of some stretches of a run, as HTML.

    Parameters
    ----------
    scenario : Scenario
    rules : Rules
    stretches : sequence of sequence of Step
    said : sequence of TapOutput
        What the eavesdroppers said; none where it is not known.
    flags : sequence of Flag
        Onset and alarm of an attack, by step.
    """

    def __init__(
        self,
        scenario: Scenario,
        rules: Rules,
        stretches: Sequence[Sequence[Step]],
        said: Sequence[TapOutput] = (),
        flags: Sequence[Flag] = (),
    ) -> None:
        self._s, self._agreement, self._states = scenario, rules.agreement, rules.states
        self._stretches, self._said, self._flags = stretches, said, flags
        self._kept = {step.k for steps in stretches for step in steps}
        self._axes = axes_of(scenario, np.array(rules.agreement.B))
        self._rings = {
            "dc": outline(scenario.defender.disturbance, self._axes),
            "de": outline(scenario.eavesdropper_set, self._axes),
        }
        self._frame = self._widest()

    def _predictions(self, t: TracedTransition) -> list[tuple[float, float]]:
        x = t.x if t.box is None else Box(*t.box).centre
        predictions = (predict(self._agreement.A, self._agreement.B, x, u) for u in t.candidates)
        return [self._seen(c) for c in predictions]

    def _seen(self, x: Vector) -> tuple[float, float]:
        across, up = self._axes
        return x[across], x[up] if up >= 0 else 0.0

    def _widest(self) -> Frame:
        """A frame that holds the sets about every step's predictions."""
        reach = [max(abs(p[i]) for ring in self._rings.values() for p in ring) for i in (0, 1)]
        far = [0.0, 0.0]
        for steps in self._stretches:
            for t in steps:
                if isinstance(t, TracedTransition):
                    predictions = self._predictions(t)
                    middle = _middle(predictions)
                    for i in (0, 1):
                        far[i] = max(far[i], *(abs(c[i] - middle[i]) for c in predictions))
        return Frame(AIR * (reach[0] + far[0]), AIR * (reach[1] + far[1]))

    def doors(self, period_s: float) -> list[Door]:
        """What an overview over plant time leads to: a stretch each."""
        return [
            Door(steps[0].k * period_s, (steps[-1].k + 1) * period_s, f"#stretch-{steps[0].k}",
                 f"steps {steps[0].k} to {steps[-1].k}")
            for steps in self._stretches
        ]  # fmt: skip

    def drawn(self, first: Step | None) -> Iterator[str]:
        """The section: numbers, ``first`` until another step is asked for, and the stretches."""
        yield f'<div class="walk">{self._shapes()}<nav>'
        yield "Steps: " + " ".join(
            f'<a href="#stretch-{steps[0].k}">{steps[0].k} to {steps[-1].k}</a>'
            for steps in self._stretches
        )
        yield "</nav>"
        if first is not None:
            yield f'<article class="first">{self._step(first)}</article>'
        for steps in self._stretches:
            yield from self._stretch(steps)
        yield "</div>"

    def _shapes(self) -> str:
        """The outlines that each step's picture uses, once."""
        paths = []
        for name, ring in self._rings.items():
            origin = self._frame.at(0.0, 0.0)
            moved = (self._frame.at(*p) for p in ring)
            d = "L".join(f"{number(x - origin[0])} {number(y - origin[1])}" for x, y in moved)
            paths.append(f'<path id="{name}" d="M{d}Z"/>')
        return f'<svg width="0" height="0"><defs>{"".join(paths)}</defs></svg>'

    def _stretch(self, steps: Sequence[Step]) -> Iterator[str]:
        first, last = steps[0].k, steps[-1].k
        missed = sum(isinstance(step, MissedLine) for step in steps)
        agreed = [s.k for s in steps if isinstance(s, TracedTransition) and s.symbol >= 0]
        yield (
            f'<section class="stretch" id="stretch-{first}"><h3>Steps {first} to {last}: '
            f"{len(agreed)} key symbols agreed, {missed} missed</h3>"
        )
        n, m = self._states, self._s.m
        x = [Curve(f"x{i + 1}", [(float(s.k), s.x[i]) for s in steps], i) for i in range(n)]
        true = [(s.k + 1.0, s.true_x_next) for s in steps if s.true_x_next is not None]
        if true:
            x += [
                Curve(f"x{i + 1} in truth", [(k, v[i]) for k, v in true], n + i)
                for i in range(self._s.n)
            ]
        u = [
            Curve(f"u{i + 1}", [(float(s.k), s.u[i]) for s in steps if s.u], i, steps=True)
            for i in range(m)
        ]
        doors = [Door(s.k - 0.5, s.k + 0.5, f"#step-{s.k}", f"step {s.k}") for s in steps]
        flags = [flag for flag in self._flags if first <= flag.x <= last]
        for title, lines, what in (("States", x, "state"), ("Inputs", u, "input")):
            name = f"{title}, steps {first} to {last}"
            marks = (Mark(float(k)) for k in agreed)
            yield chart(name, lines, "step", what, marks=marks, doors=doors, flags=flags)
        keyed = set(agreed)
        numbers = (
            f'<a href="#step-{s.k}">{f"<b>{s.k}</b>" if s.k in keyed else s.k}</a>' for s in steps
        )
        yield f"<nav>Each step (bold: a key): {' '.join(numbers)}</nav>"
        for s in steps:
            yield f'<article class="step" id="step-{s.k}">{self._step(s)}</article>'
        yield "</section>"

    def _step(self, t: Step) -> str:
        """One step: its picture, the test in words and numbers, and who got it."""
        before, after = self._link(t.k - 1, "&lsaquo; "), self._link(t.k + 1, " &rsaquo;")
        head = f"<h3>{before} Step {t.k}: {_what(t)} {after}</h3>"
        state = f"<p>Reported state {_vector(t.x)}, then {_vector(t.x_next)}"
        if t.true_x_next is not None:
            state += f"; in truth {_vector(t.true_x_next)}"
        if isinstance(t, MissedLine):
            return f"{head}<p>No offer came in time, so nothing was tested.</p>{state}.</p>"
        return (
            f"{head}{self._picture(t)}<p>{escape(self.sentence(t))}</p>{self._table(t)}{state}.</p>"
        )

    def _link(self, k: int, sign: str) -> str:
        if k not in self._kept:
            return ""
        shown = f"{sign}{k}" if sign.endswith(" ") else f"{k}{sign}"
        return f'<a href="#step-{k}">{shown}</a>'

    def _picture(self, t: TracedTransition) -> str:
        """The agreement picture: each input's prediction in its D_c and D_e, and the next state."""
        predictions = self._predictions(t)
        middle = _middle(predictions)
        parts = []
        for i, c in enumerate(predictions):
            x, y = map(number, self._frame.at(c[0] - middle[0], c[1] - middle[1]))
            stroke = f'stroke="{COLOURS[i % len(COLOURS)]}"'
            parts += [
                f'<use class="{name}" href="#{name}" x="{x}" y="{y}" {stroke}/>'
                for name in ("de", "dc")
            ]
            parts.append(f'<text x="{x}" y="{y}" text-anchor="middle">{i}</text>')
        came = t.x_next if t.box is None else t.true_x_next
        if came is not None:
            at = self._seen(came)
            px, py = self._frame.at(at[0] - middle[0], at[1] - middle[1])
            px, py = min(max(px, 4.0), WIDTH - 4.0), min(max(py, 4.0), HEIGHT - FOOT - 4.0)
            parts.append(f'<circle class="star" cx="{number(px)}" cy="{number(py)}" r="4"/>')
        across, up = self._axes
        low, high = middle[0] - self._frame.across, middle[0] + self._frame.across
        span = f"x{across + 1} from {low:.3g} to {high:.3g}"
        if up >= 0:
            low, high = middle[1] - self._frame.up, middle[1] + self._frame.up
            span += f" across, x{up + 1} from {low:.3g} to {high:.3g} up"
        parts.append(f'<text x="4" y="{HEIGHT - 6}">{span}</text>')
        return (
            f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="Step {t.k}">'
            f"{''.join(parts)}</svg>"
        )

    def sentence(self, t: TracedTransition) -> str:
        """What the agreement test found in a step."""
        if t.symbol < 0:
            gauges = ", ".join(f"{g:.3g}" for g in t.gauges)
            return (
                f"No key symbol: the inputs' gauges are {gauges}; a key needs exactly one of at "
                f"most 1, and all of them {self._in_her_set()}."
            )
        others = ", ".join(f"{g:.3g}" for i, g in enumerate(t.gauges) if i != t.symbol)
        return (
            f"The gauge of input {t.symbol} is {t.gauges[t.symbol]:.3g}, at most 1; of the others "
            f"{others}, above 1 and {self._in_her_set()}. So both ends know that input {t.symbol} "
            "was applied, and an eavesdropper who knows no more than D_e finds every input "
            "possible."
        )

    def _in_her_set(self) -> str:
        if self._s.secrecy.disturbance is not None:
            return "within D_e, which has a shape of its own"
        return f"at most alpha = {self._s.secrecy.alpha:g}"

    def _table(self, t: TracedTransition) -> str:
        """The test in numbers, and what each eavesdropper said of this step."""
        rows: list[tuple[str, str, str]] = []
        for i, (u, gauge) in enumerate(zip(t.candidates, t.gauges, strict=False)):
            where = "in D_c: explains it" if gauge <= INSIDE else f"{gauge:.3g} times D_c"
            applied = " (applied)" if t.coin == i else ""
            rows.append((f"input {i}{applied}", _vector(u), where))
        for one in self._said:
            said = one.live.get((t.session, t.k))
            if said is None:
                told, judged = "said nothing of it", ""
            else:
                told = f"said {said}"
                judged = "no key to find" if t.symbol < 0 else _judged(said == t.symbol)
                later = one.reviewed.get((t.session, t.k), said)
                if later != said:
                    told += f", later {later}"
                    judged += "" if t.symbol < 0 else f", later {_judged(later == t.symbol)}"
            rows.append((escape(one.name), told, judged))
        cells = ("".join(f"<td>{cell}</td>" for cell in row) for row in rows)
        return f"<table><tbody><tr>{'</tr><tr>'.join(cells)}</tr></tbody></table>"


def shapes_legend() -> str:
    """What the outlines of a step's picture are."""
    entry = legend([("D_c about each input's prediction: what both ends allow", 0)])
    dotted = legend([("D_e: what she allows", 2)])
    return f'{entry}{dotted}<p class="note">Dot: where the state came to. Digits: the inputs.</p>'


def _judged(right: bool) -> str:
    return "right" if right else "wrong"


def _middle(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    return sum(p[0] for p in points) / len(points), sum(p[1] for p in points) / len(points)


def _vector(x: Sequence[float]) -> str:
    return f"({', '.join(f'{v:.4g}' for v in x)})"


def _what(t: Step) -> str:
    """What the step was good for, in words."""
    if isinstance(t, MissedLine):
        return "missed"
    if t.symbol >= 0:
        return f"key symbol {t.symbol}"
    if t.message_symbol >= 0:
        return f"message symbol {t.message_symbol}"
    return "no key"
