"""The secrecy study: which eavesdropper is measured under which condition, and a row for each run.

``python -m studies.figures --measure NAME`` adds to a figure's data the rows that they lack,
for one run costs seconds to minutes here: what this code has measured is not measured again.
"""

import csv
import hashlib
import random
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

from protocol.knowledge import Knowledge
from runtime.files import PUBLIC_FILE, replacing
from studies.secrecy.runs import Run, simulate, text_of
from tap_service.capture.channel import View, WiretapChannel
from tap_service.capture.transcript import Transcript, Transition
from tap_service.eavesdroppers import named
from tap_service.eavesdroppers.base import Belief, Eavesdropper
from tap_service.eavesdroppers.list_decoder import ListDecoder
from tap_service.eavesdroppers.text import Text
from wyner.runs.score.score import TapOutput, score
from wyner.sweeps.code import code_version, same_code

RUNS: Final = 100
"""Seeds of a condition with a stated target; the others have a fifth of them."""

HEARD: Final = ("view", "loss", "noise", "quantise", "delay", "model_error", "seed")
"""What of her view a task varies."""

STUDIES: Final = ("ladder", "alpha", "learning", "view")

ALPHAS: Final = tuple(1.5 + 0.5 * i for i in range(14))
"""The paper's."""

COLUMNS: Final = (
    "task", "version", "study", "condition", "tap", "seed", "steps", "keys", "keys_right",
    "keys_right_reviewed", "early_keys", "early_right", "bits", "bits_right", "messages",
    "messages_exact", "whole_claimed", "list_peak", "candidates_left", "solved_k", "plant_k",
)  # fmt: skip
STATED: Final = ("probability", "likeliest_exact", "bits_left", "message_bits", "cpu_s")
"""What is recorded besides of the views, where `text` states how sure she is."""

EARLY: Final = 200
"""Steps after which a learner is expected to read nearly every separable step."""


VIEWS: Final[dict[str, dict[str, Any]]] = {
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
"""What she hears, by name."""

ALL_READ: Final = ("clear", "noise 0.002", "quantised 0.01")
"""Views in which `smoother` has every message of every run: there `text` cannot gain, and is
measured once."""


def described(view: View) -> str:
    """A view by what the studies vary of it."""
    return "View(" + ", ".join(f"{name}={getattr(view, name)!r}" for name in HEARD) + ")"


class Identified(Protocol):
    """What is measured, with an id of its own."""

    @property
    def id(self) -> str:
        """A hash of what is measured and how."""


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
        text = f"Task(study={self.study!r}, condition={self.condition!r}, tap={self.tap!r}"
        text += f", seed={self.seed!r}, steps={self.steps!r}, alpha={self.alpha!r}"
        text += f", view={described(self.view)}, raw={self.raw!r})"
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def version() -> str:
    """Of the code that the rows come from."""
    return code_version("studies.secrecy.study")


def tasks(runs: int = RUNS) -> Iterator[Task]:
    """The whole study, with ``runs`` seeds where a target is stated and a fifth elsewhere."""
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
    for condition, knobs in VIEWS.items():
        for seed in range(few):
            for tap in ("list-decoder", "smoother", "text"):
                if tap == Text.name and seed and condition in ALL_READ:
                    continue
                yield Task("view", condition, tap, seed, view=View(seed=seed, **knobs))


def heard_by(run: Run, view: View) -> list[Transition]:
    """The transitions that a tap with this view puts together."""
    channel, transcript = WiretapChannel(view), Transcript()
    out: list[Transition] = []
    for message in run.messages:
        for _, seen in channel.hear(0, message):
            out += transcript.hear(seen)
    for _, seen in channel.rest():
        out += transcript.hear(seen)
    return out + transcript.flush()


def knowledge_for(run: Run, kind: type[Eavesdropper], view: View) -> Knowledge:
    """What an eavesdropper of the study is told."""
    if kind.name == "oracle":
        return run.scenario.oracle_knowledge()
    knowledge = view.knowledge(run.scenario.knowledge(), model=kind.told_model)
    if kind.name == "learning":  # never D_e, also where she is told a wrong model
        nothing = {"disturbance_H": None, "disturbance_h": None, "policy": None}
        return knowledge.model_copy(update=nothing)
    return knowledge


def offline(kind: type[Eavesdropper], knowledge: Knowledge) -> Eavesdropper:
    """An eavesdropper for a whole capture: `text` reads it once, at the end."""
    return Text(knowledge, live=False) if kind is Text else kind(knowledge)


def output_about(tap: Eavesdropper, transitions: Sequence[Transition]) -> TapOutput:
    """Feed an eavesdropper and collect what she says."""
    session = transitions[0].session if transitions else ""
    live = {(t.session, t.k): tap.observe(t).best for t in transitions}
    reviewed = {(session, g.k): g.best for g in (*tap.final_guesses, *tap.review())}
    return TapOutput(tap.name, session, live, reviewed, tap.belief(), tap.message_symbols())


def columns_of(study: str) -> tuple[str, ...]:
    """The columns of a study's file."""
    return (*COLUMNS, *STATED) if study == "view" else COLUMNS


def stated_by(belief: Belief, payload: bytes, begun: float) -> dict[str, object]:
    """How sure she is of a message, what she says is left of it, and what it took her since."""
    bits = 8 * len(payload)  # no message leaves more
    return {
        "probability": f"{belief.confidence:.6g}",
        "likeliest_exact": int(belief.message == payload),
        "bits_left": "" if belief.bits_left is None else f"{min(belief.bits_left, bits):.3f}",
        "message_bits": bits,
        "cpu_s": f"{time.process_time() - begun:.2f}",
    }


def measure(task: Task) -> dict[str, object]:
    """One row."""
    payloads = None
    if task.raw:
        rng = random.Random(f"raw text {task.seed}")
        payloads = [text_of(rng) for _ in range(3)]
    run = simulate(task.steps, task.seed, alpha=task.alpha, payloads=payloads, raw=task.raw)
    kind = named(task.tap)
    knowledge = knowledge_for(run, kind, task.view)
    begun = time.process_time()
    tap = ListDecoder(knowledge, framed=False) if task.raw else offline(kind, knowledge)
    said = output_about(tap, heard_by(run, task.view))
    if not said.session:  # she heard nothing at all
        session = next(iter(run.truth.symbols))[0]
        said = TapOutput(tap.name, session, {}, {}, Belief())
    scored = score(run.truth, said)
    early = score(run.truth.between(None, EARLY - 1), said).keys_reviewed
    exact, messages = scored.messages.right, scored.messages.of
    if task.raw:
        text = b" ".join(run.payloads)[: len(run.stream) // 8]
        exact, messages = float(said.belief.message == text), 1
    decoding = getattr(tap, "decoding", None)
    row = {
        "task": task.id,
        "version": version(),
        "study": task.study,
        "condition": task.condition,
        "tap": task.tap,
        "seed": task.seed,
        "steps": task.steps,
        "keys": scored.keys.of,
        "keys_right": f"{scored.keys.right:g}",
        "keys_right_reviewed": f"{scored.keys_reviewed.right:g}",
        "early_keys": early.of,
        "early_right": f"{early.right:g}",
        "bits": scored.bits.of,
        "bits_right": scored.bits.right,
        "messages": messages,
        "messages_exact": int(exact),
        "whole_claimed": len(said.belief.whole),
        "list_peak": "" if decoding is None else decoding.peak,
        "candidates_left": said.belief.candidates_left,
        "solved_k": said.belief.solved_k,
        "plant_k": run.truth.whole[0][0] if run.truth.whole else -1,
        **stated_by(said.belief, run.payloads[0], begun),
    }
    return {column: row[column] for column in columns_of(task.study)}


def _rows_in(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """The whole rows of a file; none where it has other columns."""
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.exists() else []
    reader = csv.DictReader([line for line in lines if line.endswith("\n")])
    return list(reader) if reader.fieldnames == list(columns) else []


def append_rows(
    path: Path,
    columns: Sequence[str],
    tasks: Iterable[Identified],
    measure_all: Callable[[list[Any]], Iterable[dict[str, object]]],
    version: str,
) -> None:
    """Add the rows that a file lacks, each as it is made; a run that is there is not made again.

    A task's row that other code made is measured anew: it goes before the first is measured.

    Parameters
    ----------
    path : Path
        A CSV file; a last line that a kill has torn is dropped.
    columns : sequence of str
        ``task`` holds the task's ``id``.
    tasks : iterable
    measure_all : callable
        The rows of a list of tasks, in any order.
    version : str
        Of today's code.
    """
    wanted = {task.id: task for task in tasks}
    kept = [
        row
        for row in _rows_in(path, columns)
        if row["task"] not in wanted or same_code(row["version"], version)
    ]
    done = {row["task"] for row in kept}
    todo = [task for id, task in wanted.items() if id not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        replacing(path, PUBLIC_FILE) as partial,
        partial.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(kept)
    with path.open("a", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        for number, row in enumerate(measure_all(todo), 1):
            writer.writerow(row)
            file.flush()
            print(f"\r{number} of {len(todo)} runs", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)


def measure_study(study: str) -> Callable[[Path], None]:
    """The measurement of one study: it adds the rows that its file lacks, each as it is made."""

    def add_rows(path: Path) -> None:
        mine = (t for t in tasks() if t.study == study)
        append_rows(path, columns_of(study), mine, lambda todo: map(measure, todo), version())

    return add_rows
