"""What the strongest tap costs a live loop: processor time a step, and when she had the message.

She listens as she does behind the mirror, step by step, to runs of `packed` of which she misses a
part. A loop of ten steps a second leaves a core 100 ms for each: that is the bound. Processor time
is counted, so that a busy machine says the same.
"""

import time
from collections.abc import Callable
from typing import Any, Final

MOST_MS: Final = 100.0
"""Of a core for a step, on the mean over a run: the period of a loop of ten steps a second."""

SEEDS: Final = (4, 5, 6, 7, 8)
STEPS: Final = 320
LOSSES: Final = (0.1, 0.3, 0.5)


def measure(progress: Callable[[str], None] | None = None) -> dict[str, Any]:
    """Follow each run; see :data:`MOST_MS`."""
    from studies.secrecy.runs import simulate
    from studies.secrecy.sentences import SENTENCES
    from studies.secrecy.study import heard_by
    from tap_service.capture.channel import View
    from tap_service.eavesdroppers.text import Text

    rows: list[dict[str, Any]] = []
    for loss in LOSSES:
        for seed in SEEDS:
            payload = SENTENCES[seed].encode("ascii")
            run = simulate(STEPS, seed, name="packed", payloads=[payload])
            view = View(seed=seed, loss=loss)
            tap = Text(view.knowledge(run.scenario.knowledge()))
            begun = time.process_time()
            for transition in heard_by(run, view):
                tap.observe(transition)
            spent = time.process_time() - begun
            had = tap.belief()
            rows.append(
                {
                    "loss": loss,
                    "seed": seed,
                    "ms_a_step": 1000 * spent / STEPS,
                    "plant_had_it_at": run.truth.whole[0][0],
                    "she_had_it_at": had.solved_k if payload in had.whole else None,
                }
            )
            if progress is not None:
                cost = rows[-1]["ms_a_step"]
                progress(f"{loss:.0%} missed, seed {seed}: {cost:.1f} ms a step")
    return {
        "rows": rows,
        "steps": STEPS,
        "most_ms": MOST_MS,
        "held": max(row["ms_a_step"] for row in rows) <= MOST_MS,
    }


def render(result: dict[str, Any]) -> str:
    """The figures as text."""
    lines = [
        f"{'missed':>8} {'seed':>5} {'ms a step':>10}  {'plant had it':>13} {'she had it':>11}"
    ]
    for row in result["rows"]:
        hers = "not" if row["she_had_it_at"] is None else row["she_had_it_at"]
        lines.append(
            f"{row['loss']:>8.0%} {row['seed']:>5} {row['ms_a_step']:>10.1f}  "
            f"{row['plant_had_it_at']:>13} {hers:>11}"
        )
    held = "held" if result["held"] else "NOT HELD"
    lines.append(f"processor time of one core, {result['steps']} steps a run; at most "
                 f"{result['most_ms']:g} ms for a loop of ten steps a second: {held}")  # fmt: skip
    return "\n".join(lines)
