"""What keys cost the loop: its speed with and without them, and offers while a block is distilled.

Rounds alternate in one run, because machines are noisy: the scenario `keys` without its table
``keys`` and as it is; in lock-step, for the speed, then at a pace, for the offers. What a keyed
coin costs besides is less than rounds differ by, and is measured by turns. The tap hears everything
here, so that each message's time is on record. An offer falls *into a distillation* when the
controller's trace shows it between the transition that closed a block and the line that the block
is stored; the plant distils at the same time. How much later such an offer comes is the mean over
rounds of the difference of two medians, with an interval: a delay longer than the interval is wide
would have been seen.
"""

import json
import statistics
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.in_turn import in_turn
from benchmarks.loop import PATIENCE_S, STEP_LIMIT_S, WARM_UP, running
from protocol.messages import Measurement, Offer
from protocol.secret.blocks import schedule_of
from protocol.secret.bound import Assumption
from runtime.errors import Failure
from runtime.run_folder import CAPTURE, CONTROLLER_TRACE
from wyner.fit.toml import as_toml

SCENARIO: Final = Path(__file__).resolve().parent.parent / "runtime" / "scenarios" / "keys.toml"
CASES: Final = ("off", "on", "distilling")
LOOPS: Final = ("off", "on")
"""Without keys, and with them."""

COIN: Final = "coin"
"""The loop with keys whose coin is keyed besides."""

TURN_S: Final = 1.0

PACES: Final = ("fast", "x50")
"""Lock-step, where the cores are full, and 500 steps a second, where they are not."""


@dataclass
class KeyRound:
    """One round: its speed, and how long after its measurement each offer came, by case."""

    steps_per_second: float
    offers_us: dict[str, list[float]]


def _variant(folder: Path, *, loop: str) -> Path:
    tables = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    tables["tap"]["loss"] = 0.0
    if loop == "off":
        del tables["keys"]
    if loop == COIN:
        tables["defence"] = {"kind": "keyed-coin"}
    path = folder / "scenario.toml"
    path.write_text(as_toml(tables), encoding="utf-8")
    return path


def in_distillation(lines: Iterable[dict[str, Any]], last_of: Callable[[int], int]) -> set[int]:
    """The steps whose offers were made while the controller distilled a block.

    Parameters
    ----------
    lines : iterable of dict
        The controller's trace.
    last_of : callable
        The last transition of a block.
    """
    k_of: dict[int, int] = {}
    newest = -1
    found: set[int] = set()
    for line in lines:
        if line["event"] == "transition":
            newest = k_of[line["j"]] = line["k"]
        elif line["event"] == "block":
            # the offer after the transition counted is for the step after it
            found.update(range(k_of[last_of(line["number"])] + 1, newest + 2))
    return found


def key_round(loop: str, *, steps: int, pace: str) -> KeyRound:
    """Run the services of one of `LOOPS` for ``steps`` steps.

    Raises
    ------
    runtime.errors.Failure
        When a service fails, or the capture does not show the steps.
    """
    with tempfile.TemporaryDirectory(prefix="wyner-bench-") as name:
        folder = Path(name)
        with running(_variant(folder, loop=loop), folder, steps, pace) as services:
            services["plant"].wait(PATIENCE_S + STEP_LIMIT_S * steps)
        seen: dict[str, dict[int, int]] = {Measurement.topic: {}, Offer.topic: {}}
        for line in (folder / CAPTURE).read_bytes().splitlines()[1:]:
            record = json.loads(line)
            if record["event"] == "field":
                seen[record["topic"]].setdefault(record["message"]["k"], record["t_ns"])
        trace = (json.loads(x) for x in (folder / CONTROLLER_TRACE).read_bytes().splitlines())
        schedule = schedule_of(Assumption(0.3))
        assert schedule is not None
        distilling = in_distillation(trace, lambda b: schedule.begins(b + 1) - 1)
    measured, offered = seen[Measurement.topic], seen[Offer.topic]
    begin = min((k for k in measured if k >= WARM_UP * steps), default=steps)
    end = max(measured, default=0)
    if end <= begin:
        raise Failure(f"the tap's capture shows {len(measured)} of {steps} steps")
    offers: dict[str, list[float]] = {case: [] for case in CASES}
    for k in range(begin, end):
        if k in measured and k in offered:
            case = "off" if loop == "off" else "distilling" if k in distilling else "on"
            offers[case].append((offered[k] - measured[k]) / 1e3)
    seconds = (measured[end] - measured[begin]) / 1e9
    return KeyRound((end - begin) / seconds, offers)


ENOUGH: Final = 20
"""Offers of each case without which a round says nothing of a delay."""

DRAWS: Final = 2000


def delay(rounds: Sequence[KeyRound]) -> dict[str, float] | None:
    """How much later offers come while a block is distilled, us; None where no round tells.

    Parameters
    ----------
    rounds : sequence of KeyRound
        At one pace.

    Returns
    -------
    dict
        ``mean`` over rounds of the difference of the two medians; ``low`` and ``high``, its 95 %
        interval by a bootstrap that draws rounds, and offers within each; ``rounds``, how many.
    """
    both = [
        (np.array(r.offers_us["distilling"]), np.array(r.offers_us["on"]))
        for r in rounds
        if min(len(r.offers_us["distilling"]), len(r.offers_us["on"])) >= ENOUGH
    ]
    if not both:
        return None
    generator = np.random.default_rng(1)

    def median(values: np.ndarray) -> float:
        return float(np.median(generator.choice(values, len(values))))

    drawn = [
        statistics.mean(median(a) - median(b) for a, b in (both[i] for i in chosen))
        for chosen in generator.integers(0, len(both), (DRAWS, len(both)))
    ]
    low, high = np.quantile(drawn, (0.025, 0.975))
    mean = statistics.mean(float(np.median(a) - np.median(b)) for a, b in both)
    return {"mean": mean, "low": float(low), "high": float(high), "rounds": len(both)}


QUANTILES: Final = {"p50": 0.5, "p90": 0.9, "p99": 0.99}


def _figures(values: Sequence[float]) -> dict[str, float]:
    ordered = sorted(values)
    if not ordered:
        return {"offers": 0}
    at = {name: ordered[int(q * (len(ordered) - 1))] for name, q in QUANTILES.items()}
    return {"offers": len(ordered), **at, "longest": ordered[-1]}


def measure(
    *,
    rounds: int = 3,
    steps: int = 3000,
    blocks: int = 10,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Measure the loop without keys, with them, and with a keyed coin.

    Parameters
    ----------
    rounds : int
        Of a run of each of `LOOPS` in lock-step, then of each at a pace.
    steps : int
        Steps of each run.
    blocks : int
        Of turns with keys and with a keyed coin, see :func:`in_turn`.
    progress : callable, optional
        Told in a line how each round went.

    Returns
    -------
    dict
        ``steps_per_second`` (of `LOOPS`: medians over rounds in lock-step), ``ratio`` (with keys to
        without), ``coin`` (with a keyed coin to keys alone: :func:`in_turn`), ``rounds`` (each
        round's figures), ``offers_us`` (for each of `PACES` and `CASES`:
        how many, quantiles, ``longest``), ``delay_us`` (for each of `PACES` what :func:`delay`
        says), ``steps``.

    Raises
    ------
    runtime.errors.Failure
        When a process fails.
    """
    say = progress or (lambda _line: None)
    runs: dict[str, list[dict[str, KeyRound]]] = {pace: [] for pace in PACES}
    for i in range(rounds):
        for pace in PACES:
            order = LOOPS if i % 2 == 0 else LOOPS[::-1]
            runs[pace].append({loop: key_round(loop, steps=steps, pace=pace) for loop in order})
        told = runs["fast"][-1]
        say(
            f"round {i + 1} of {rounds}: {told['off'].steps_per_second:.0f} steps/s without keys, "
            f"{told['on'].steps_per_second:.0f} with"
        )
    speed = [{loop: round_[loop].steps_per_second for loop in LOOPS} for round_ in runs["fast"]]
    medians = {loop: statistics.median(one[loop] for one in speed) for loop in LOOPS}
    return {
        "steps_per_second": medians,
        "ratio": medians["on"] / medians["off"],
        "coin": in_turn(
            {loop: partial(_variant, loop=loop) for loop in ("on", COIN)},
            blocks=blocks,
            seconds=TURN_S,
            progress=progress,
        ),
        "rounds": speed,
        "offers_us": {
            pace: {
                case: _figures(
                    [us for o in of for loop in ("off", "on") for us in o[loop].offers_us[case]]
                )
                for case in CASES
            }
            for pace, of in runs.items()
        },
        "delay_us": {pace: delay([one["on"] for one in of]) for pace, of in runs.items()},
        "steps": steps,
    }


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` as a table for people."""
    speed, coin = result["steps_per_second"], result["coin"]
    words = dict(zip(CASES, ("no keys", "keys", "keys, a block is distilled"), strict=True))
    columns = (*QUANTILES, "longest")
    lines = [
        f"scenario keys, {len(result['rounds'])} alternating rounds of {result['steps']} steps, "
        "tap attached",
        "",
        f"lock-step, steps a second: {speed['off']:.0f} without keys, {speed['on']:.0f} with them "
        f"({result['ratio']:.2f}); round by round "
        + ", ".join("/".join(f"{r[loop]:.0f}" for loop in LOOPS) for r in result["rounds"]),
        f"a keyed coin besides, by turns of {TURN_S:g} s: {coin['ratio']:.3f} of keys alone "
        f"[{coin['low']:.3f}, {coin['high']:.3f}]",
        "",
        f"{'an offer after its measurement, us':<38}{'offers':>8}"
        + "".join(f"{name:>9}" for name in columns),
    ]
    for pace, cases in result["offers_us"].items():
        for case, figures in cases.items():
            shown = "".join(
                f"{'-' if name not in figures else format(figures[name], '.0f'):>9}"
                for name in columns
            )
            lines.append(f"{f'{pace}: {words[case]}':<38}{figures['offers']:>8}{shown}")
    lines.append("")
    for pace, found in result["delay_us"].items():
        told = "not seen: too few offers fell into a distillation"
        if found is not None:
            told = (
                f"{found['mean']:+.0f} us ({found['low']:+.0f} to {found['high']:+.0f}, 95 %, "
                f"{found['rounds']} rounds)"
            )
        lines.append(f"{pace}: an offer while a block is distilled, later by: {told}")
    return "\n".join(lines)
