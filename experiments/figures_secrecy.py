"""The secrecy study and its figures.

``python -m experiments.figures_secrecy`` draws the figures of docs/secrecy.md from docs/data;
``python -m experiments.figures_secrecy --study`` measures them first. Rows are additive: a run that
is already in its file is not measured again.
"""

import argparse
import csv
import hashlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from experiments.secrecy_study import Run, simulate, text_of
from protocol.knowledge import Knowledge
from tap_service.eavesdroppers import named
from tap_service.eavesdroppers.interface import Eavesdropper
from tap_service.eavesdroppers.list_decoder import ListDecoder
from tap_service.report import Report, Share
from tap_service.secrecy import Proportion, Said, score
from tap_service.transcript import Transcript, Transition
from tap_service.view import Ear, View, told

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DOCS: Final = Path(__file__).resolve().parent.parent / "docs"
DATA: Final = DOCS / "data"
ALPHAS: Final = tuple(1.5 + 0.5 * i for i in range(14))
"""The paper's."""

COLUMNS: Final = (
    "task", "version", "study", "condition", "tap", "seed", "steps", "keys", "keys_right",
    "keys_right_reviewed", "early_keys", "early_right", "bits", "bits_right", "messages",
    "messages_exact", "whole_claimed", "list_peak", "candidates_left", "solved_k", "plant_k",
)  # fmt: skip
EARLY: Final = 200
"""Steps after which a learner is expected to read nearly every separable step."""


@dataclass(frozen=True, slots=True)
class Task:
    """One run of one eavesdropper under one condition."""

    study: str
    condition: str
    tap: str
    seed: int
    steps: int = 1000
    alpha: float = 8.0
    view: View = field(default_factory=View)
    raw: bool = False

    @property
    def id(self) -> str:
        """A hash of what is measured and how."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:12]


def tasks(runs: int) -> Iterator[Task]:
    """The whole study, with ``runs`` seeds where the targets ask for a hundred."""
    few = max(runs // 5, 1)
    for seed in range(runs):
        for tap in ("set-membership", "nearest-centre", "list-decoder", "oracle"):
            yield Task("ladder", "framed, 1000 steps", tap, seed)
        yield Task("ladder", "raw English, 1000 steps", "list-decoder", seed, raw=True)
    for alpha in ALPHAS:
        for seed in range(few):
            for tap in ("set-membership", "nearest-centre", "list-decoder"):
                yield Task("alpha", f"{alpha:g}", tap, seed, alpha=alpha)
    for error in (0.0, 0.1, 0.3, 0.5):
        for seed in range(runs):
            condition = f"model wrong by {error:.0%}" if error else "from nothing"
            view = View(model_error=error, seed=seed)
            yield Task("learning", condition, "learning", seed, steps=2000, view=view)
            early = f"{condition}, {EARLY} steps"
            yield Task("learning", early, "learning", seed, steps=EARLY, view=view)
    views: dict[str, dict[str, Any]] = {
        "clear": {},
        "loss 10 %": {"loss": 0.1},
        "loss 30 %": {"loss": 0.3},
        "loss 50 %": {"loss": 0.5},
        "measurements only": {"view": "measurements"},
        "offers only": {"view": "offers"},
        "noise 0.002": {"noise": 0.002},
        "noise 0.01": {"noise": 0.01},
        "noise 0.05": {"noise": 0.05},
        "quantised 0.01": {"quantise": 0.01},
        "quantised 0.1": {"quantise": 0.1},
    }
    for condition, knobs in views.items():
        for seed in range(few):
            for tap in ("list-decoder", "smoother"):
                yield Task("view", condition, tap, seed, view=View(seed=seed, **knobs))


def heard_by(run: Run, view: View) -> list[Transition]:
    """The transitions that a tap with this view puts together."""
    ear, transcript = Ear(view), Transcript()
    out: list[Transition] = []
    for message in run.messages:
        for _, seen in ear.hear(0, message):
            out += transcript.hear(seen)
    for _, seen in ear.rest():
        out += transcript.hear(seen)
    return out + transcript.flush()


def knowledge_for(run: Run, kind: type[Eavesdropper], view: View) -> Knowledge:
    """What an eavesdropper of the study is told."""
    if kind.name == "oracle":
        return run.scenario.oracle_knowledge()
    if kind.name == "learning":  # never D_e, also where she is told a wrong model
        nothing = {"disturbance_H": None, "disturbance_h": None, "policy": None}
        return told(run.scenario.knowledge(), kind, view).model_copy(update=nothing)
    return told(run.scenario.knowledge(), kind, view)


def said_about(tap: Eavesdropper, transitions: Sequence[Transition]) -> Said:
    """Feed an eavesdropper and collect what she says."""
    session = transitions[0].session if transitions else ""
    live = {(t.session, t.k): tap.observe(t).best for t in transitions}
    reviewed = {(session, g.k): g.best for g in tap.review()}
    belief = tap.belief()
    return Said(
        name=tap.name,
        live=live,
        reviewed=reviewed,
        session=session,
        symbols=dict(belief.symbols),
        message=belief.message,
        whole=belief.whole,
        candidates_left=belief.candidates_left,
        solved_k=belief.solved_k,
        confidence=belief.confidence,
    )


def measure(task: Task) -> dict[str, object]:
    """One row."""
    import random

    payloads = None
    if task.raw:
        rng = random.Random(f"raw text {task.seed}")
        payloads = [text_of(rng) for _ in range(3)]
    run = simulate(task.steps, task.seed, alpha=task.alpha, payloads=payloads, raw=task.raw)
    kind = named(task.tap)
    knowledge = knowledge_for(run, kind, task.view)
    tap = ListDecoder(knowledge, framed=False) if task.raw else kind(knowledge)
    said = said_about(tap, heard_by(run, task.view))
    if not said.session:  # she heard nothing at all
        said = Said(tap.name, {}, {}, next(iter(run.truth.symbols))[0], {}, b"", (), 0, -1, 0.0)
    scored = score(run.truth, said)
    early = {at: key for at, key in run.truth.keys.items() if at[1] < EARLY}
    guesses = {**said.live, **said.reviewed}
    exact, messages = scored.messages.right, scored.messages.of
    if task.raw:
        text = b" ".join(run.payloads)[: len(run.stream) // 8]
        exact, messages = float(said.message == text), 1
    beam = getattr(tap, "beam", None)
    return {
        "task": task.id,
        "version": version("wyner"),
        "study": task.study,
        "condition": task.condition,
        "tap": task.tap,
        "seed": task.seed,
        "steps": task.steps,
        "keys": scored.keys.of,
        "keys_right": int(scored.keys.right),
        "keys_right_reviewed": int(scored.keys_reviewed.right),
        "early_keys": len(early),
        "early_right": sum(guesses.get(at) == key for at, key in early.items()),
        "bits": scored.bits.of,
        "bits_right": scored.bits.right,
        "messages": messages,
        "messages_exact": int(exact),
        "whole_claimed": len(said.whole),
        "list_peak": "" if beam is None else beam.peak,
        "candidates_left": said.candidates_left,
        "solved_k": said.solved_k,
        "plant_k": run.truth.whole[0][0] if run.truth.whole else -1,
    }


def path_of(study: str) -> Path:
    """The data of one study."""
    return DATA / f"secrecy-{study}.csv"


def read_rows(study: str) -> list[dict[str, str]]:
    """What was measured of one study."""
    path = path_of(study)
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def run_study(runs: int, only: Sequence[str] = ()) -> None:
    """Measure what is missing; each row is on disk before the next is begun."""
    DATA.mkdir(parents=True, exist_ok=True)
    done = {
        row["task"] for study in ("ladder", "alpha", "learning", "view") for row in read_rows(study)
    }
    todo = [t for t in tasks(runs) if t.id not in done and (not only or t.study in only)]
    for number, task in enumerate(todo, 1):
        path = path_of(task.study)
        fresh = not path.exists()
        row = measure(task)
        with path.open("a", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            if fresh:
                writer.writeheader()
            writer.writerow(row)
        print(f"\r{number} of {len(todo)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)


# --- tables --------------------------------------------------------------------------------------


def share_of(rows: Sequence[dict[str, str]], right: str, of: str) -> Share:
    """A share over runs with its interval."""
    return Share.over([Proportion(float(r[right]), int(r[of])) for r in rows])


def exact_of(rows: Sequence[dict[str, str]]) -> Share:
    """Share of runs whose message was had whole and exact, of those in which the plant had it."""
    return Share.wilson([Proportion(float(r["messages_exact"]), int(r["messages"])) for r in rows])


def table(study: str) -> list[tuple[str, ...]]:
    """One line a condition and eavesdropper."""
    rows = read_rows(study)
    groups = dict.fromkeys((r["condition"], r["tap"]) for r in rows)
    lines: list[tuple[str, ...]] = [
        ("condition", "tap", "runs", "key symbols", "first 200", "bits", "messages", "list")
    ]
    for condition, tap in groups:
        mine = [r for r in rows if (r["condition"], r["tap"]) == (condition, tap)]
        peaks = sorted(int(r["list_peak"]) for r in mine if r["list_peak"])
        lines.append(
            (
                condition,
                tap,
                str(len(mine)),
                share_of(mine, "keys_right_reviewed", "keys").text(),
                share_of(mine, "early_right", "early_keys").text(),
                share_of(mine, "bits_right", "bits").text(),
                exact_of(mine).text(),
                str(peaks[len(peaks) // 2]) if peaks else "-",
            )
        )
    return lines


def in_markdown(study: str) -> str:
    """The table of a study as docs/secrecy.md holds it."""
    head, *lines = ("| " + " | ".join(line) + " |" for line in table(study))
    return "\n".join([head, "|---" * head.count(" | ") + "|---|", *lines])


def write_tables() -> None:
    """Put the tables between their marks in docs/secrecy.md."""
    path = DOCS / "secrecy.md"
    text = path.read_text(encoding="utf-8")
    for study in TABLES:
        begin, end = f"<!-- begin {study} -->\n", f"<!-- end {study} -->"
        before, _, rest = text.partition(begin)
        _, mark, after = rest.partition(end)
        if mark:
            text = f"{before}{begin}{in_markdown(study)}\n{end}{after}"
    path.write_text(text, encoding="utf-8")


# --- figures -------------------------------------------------------------------------------------


def _plot(width: float = 7.0, height: float = 3.6) -> tuple[Any, "Axes"]:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    mpl.rcParams.update(
        {"svg.hashsalt": "wyner", "font.size": 9, "axes.spines.top": False,
         "axes.spines.right": False}
    )  # fmt: skip
    return pyplot.subplots(figsize=(width, height), layout="constrained")


def _save(figure: Any, path: Path) -> None:
    from matplotlib import pyplot

    metadata = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    figure.savefig(path, metadata=metadata, dpi=150)
    pyplot.close(figure)


MARKS: Final = {
    "set-membership": ("o", "C7"),
    "nearest-centre": ("s", "C0"),
    "list-decoder": ("^", "C3"),
    "learning": ("D", "C2"),
    "smoother": ("v", "C4"),
    "oracle": ("*", "k"),
}
"""Marker and colour: told apart without colour too."""


def _series(ax: "Axes", x: Sequence[float], shares: Sequence[Share], tap: str) -> None:
    marker, color = MARKS[tap]
    values = [s.value or 0.0 for s in shares]
    low = [v - s.low for v, s in zip(values, shares, strict=True)]
    high = [s.high - v for v, s in zip(values, shares, strict=True)]
    errors = [[max(e, 0.0) for e in side] for side in (low, high)]
    ax.errorbar(x, values, yerr=errors, marker=marker, color=color, capsize=2, ms=5, label=tap)


def draw_alpha(path: Path) -> None:
    """Key symbols right against alpha, per eavesdropper: claimed secrecy beside true."""
    rows = read_rows("alpha")
    figure, ax = _plot()
    for tap in ("set-membership", "nearest-centre"):
        shares = [
            share_of(
                [r for r in rows if r["tap"] == tap and float(r["condition"]) == a],
                "keys_right_reviewed",
                "keys",
            )
            for a in ALPHAS
        ]
        _series(ax, ALPHAS, shares, tap)
    ax.axhline(0.5, color="0.6", lw=0.8, ls=":")
    ax.set(
        xlabel=r"$\alpha$ ($D_e = \alpha D_c$)",
        ylabel="agreed key symbols guessed right",
        ylim=(0.4, 1.03),
    )
    ax.legend(frameon=False, loc="center right")
    _save(figure, path)


def draw_alpha_bits(path: Path) -> None:
    """Message symbols right against alpha: one threshold against all of them."""
    rows = read_rows("alpha")
    figure, ax = _plot()
    for tap in ("set-membership", "nearest-centre", "list-decoder"):
        shares = [
            share_of(
                [r for r in rows if r["tap"] == tap and float(r["condition"]) == a],
                "bits_right",
                "bits",
            )
            for a in ALPHAS
        ]
        _series(ax, ALPHAS, shares, tap)
    ax.set(xlabel=r"$\alpha$", ylabel="message bits right, 1000 steps", ylim=(0.4, 1.03))
    ax.legend(frameon=False, loc="lower right")
    _save(figure, path)


def draw_views(path: Path) -> None:
    """Message bits right under an imperfect view: list decoder and smoother."""
    rows = read_rows("view")
    conditions = list(dict.fromkeys(r["condition"] for r in rows))
    figure, ax = _plot(7.5, 3.8)
    for offset, tap in ((-0.15, "list-decoder"), (0.15, "smoother")):
        shares = [
            share_of(
                [r for r in rows if r["tap"] == tap and r["condition"] == c], "bits_right", "bits"
            )
            for c in conditions
        ]
        marker, color = MARKS[tap]
        values = [s.value or 0.0 for s in shares]
        places = [i + offset for i in range(len(conditions))]
        errors = [
            [max(v - s.low, 0.0) for v, s in zip(values, shares, strict=True)],
            [max(s.high - v, 0.0) for v, s in zip(values, shares, strict=True)],
        ]
        hatch = "//" if tap == "smoother" else ""
        ax.bar(places, values, 0.28, yerr=errors, color=color, alpha=0.75, hatch=hatch,
               capsize=2, label=tap)  # fmt: skip
        del marker
    ax.axhline(0.5, color="0.3", lw=0.8, ls=":")
    ax.set_xticks(range(len(conditions)), conditions, rotation=35, ha="right")
    ax.set(ylabel="message bits right", ylim=(0.4, 1.03))
    ax.legend(frameon=False, loc="upper center")
    _save(figure, path)


def draw_learning(path: Path) -> None:
    """When the learner first had the whole message, beside when the plant had it."""
    rows = [r for r in read_rows("learning") if int(r["plant_k"]) >= 0]
    figure, ax = _plot()
    conditions = list(dict.fromkeys(r["condition"] for r in rows))
    grid = list(range(0, 2001, 10))
    for style, condition in zip(("-", "--", "-.", ":"), conditions, strict=False):
        mine = [r for r in rows if r["condition"] == condition]
        solved = [int(r["solved_k"]) for r in mine if int(r["solved_k"]) >= 0]
        ax.plot(grid, [sum(s <= k for s in solved) / len(mine) for k in grid], style,
                color="C2", label=f"learning, {condition}")  # fmt: skip
    first = [r for r in rows if r["condition"] == conditions[0]] if conditions else []
    if first:
        had = [int(r["plant_k"]) for r in first]
        ax.plot(grid, [sum(s <= k for s in had) / len(had) for k in grid], color="k", lw=0.9,
                label="the plant itself")  # fmt: skip
    ax.set(xlabel="step k", ylabel="runs with the whole message", ylim=(0, 1.03))
    ax.legend(frameon=False, loc="upper left")
    _save(figure, path)


def draw_report(report: Report, path: Path) -> None:
    """Claimed against true: the bits the scheme counts, and what each eavesdropper leaves."""
    figure, ax = _plot()
    names = ["claimed", *(t.name for t in report.taps)]
    values = [report.claimed_bits, *(t.left_bits or 0.0 for t in report.taps)]
    bars = ax.barh(names, values, color=["0.5", *("C3" for _ in report.taps)])
    bars[0].set_hatch("//")
    ax.bar_label(bars, [f" {value:.1f}" for value in values])
    ax.invert_yaxis()
    ax.set(xlabel="secret bits", xlim=(0, 1.15 * max([*values, 1.0])))
    ax.set_title(report.verdict(), fontsize=9, loc="left")
    _save(figure, path)


TABLES: Final = ("ladder", "learning", "view")
"""Studies whose table docs/secrecy.md shows; that of alpha is a figure."""

FIGURES: Final = {
    "secrecy-alpha": draw_alpha,
    "secrecy-alpha-bits": draw_alpha_bits,
    "secrecy-learning": draw_learning,
    "secrecy-view": draw_views,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Measure if asked, then draw the figures and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--study", action="store_true", help="measure what is missing first")
    parser.add_argument("--runs", type=int, default=100, help="seeds (default 100)")
    parser.add_argument("--only", action="append", default=[], help="one study of it (repeatable)")
    args = parser.parse_args(argv)
    if args.study:
        run_study(args.runs, args.only)
    for name, draw in FIGURES.items():
        for suffix in (".svg", ".png"):
            draw(DOCS / f"{name}{suffix}")
    write_tables()
    return 0


if __name__ == "__main__":
    sys.exit(main())
