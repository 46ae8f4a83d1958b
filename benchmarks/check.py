"""How long `wyner check` takes, and how much memory: ``python -m benchmarks.check``.

A run of so many steps is made by both ends as the services open them, with traces, journals and a
capture of all that they said; then the command checks it, in a process of its own.
"""

import argparse
import json
import logging
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmarks.timing import HEARS, SIDES, TimingPorts, open_end
from protocol.messages import FIELD
from runtime.perform import perform
from runtime.run_folder import CAPTURE, SCENARIO
from runtime.shipped import SCENARIOS
from tap_service.capture.recording import Limits, RotatingLog

if TYPE_CHECKING:
    from protocol.messages import Message

MOST_S: Final = 120
MOST_MB: Final = 300
"""What a million steps may take."""


class _Heard(TimingPorts):
    """An end's ports with a tap at them."""

    tap: RotatingLog

    def publish(self, message: "Message") -> None:
        """Leave it for the partner, and on record."""
        super().publish(message)
        if type(message) in FIELD:
            line = b'{"event":"field","t_ns":%d,"topic":"%s","message":%s}'
            self.tap.write(line % (time.time_ns(), message.topic.encode(), message.wire()))


def make_run(folder: Path, steps: int, name: str = "sustained") -> None:
    """A run of ``steps`` steps in lock-step, with all that `wyner check` compares."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCENARIO).write_bytes((SCENARIOS / f"{name}.toml").read_bytes())
    view = {"view": "both", "loss": 0.0, "noise": 0.0, "quantise": 0.0, "delay": 0}
    limits = Limits(total_bytes=2**40, free_bytes=0)
    tap = RotatingLog(folder / CAPTURE, {"view": view}, limits, logging.getLogger("tap"))
    ends = {side: open_end(side, name, folder, time.monotonic()) for side in SIDES}
    ports = {side: _Heard(ends[side][1]) for side in SIDES}
    for side in SIDES:
        ports[side].tap = tap
        perform(ends[side][0].start(time.monotonic()), ends[side][0], ports[side])
    plant = ends["plant"][2]
    while plant.record.k < steps:
        for side, other in zip(SIDES, reversed(SIDES), strict=True):
            endpoint, now = ends[side][0], time.monotonic()
            mail, ports[other].mail = ports[other].mail, []
            if endpoint.wake_at() <= now:
                perform(endpoint.wake(now), endpoint, ports[side])
            for kind, payload in mail:
                if kind in HEARS[side]:
                    perform(endpoint.receive(kind, payload, now), endpoint, ports[side])
    for side in SIDES:
        ports[side].files.close()
    tap.close()


def measure(steps: int = 1_000_000, folder: Path | None = None) -> dict[str, Any]:
    """Seconds and megabytes of a check; of the run in ``folder`` where that is given."""
    with tempfile.TemporaryDirectory() as temporary:
        run = folder or Path(temporary) / "run"
        if folder is None:
            make_run(run, steps)
        began = time.monotonic()
        command = [sys.executable, "-m", "wyner", "check", "--json", str(run)]
        child = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert child.stdout is not None
        told = json.loads(child.stdout.read() or b"{}")
        usage = os.wait4(child.pid, 0)[2]
        child.returncode = 0
    return {
        "steps": next((c["counted"] for c in told["checks"] if c["name"] == "switching"), 0),
        "passed": told["passed"],
        "seconds": time.monotonic() - began,
        "cpu_seconds": usage.ru_utime + usage.ru_stime,
        "megabytes": usage.ru_maxrss / 1000,
    }


def render(told: dict[str, Any]) -> str:
    """For people."""
    verdict = "it passed" if told["passed"] else "IT FAILED"
    return (
        f"{told['steps']} steps checked in {told['seconds']:.0f} s ({told['cpu_seconds']:.0f} s of "
        f"the processor), {told['megabytes']:.0f} MB at most; {verdict}. "
        f"A million may take {MOST_S} s and {MOST_MB} MB."
    )


def main(argv: list[str] | None = None) -> int:
    """Measure; 1 where a run does not pass."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--make", type=Path, metavar="D", help="only make the run, in this folder")
    parser.add_argument("--run", type=Path, metavar="D", help="a run that is there")
    args = parser.parse_args(argv)
    if args.make is not None:
        make_run(args.make, args.steps)
        return 0
    told = measure(args.steps, args.run)
    print(render(told))
    return 0 if told["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
