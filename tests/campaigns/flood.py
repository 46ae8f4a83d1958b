"""Live services in a flood: ``python -m tests.campaigns.flood --count 1000000``.

Controller, plant, tap and dashboard run as processes, all clients of one router, and somebody
publishes on every key of every bus as fast as it goes: what :mod:`tests.campaigns.fuzz` makes, and
messages of 16 MB. Nothing may end, memory stays bounded, logs are throttled, and the loop goes on.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from protocol.messages import (
    ControllerHello,
    ControllerStatus,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantModel,
    PlantStatus,
    SealCommand,
    Sealed,
    SealedReceipt,
    SendCommand,
    TapStatus,
)
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.addresses import free_endpoints
from runtime.files import write_atomically
from runtime.run_folder import CAPTURE, PLANT_TRACE
from runtime.zenoh_bus import ZenohBus
from tests.campaigns.fuzz import LARGEST_BYTES, payloads
from tools.rehearsal import Rehearsal
from wyner.sweeps.grid import code_version

BUSES = ("field", "management", "adversary")
CARRIES: dict[str, tuple[type[Message], ...]] = {
    "field": (Measurement, Offer, Sealed),
    "management": (
        PlantHello,
        ControllerHello,
        PlantModel,
        PlantStatus,
        ControllerStatus,
        SendCommand,
        SealCommand,
        SealedReceipt,
    ),
    "adversary": (TapStatus,),
}
ON: dict[str, tuple[str, ...]] = {
    "controller": ("field", "management"),
    "plant": ("field", "management"),
    "tap": ("field", "adversary"),
    "dashboard": ("management", "adversary"),
}
PATIENCE_S = 60.0


class Services:
    """The router and its four clients, until they are closed."""

    def __init__(self, folder: Path, pace: str) -> None:
        self.folder = folder
        self.endpoints = dict(zip(BUSES, free_endpoints(len(BUSES)), strict=True))
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        listen = [f"--listen={bus}={end}" for bus, end in self.endpoints.items()]
        self._start("router", listen)
        time.sleep(1.0)
        common = ["--scenario=sustained", f"--run-dir={folder}"]
        own = {
            "controller": [*common, "--message=one of many"],
            "plant": [*common, f"--pace={pace}"],
            "tap": [*common, "--eavesdropper=set-membership"],
            "dashboard": ["--headless"],
        }
        for name, arguments in own.items():
            clients = [f"--client={bus}" for bus in ON[name]]
            connects = [f"--connect={bus}={self.endpoints[bus]}" for bus in ON[name]]
            self._start(name, [*arguments, *clients, *connects])

    def _start(self, name: str, arguments: list[str]) -> None:
        with (self.folder / f"{name}.out").open("wb") as out:
            command = [sys.executable, "-m", "wyner", name, *arguments]
            self.processes[name] = subprocess.Popen(command, stdout=out, stderr=out)

    def steps(self) -> int:
        """Transitions in the plant's trace."""
        with suppress(OSError):
            return (self.folder / PLANT_TRACE).read_bytes().count(b'"event":"transition"')
        return 0

    def makes(self, steps: int) -> bool:
        """Whether so many more are made, with patience."""
        goal, until = self.steps() + steps, time.monotonic() + PATIENCE_S
        while self.steps() < goal and time.monotonic() < until:
            time.sleep(0.2)
        return self.steps() >= goal

    def memory(self) -> dict[str, tuple[float, float]]:
        """Megabytes that each process has, and the most that it had."""
        found = {}
        for name, process in self.processes.items():
            with suppress(OSError):
                status = Path(f"/proc/{process.pid}/status").read_text().split("\n")
                kb = {
                    k: int(v.split()[0])
                    for k, _, v in (s.partition(":") for s in status)
                    if k in ("VmRSS", "VmHWM")
                }
                found[name] = (kb["VmRSS"] / 1024, kb["VmHWM"] / 1024)
        return found

    def gone(self) -> list[str]:
        """Which processes have ended, with the last of what they said."""
        return [
            f"{name}: exit code {p.returncode}: {self.said(name)[-300:]!r}"
            for name, p in self.processes.items()
            if p.poll() is not None
        ]

    def said(self, name: str) -> str:
        """All that a process printed."""
        return (self.folder / f"{name}.out").read_text(errors="replace")

    def close(self) -> None:
        """End them, the router last."""
        for name in reversed(self.processes):
            self.processes[name].terminate()
        for process in self.processes.values():
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextmanager
def flooding(services: Services) -> Iterator[Any]:
    """A client of the router: call it with a bus's name and a payload."""
    with ExitStack() as stack:
        publishers = {}
        for bus, kinds in CARRIES.items():
            opened = stack.enter_context(ZenohBus(connect=[services.endpoints[bus]], client=True))
            publishers[bus] = [opened.publisher(key_of(kind, DEFAULT_LOOP)) for kind in kinds]
        draw = random.Random(1)
        yield lambda bus, payload: draw.choice(publishers[bus]).put(payload)


def heard_on(services: Services) -> dict[str, list[bytes]]:
    """What was said on each bus, to be changed."""
    field = [
        json.dumps(line["message"]).encode()
        for line in map(json.loads, (services.folder / CAPTURE).read_bytes().splitlines()[:200])
        if line["event"] == "field"
    ]
    statuses = [a.message for batch in Rehearsal().arrivals(100) for a in batch]
    management = [s.wire() for s in statuses if not isinstance(s, TapStatus)]
    fingerprint, session = "0" * 64, "1" * 16
    hello = PlantHello(
        instance=session,
        session=session,
        incarnation=0,
        fingerprint=fingerprint,
        transitions=0,
        applied_k=-1,
    )
    return {
        "field": field,
        "management": [*management, hello.wire(), SealedReceipt(id="a").wire()],
        "adversary": [s.wire() for s in statuses if isinstance(s, TapStatus)],
    }


def flood(count: int, large: int, seconds: float, pace: str = "x10") -> dict[str, Any]:
    """Flood each bus with ``count`` messages, and ``large`` of 16 MB; what came of it.

    Raises
    ------
    AssertionError
        When a process has ended, or the loop does not go on.
    """
    with tempfile.TemporaryDirectory() as name:
        services = Services(Path(name), pace)
        try:
            assert services.makes(60), services.gone() or services.said("plant")
            before, began, steps = services.memory(), time.monotonic(), services.steps()
            sent = dict.fromkeys(BUSES, 0)
            heard = heard_on(services)
            made = {bus: payloads(seed, heard[bus]) for seed, bus in enumerate(BUSES)}
            until = began + seconds
            with flooding(services) as put:
                while min(sent.values()) < count and time.monotonic() < until:
                    for bus in BUSES:
                        put(bus, next(made[bus]))
                        sent[bus] += 1
                took = time.monotonic() - began
                for _ in range(large):
                    for bus in BUSES:
                        put(bus, b"[" * LARGEST_BYTES)
            meanwhile = services.steps() - steps
            assert services.makes(60), services.gone() or "the loop does not go on"
            assert not services.gone(), services.gone()
            lines = {name: services.said(name).count("\n") for name in services.processes}
            after, lasted = services.memory(), time.monotonic() - began
        finally:
            services.close()
    return {
        "sent": sent,
        "per_second": round(sum(sent.values()) / took),
        "of_16_mb": large * len(BUSES),
        "seconds": round(lasted),
        "steps_meanwhile": meanwhile,
        "mb_before": {n: round(m[0]) for n, m in before.items()},
        "mb_after": {n: round(m[0]) for n, m in after.items()},
        "mb_most": {n: round(m[1]) for n, m in after.items()},
        "log_lines": lines,
    }


def main(argv: list[str] | None = None) -> int:
    """Flood, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000, help="messages on each bus")
    parser.add_argument("--large", type=int, default=20, help="of 16 MB on each bus")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="for the small ones")
    parser.add_argument("--results", type=Path, default=Path("campaign-flood.json"))
    args = parser.parse_args(argv)
    told = {"version": code_version(), **flood(args.count, args.large, args.seconds)}
    print(json.dumps(told, indent=1), file=sys.stderr)
    write_atomically(args.results, json.dumps(told, indent=1).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
