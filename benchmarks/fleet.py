"""Many loops in three processes: what is missed, how late offers are, what it costs.

One host of controllers, one of plants, one of taps, on loopback, in real time. Once all loops run,
a window is measured: missed steps and offers' latencies as the plants count them, the three
processes' time on the processor and memory, and what the taps' recordings lack.
"""

import json
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

from benchmarks.loop import EAVESDROPPERS, ServiceProcess
from protocol.messages import LATENCY_BOUNDS_S
from runtime.addresses import free_endpoints
from runtime.errors import Failure
from runtime.files import write_atomically
from runtime.run_folder import PLANT_STATUS, PLANT_TRACE

SETTLE_S: Final = 3.0
"""From when every loop has moved to the beginning of the window."""

PATIENCE_S: Final = 60.0
MESSAGE: Final = "The quick brown fox jumps over the lazy dog."

MISSED_TARGET: Final = 0
P99_TARGET_MS: Final = 10.0
MEMORY_TARGET_MIB: Final = 400.0

_SEEN = re.compile(rb'"topic":"(measurement|offer)".{0,80}?"k":(\d+)', re.DOTALL)
_MISSED = re.compile(rb'"event":"missed"[^}\n]{0,80}?"k":(\d+)')


def write_fleet(folder: Path, loops: int, scenario: str) -> Path:
    """Write the file of a fleet of so many loops of one scenario, anew."""
    path = folder / "fleet.toml"
    tables = (
        f'[[loop]]\nid = "loop-{number:04d}"\nscenario = "{scenario}"\nmessage = "{MESSAGE}"\n'
        for number in range(loops)
    )
    write_atomically(path, "\n".join(tables).encode())
    return path


@contextmanager
def hosts(fleet: Path, pace: str, *, router: bool = False) -> Iterator[dict[str, ServiceProcess]]:
    """The three hosts of a fleet's file, beside it, and a router where one is asked for."""
    plant, controller, plant_management, controller_management, adversary, relay = free_endpoints(6)
    common = [f"--fleet={fleet}", f"--run-dir={fleet.parent}"]
    clients = [f"--connect=field={relay}", "--client=field"]
    commands = {
        "controller": [
            *(clients if router else (f"--listen=field={controller}", f"--connect=field={plant}")),
            f"--listen=management={controller_management}",
            f"--connect=management={plant_management}",
        ],
        "tap": [
            f"--eavesdropper={EAVESDROPPERS}",
            *(clients if router else (f"--connect=field={plant}", f"--connect=field={controller}")),
            f"--listen=adversary={adversary}",
        ],
        "plant": [
            f"--pace={pace}",
            *(clients if router else (f"--listen=field={plant}",)),
            f"--listen=management={plant_management}",
        ],
    }
    services: dict[str, ServiceProcess] = {}
    with ExitStack() as stack:
        if router:
            services["router"] = ServiceProcess("router", [f"--listen=field={relay}"])
            stack.callback(services["router"].stop)
            time.sleep(1.0)
        for name, arguments in commands.items():
            services[name] = ServiceProcess(name, [*common, *arguments])
            stack.callback(services[name].stop)
            services[name].wait_until_up()
        yield services


def statuses_in(folder: Path) -> list[dict[str, Any]]:
    """What the plants said last."""
    found = []
    for path in folder.glob(f"*/{PLANT_STATUS}"):
        try:
            found.append(json.loads(path.read_bytes()))
        except (OSError, ValueError):
            continue
    return found


def _cpu_s(service: ServiceProcess) -> float:
    """Processor time of a living process so far, seconds."""
    fields = Path(f"/proc/{service.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def quantile_ms(counts: list[int], part: float) -> float:
    """Upper bound of the bucket in which the quantile lies, milliseconds."""
    left = part * sum(counts)
    for bound, count in zip((*LATENCY_BOUNDS_S, float("inf")), counts, strict=True):
        left -= count
        if left <= 0:
            return bound * 1e3
    return float("inf")


def lost(folder: Path) -> tuple[int, int]:
    """Messages that the taps should have, each once, and how many of them they lack.

    A missed step's offer may never have been made, so nobody has to have it.
    """
    expected = lacking = 0
    for loop in folder.glob("*/tap"):
        seen: dict[bytes, set[int]] = {b"measurement": set(), b"offer": set()}
        for part in loop.glob("capture*"):
            for topic, k in _SEEN.findall(part.read_bytes()):
                seen[topic].add(int(k))
        missed = {int(k) for k in _MISSED.findall((loop.parent / PLANT_TRACE).read_bytes())}
        for topic, steps in seen.items():
            if steps:
                due = set(range(min(steps), max(steps) + 1))
                due -= missed if topic == b"offer" else set()
                expected += len(due)
                lacking += len(due - steps)
    return expected, lacking


def measure(
    *,
    loops: int = 50,
    seconds: float = 10.0,
    scenario: str = "sustained",
    pace: str = "realtime",
    router: bool = False,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run a fleet and measure a window of it.

    Parameters
    ----------
    loops : int
    seconds : float
        Length of the window.
    scenario, pace : str
        As for ``wyner plant``.
    router : bool
        Field messages go through a router.
    progress : callable, optional
        Told in a line what is under way.

    Returns
    -------
    dict
        ``missed`` and ``steps`` in the window, ``p50_ms`` and ``p99_ms`` of offers (upper bounds of
        their buckets), ``memory_mib`` of all processes and ``memory`` by process, ``cores`` by
        process, ``cpu_us_per_step``, ``tap_expected`` and ``tap_lost`` (distinct messages),
        ``loops``, ``running``, ``seconds``, ``router``.

    Raises
    ------
    Failure
        When a host fails, or not every loop comes to run.
    """
    say = progress or (lambda _line: None)
    with tempfile.TemporaryDirectory(prefix="wyner-fleet-") as name:
        folder = Path(name)
        with hosts(write_fleet(folder, loops, scenario), pace, router=router) as services:
            wait_until_all_run(folder, loops, services)
            say(f"{loops} loops run")
            time.sleep(SETTLE_S)
            before = _sums(statuses_in(folder))
            cpu = {name: _cpu_s(service) for name, service in services.items()}
            began = time.monotonic()
            time.sleep(seconds)
            for service in services.values():
                if service.process.poll() is not None:
                    raise service.failure("ended before its time")
            taken = time.monotonic() - began
            cores = {name: (_cpu_s(s) - cpu[name]) / taken for name, s in services.items()}
            memory = {name: service.rss_mib() for name, service in services.items()}
            after = _sums(statuses_in(folder))
        expected, lacking = lost(folder)
    steps = after["k"] - before["k"]
    counts = [b - a for a, b in zip(before["counts"], after["counts"], strict=True)]
    return {
        "missed": after["missed"] - before["missed"],
        "steps": steps,
        "p50_ms": quantile_ms(counts, 0.5),
        "p99_ms": quantile_ms(counts, 0.99),
        "memory_mib": sum(memory.values()),
        "memory": memory,
        "cores": cores,
        "cpu_us_per_step": sum(cores.values()) * taken / max(steps, 1) * 1e6,
        "tap_expected": expected,
        "tap_lost": lacking,
        "loops": loops,
        "running": after["running"],
        "seconds": seconds,
        "router": router,
    }


def wait_until_all_run(folder: Path, loops: int, services: Mapping[str, ServiceProcess]) -> None:
    """Wait until every loop has moved.

    Raises
    ------
    Failure
        When a host has ended, or it takes too long.
    """
    until = time.monotonic() + PATIENCE_S
    while True:
        running = sum(status["step"]["transitions"] > 0 for status in statuses_in(folder))
        if running == loops:
            return
        for service in services.values():
            if service.process.poll() is not None:
                raise service.failure("ended before its time")
        if time.monotonic() > until:
            raise Failure(f"{running} of {loops} loops run after {PATIENCE_S:g} s")
        time.sleep(0.5)


def _sums(statuses: list[dict[str, Any]]) -> dict[str, Any]:
    steps = [status["step"] for status in statuses]
    counts = [status["timing"]["latency_counts"] for status in statuses]
    return {
        "k": sum(step["k"] for step in steps),
        "missed": sum(step["missed"] for step in steps),
        "counts": [sum(c) for c in zip(*counts, strict=True)],
        "running": sum(step["transitions"] > 0 for step in steps),
    }


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` for people."""

    def verdict(good: bool) -> str:
        return "reached" if good else "MISSED"

    missed, p99, memory = result["missed"], result["p99_ms"], result["memory_mib"]
    each = ", ".join(f"{name} {mib:.0f}" for name, mib in result["memory"].items())
    cores = ", ".join(f"{name} {part:.2f}" for name, part in result["cores"].items())
    way = "through a router" if result["router"] else "as peers"
    return "\n".join(
        [
            f"{result['running']} of {result['loops']} loops for {result['seconds']:g} s, {way}",
            f"missed steps           {missed} of {result['steps']}   (target 0: "
            f"{verdict(missed == MISSED_TARGET)})",
            f"latency of an offer    p50 <= {result['p50_ms']:g} ms, p99 <= {p99:g} ms   "
            f"(target {P99_TARGET_MS:g}: {verdict(p99 <= P99_TARGET_MS)})",
            f"memory                 {memory:.0f} MiB ({each})   "
            f"(target {MEMORY_TARGET_MIB:g}: {verdict(memory <= MEMORY_TARGET_MIB)})",
            f"processors             {cores}; {result['cpu_us_per_step']:.0f} us a step in all",
            f"lost at the taps       {result['tap_lost']} of {result['tap_expected']}",
        ]
    )
