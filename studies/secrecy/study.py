"""The secrecy study: which eavesdropper is measured under which condition, a row a run."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from protocol.knowledge import Knowledge
from studies.listeners import offline, put_together
from studies.registry import study
from studies.secrecy.runs import Run, simulate
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import named
from tap_service.eavesdroppers.base import Belief, Eavesdropper
from wyner.runs.score.score import TapOutput, score

RUNS: Final = 100
"""Seeds of a condition; of those that take long, a fifth of them."""

HEARD: Final = ("view", "loss", "noise", "quantise", "delay", "model_error", "seed")
"""What of her view a task varies."""

STUDIES: Final = ("ladder", "alpha", "learning")

ALPHAS: Final = tuple(1.5 + 0.5 * i for i in range(14))
"""The paper's."""

COLUMNS: Final = (
    "study condition tap seed steps keys keys_right keys_right_reviewed early_keys "
    "early_right bits bits_right messages messages_exact whole_claimed list_peak "
    "candidates_left solved_k plant_k"
)
EARLY: Final = 200
"""Steps after which a learner is expected to read nearly every separable step."""


def described(view: View) -> str:
    """A view by what the studies vary of it."""
    return "View(" + ", ".join(f"{name}={getattr(view, name)!r}" for name in HEARD) + ")"


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

    @property
    def id(self) -> str:
        """A hash of what is measured and how."""
        text = f"Task(study={self.study!r}, condition={self.condition!r}, tap={self.tap!r}"
        text += f", seed={self.seed!r}, steps={self.steps!r}, alpha={self.alpha!r}"
        text += f", view={described(self.view)}, raw=False)"
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def tasks(runs: int = RUNS) -> Iterator[Task]:
    """The whole study, with ``runs`` seeds, and a fifth of them where a run takes long."""
    few = max(runs // 5, 1)
    for seed in range(runs):
        for tap in ("set-membership", "nearest-centre", "list-decoder", "oracle"):
            yield Task("ladder", "framed, 1000 steps", tap, seed)
    for alpha in ALPHAS:
        for seed in range(few):
            for tap in ("set-membership", "nearest-centre", "list-decoder"):
                yield Task("alpha", f"{alpha:g}", tap, seed, alpha=alpha)
    for error in (0.0, 0.1, 0.3, 0.5):
        for seed in range(runs):
            condition = f"model wrong by {error:.0%}" if error else "from nothing"
            view = View(model_error=error, seed=seed)
            if seed < few:
                yield Task("learning", condition, "learning", seed, steps=2000, view=view)
            early = f"{condition}, {EARLY} steps"
            yield Task("learning", early, "learning", seed, steps=EARLY, view=view)


def heard_by(run: Run, view: View) -> list[Transition]:
    """The transitions that a tap with this view puts together."""
    return put_together(run.messages, view)


def knowledge_for(run: Run, kind: type[Eavesdropper], view: View) -> Knowledge:
    """What an eavesdropper of the study is told."""
    if kind.name == "oracle":
        return run.scenario.oracle_knowledge()
    knowledge = view.knowledge(run.scenario.knowledge(), model=kind.told_model)
    if kind.name == "learning":  # never D_e, also where she is told a wrong model
        nothing = {"disturbance_H": None, "disturbance_h": None, "policy": None}
        return knowledge.model_copy(update=nothing)
    return knowledge


def output_about(tap: Eavesdropper, transitions: Sequence[Transition]) -> TapOutput:
    """Feed an eavesdropper and collect what she says."""
    session = transitions[0].session if transitions else ""
    live = {(t.session, t.k): tap.observe(t).best for t in transitions}
    reviewed = {(session, g.k): g.best for g in (*tap.final_guesses, *tap.review())}
    return TapOutput(tap.name, session, live, reviewed, tap.belief(), tap.message_symbols())


def measure(task: Task) -> dict[str, object]:
    """One row."""
    run = simulate(task.steps, task.seed, alpha=task.alpha)
    kind = named(task.tap)
    knowledge = knowledge_for(run, kind, task.view)
    tap = offline(kind, knowledge)
    said = output_about(tap, heard_by(run, task.view))
    if not said.session:  # she heard nothing at all
        session = next(iter(run.truth.symbols))[0]
        said = TapOutput(tap.name, session, {}, {}, Belief())
    scored = score(run.truth, said)
    first = {at: key for at, key in run.truth.keys.items() if at[1] < EARLY}
    early = score(replace(run.truth, keys=first), said).keys_reviewed
    exact, messages = scored.messages.right, scored.messages.of
    return {
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
        "list_peak": getattr(tap, "decodings", ""),
        "candidates_left": said.belief.candidates_left,
        "solved_k": said.belief.solved_k,
        "plant_k": run.truth.whole[0][0] if run.truth.whole else -1,
    }


def _registered(name: str) -> None:
    def mine() -> Iterator[Task]:
        return (task for task in tasks() if task.study == name)

    def rows(task: Task) -> Iterator[dict[str, object]]:
        yield measure(task)

    study(f"secrecy-{name}", COLUMNS, mine)(rows)


for each in STUDIES:
    _registered(each)
