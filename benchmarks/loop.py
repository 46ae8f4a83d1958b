"""How fast the loop runs in lock-step, beside bare Zenoh round trips of the same payloads.

Rounds alternate in one run, because machines are noisy: one round of the three real services
(controller, plant, and the tap attached) on loopback, then one of two bare processes that pass a
recorded Measurement and a recorded Offer back and forth over the same transport, with a third
process subscribed to both. What a step costs beside the transport is timed part by part in one
process, on the same scenario.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmarks.bare import bare_round
from protocol.messages import Measurement, Offer
from runtime.addresses import free_endpoints
from runtime.errors import Failure
from runtime.run_folder import CAPTURE

TARGET_RATIO: Final = 0.65
"""Control steps a second should be at least this part of the bare round trips a second."""

SCENARIO: Final = (
    Path(__file__).resolve().parent.parent / "runtime" / "scenarios" / "sustained.toml"
)
EAVESDROPPERS: Final = "set-membership,nearest-centre"
MESSAGE: Final = "The quick brown fox jumps over the lazy dog, and nobody else may know."

WARM_UP: Final = 0.1
"""Part of a round that is not counted."""

PATIENCE_S: Final = 30.0
STEP_LIMIT_S: Final = 0.02
"""A round may take so long a step before it is given up."""

SERVICES: Final = ("controller", "plant", "tap")


# --- the three services --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class LoopRound:
    """One round of the services: speed, the messages it carried, and what the processes took."""

    steps_per_second: float
    measurement: bytes
    offer: bytes
    startup_s: dict[str, float]
    rss_mib: dict[str, float]


def _commands(scenario: Path, folder: Path, steps: int, pace: str) -> dict[str, list[str]]:
    plant, controller, plant_management, controller_management, adversary = free_endpoints(5)
    common = [f"--scenario={scenario}", f"--run-dir={folder}"]
    return {
        "controller": [
            *common,
            f"--message={MESSAGE}",
            f"--listen=field={controller}",
            f"--connect=field={plant}",
            f"--listen=management={controller_management}",
            f"--connect=management={plant_management}",
        ],
        "tap": [
            *common,
            f"--eavesdropper={EAVESDROPPERS}",
            f"--connect=field={plant}",
            f"--connect=field={controller}",
            f"--listen=adversary={adversary}",
        ],
        "plant": [
            *common,
            f"--steps={steps}",
            f"--pace={pace}",
            f"--listen=field={plant}",
            f"--listen=management={plant_management}",
        ],
    }


class ServiceProcess:
    """A service in a process of its own, and the time until it said its first word."""

    def __init__(self, name: str, arguments: Sequence[str]) -> None:
        self.name = name
        self.lines: list[str] = []
        self.startup_s: float | None = None
        self._began = time.monotonic()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "wyner", name, *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            if self.startup_s is None and f" {self.name} INFO " in line:
                self.startup_s = time.monotonic() - self._began
            self.lines.append(line.rstrip())

    def wait_until_up(self) -> None:
        """Wait for the first line of its log, which each service writes when it is ready."""
        end = time.monotonic() + PATIENCE_S
        while self.startup_s is None:
            if self.process.poll() is not None or time.monotonic() > end:
                self._reader.join(timeout=1.0)
                raise self.failure("did not start")
            time.sleep(0.002)

    def wait(self, limit_s: float) -> None:
        """Wait for its end; it must be a good one."""
        try:
            code = self.process.wait(timeout=limit_s)
        except subprocess.TimeoutExpired:
            raise self.failure(f"did not end within {limit_s:.0f} s") from None
        if code:
            raise self.failure(f"ended with exit code {code}")

    def failure(self, what: str) -> Failure:
        """What went wrong, with the last line of its log."""
        return Failure(f"{self.name} {what}: {self.lines[-1] if self.lines else 'no output'}")

    def rss_mib(self) -> float:
        """Memory that the living process holds, MiB; 0 where the system does not tell."""
        try:
            status = Path(f"/proc/{self.process.pid}/status").read_text()
        except OSError:
            return 0.0
        lines = [line for line in status.splitlines() if line.startswith("VmRSS:")]
        return int(lines[0].split()[1]) / 1024 if lines else 0.0

    def stop(self) -> None:
        """Ask it to end, and end it if it does not."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._reader.join(timeout=1.0)
        if self.process.stderr is not None:
            self.process.stderr.close()


@contextmanager
def running(
    scenario: Path, folder: Path, steps: int, pace: str = "fast"
) -> Iterator[dict[str, ServiceProcess]]:
    """The three services in lock-step; the plant comes last and ends after ``steps`` steps."""
    commands = _commands(scenario, folder, steps, pace)
    services: dict[str, ServiceProcess] = {}
    try:
        for name in ("controller", "tap", "plant"):
            services[name] = ServiceProcess(name, commands[name])
            services[name].wait_until_up()
        yield services
    finally:
        for service in reversed(services.values()):
            service.stop()


def loop_round(scenario: Path, steps: int) -> LoopRound:
    """Run the services for ``steps`` steps; speed by the time stamps of the tap's capture.

    Raises
    ------
    runtime.errors.Failure
        When a service fails, or the capture does not show the steps.
    """
    with tempfile.TemporaryDirectory(prefix="wyner-bench-") as name:
        folder = Path(name)
        with running(scenario, folder, steps) as services:
            services["plant"].wait(PATIENCE_S + STEP_LIMIT_S * steps)
            rss = {n: s.rss_mib() for n, s in services.items() if n != "plant"}
            startup = {n: s.startup_s or 0.0 for n, s in services.items()}
        # Read once the tap has ended: while it runs the capture is a batch behind.
        first_seen: dict[int, int] = {}
        newest: dict[str, dict[int, bytes]] = {Measurement.topic: {}, Offer.topic: {}}
        for line in (folder / CAPTURE).read_bytes().splitlines()[1:]:
            record = json.loads(line)
            if record["event"] != "field":
                continue
            message = record["message"]
            if record["topic"] == Measurement.topic:
                first_seen.setdefault(message["k"], record["t_ns"])
            body = json.dumps(message, separators=(",", ":")).encode()
            newest[record["topic"]][message["k"]] = body
    begin = min((k for k in first_seen if k >= WARM_UP * steps), default=steps)
    end = max(first_seen, default=0)
    both = newest[Measurement.topic].keys() & newest[Offer.topic].keys()
    if end <= begin or not both:
        raise Failure(f"the tap's capture shows {len(first_seen)} of {steps} steps")
    seconds = (first_seen[end] - first_seen[begin]) / 1e9
    sample = max(both)
    return LoopRound(
        steps_per_second=(end - begin) / seconds,
        measurement=newest[Measurement.topic][sample],
        offer=newest[Offer.topic][sample],
        startup_s=startup,
        rss_mib=rss,
    )


# --- the whole -----------------------------------------------------------------------------------


def measure(
    *,
    rounds: int = 5,
    steps: int = 4000,
    scenario: str | Path = SCENARIO,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Measure the loop beside bare round trips.

    Parameters
    ----------
    rounds : int
        Pairs of one loop round and one bare round.
    steps : int
        Steps, and round trips, in each.
    scenario : str or Path
        A scenario file.
    progress : callable, optional
        Told in a line how each round went.

    Returns
    -------
    dict
        ``steps_per_second`` and ``bare_round_trips_per_second`` (medians over rounds; the bare
        processes block on a channel as the services do, and ``queue_round_trips_per_second`` has
        those that wait for a queue which a callback fills), ``ratio``
        (of the two), ``target_ratio``, ``rounds`` (each round's two figures and their ratio),
        ``spread`` (smallest and largest of each figure), ``parts`` (microseconds a step, see
        :func:`benchmarks.loop_parts.measure_parts`, with the transport's round trip and
        the rest that is not accounted for), ``while_waiting`` (the parts that each service does
        while its partner works), ``step_us``, ``startup_s`` and ``rss_mib`` by
        service (medians), ``steps``, ``eavesdroppers``, ``scenario``.

    Raises
    ------
    runtime.errors.Failure
        When a process fails.
    protocol.scenario.ScenarioError
        When the scenario cannot be used.
    """
    from benchmarks.loop_parts import WHILE_WAITING, measure_parts

    path = Path(scenario)
    say = progress or (lambda _line: None)
    loops: list[LoopRound] = []
    bare: list[float] = []
    queued: list[float] = []
    for i in range(rounds):
        loops.append(loop_round(path, steps))
        messages = loops[-1].measurement, loops[-1].offer
        bare.append(bare_round(*messages, steps, "channel"))
        queued.append(bare_round(*messages, steps, "queue"))
        say(
            f"round {i + 1} of {rounds}: {loops[-1].steps_per_second:.0f} steps/s, "
            f"bare {bare[-1]:.0f} round trips/s"
        )
    speed = [one.steps_per_second for one in loops]
    ratios = [a / b for a, b in zip(speed, bare, strict=True)]
    steps_per_second = statistics.median(speed)
    bare_per_second = statistics.median(bare)
    every = measure_parts(path, steps, steps_per_second, 0.5 / bare_per_second)
    parts = {name: us for name, us in every.items() if not name.startswith(WHILE_WAITING)}
    waiting = {
        name.removeprefix(WHILE_WAITING): us for name, us in every.items() if name not in parts
    }
    parts["transport: bare round trip"] = 1e6 / bare_per_second
    step_us = 1e6 / steps_per_second
    parts["rest: processes waking and sharing cores"] = step_us - sum(parts.values())
    return {
        "ratio": steps_per_second / bare_per_second,
        "target_ratio": TARGET_RATIO,
        "steps_per_second": steps_per_second,
        "bare_round_trips_per_second": bare_per_second,
        "queue_round_trips_per_second": statistics.median(queued),
        "rounds": [
            {"steps_per_second": a, "bare_round_trips_per_second": b, "ratio": r}
            for a, b, r in zip(speed, bare, ratios, strict=True)
        ],
        "spread": {
            "steps_per_second": [min(speed), max(speed)],
            "bare_round_trips_per_second": [min(bare), max(bare)],
            "queue_round_trips_per_second": [min(queued), max(queued)],
            "ratio": [min(ratios), max(ratios)],
        },
        "step_us": step_us,
        "parts": parts,
        "while_waiting": waiting,
        "startup_s": _medians([one.startup_s for one in loops]),
        "rss_mib": _medians([one.rss_mib for one in loops]),
        "steps": steps,
        "eavesdroppers": EAVESDROPPERS.split(","),
        "scenario": path.stem,
    }


def _medians(rounds: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: statistics.median(one[name] for one in rounds) for name in rounds[0]}


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` as a table for people."""
    spread = result["spread"]
    verdict = "reached" if result["ratio"] >= result["target_ratio"] else "MISSED"

    def row(name: str, key: str, form: str) -> str:
        low, high = spread[key]
        return f"{name:<28}{result[key]:>10{form}}   ({low:{form}} to {high:{form}})"

    lines = [
        f"lock-step, {result['scenario']}, {len(result['rounds'])} alternating rounds of "
        f"{result['steps']} steps, tap attached ({', '.join(result['eavesdroppers'])})",
        "",
        f"{'':<28}{'median':>10}   (smallest to largest)",
        row("control steps a second", "steps_per_second", ".0f"),
        row("bare round trips a second", "bare_round_trips_per_second", ".0f"),
        row("  and on a queue", "queue_round_trips_per_second", ".0f"),
        row("ratio", "ratio", ".2f"),
        f"target {result['target_ratio']}: {verdict}",
        "",
        f"where {result['step_us']:.0f} microseconds a step go (medians)",
    ]
    lines += [f"  {name:<44}{us:>8.1f}" for name, us in result["parts"].items()]
    lines += ["", "and while the partner works, not holding up the step"]
    lines += [f"  {name:<44}{us:>8.1f}" for name, us in result["while_waiting"].items()]
    lines += ["", "start-up, until the first word (s; target 2), and memory afterwards (MiB)"]
    for name, seconds in result["startup_s"].items():
        memory = result["rss_mib"].get(name)
        lines.append(f"  {name:<12}{seconds:>6.2f}{'' if memory is None else f'{memory:>8.0f}'}")
    return "\n".join(lines)
