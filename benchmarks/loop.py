"""How fast the loop runs in lock-step: the three real services on loopback, the tap attached."""

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

from protocol.messages import Measurement
from runtime.addresses import free_endpoints
from runtime.errors import Failure
from runtime.run_folder import CAPTURE

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
    """One round of the services: speed, and what the processes took."""

    steps_per_second: float
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
        for line in (folder / CAPTURE).read_bytes().splitlines()[1:]:
            record = json.loads(line)
            if record["event"] == "field" and record["topic"] == Measurement.topic:
                first_seen.setdefault(record["message"]["k"], record["t_ns"])
    begin = min((k for k in first_seen if k >= WARM_UP * steps), default=steps)
    end = max(first_seen, default=0)
    if end <= begin:
        raise Failure(f"the tap's capture shows {len(first_seen)} of {steps} steps")
    seconds = (first_seen[end] - first_seen[begin]) / 1e9
    return LoopRound((end - begin) / seconds, startup, rss)


# --- the whole -----------------------------------------------------------------------------------


def measure(
    *,
    rounds: int = 5,
    steps: int = 4000,
    scenario: str | Path = SCENARIO,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Measure the loop.

    Parameters
    ----------
    rounds : int
    steps : int
        Of each round.
    scenario : str or Path
        A scenario file.
    progress : callable, optional
        Told in a line how each round went.

    Returns
    -------
    dict
        ``steps_per_second`` (median over rounds), ``rounds`` (each round's), ``spread`` (smallest
        and largest), ``startup_s`` and ``rss_mib`` by service (medians), ``steps``,
        ``eavesdroppers``, ``scenario``.

    Raises
    ------
    runtime.errors.Failure
        When a process fails.
    protocol.scenario.ScenarioError
        When the scenario cannot be used.
    """
    path = Path(scenario)
    say = progress or (lambda _line: None)
    loops: list[LoopRound] = []
    for i in range(rounds):
        loops.append(loop_round(path, steps))
        say(f"round {i + 1} of {rounds}: {loops[-1].steps_per_second:.0f} steps/s")
    speed = [one.steps_per_second for one in loops]
    return {
        "steps_per_second": statistics.median(speed),
        "rounds": speed,
        "spread": [min(speed), max(speed)],
        "startup_s": _medians([one.startup_s for one in loops]),
        "rss_mib": _medians([one.rss_mib for one in loops]),
        "steps": steps,
        "eavesdroppers": EAVESDROPPERS.split(","),
        "scenario": path.stem,
    }


def _medians(rounds: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: statistics.median(one[name] for one in rounds) for name in rounds[0]}


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` for people."""
    low, high = result["spread"]
    lines = [
        f"lock-step, {result['scenario']}, {len(result['rounds'])} rounds of "
        f"{result['steps']} steps, tap attached ({', '.join(result['eavesdroppers'])})",
        f"control steps a second {result['steps_per_second']:.0f}   ({low:.0f} to {high:.0f})",
        "start-up, until the first word (s; target 2), and memory afterwards (MiB)",
    ]
    for name, seconds in result["startup_s"].items():
        memory = result["rss_mib"].get(name)
        lines.append(f"  {name:<12}{seconds:>6.2f}{'' if memory is None else f'{memory:>8.0f}'}")
    return "\n".join(lines)
