"""Keys over a lossy medium, one to three receivers, and a passive radio that hears every datagram.

Plant, controller and taps run in network namespaces on a medium in user space
(`tests.support.medium`): the field bus over UDP, a datagram for each receiver, or over a multicast
group, one for all; and the claim as it is stated.
The radio misses a share of the *datagrams*. What it then holds of the keys is computed as an audit
computes it, from all that it heard.
"""

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from pydantic_core import to_json

from runtime.logs import logger
from runtime.recording import Bounds
from runtime.run_folder import CAPTURE, PLANT_STATUS
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from tap_service.capture.recording import CAPTURE_VERSION, RotatingLog, mirror_line
from tests.support.medium import Medium, Radio, Station, medium
from wyner.runs.run import Run
from wyner.runs.score.keys import KeyAudit, audit_keys
from wyner.runs.score.summary import summarise

GROUP: Final = "udp/224.0.0.251:7461#iface=air"


class Case(NamedTuple):
    """One run: how the field bus goes, who receives a message, and what is claimed."""

    transport: str
    receivers: int
    eps_E: float
    appearances: int
    steps: int
    loss: float = 0.3
    tap_loss: float = 0.3


class Result(NamedTuple):
    """What came of a run."""

    keys: int
    appearances: tuple[int, int]
    stopped: str
    radio: KeyAudit
    summary: dict[str, Any]


def run(case: Case, seed: int, folder: Path) -> Result:
    """Run plant, controller and the other receivers on a medium.

    Raises
    ------
    NoNamespaces
        Where these cannot be made.
    """
    taps = [case.tap_loss] * (case.receivers - 1)
    with medium(seed, [0.0, 0.0, *taps]) as air:
        radio = air.radio(case.loss)
        air.start()
        _loop(case, air, folder)
    run_dir = folder / "run"
    told = summarise(Run.load(run_dir), b"hello")["keys"]
    status = json.loads((run_dir / PLANT_STATUS).read_bytes())
    other = json.loads((run_dir / "controller" / PLANT_STATUS.name).read_bytes())
    audit = _audit(radio, case, folder)
    most = tuple(_most(run_dir / side / "trace.jsonl") for side in ("plant", "controller"))
    stopped = status["keys_stopped"] or other["keys_stopped"]
    return Result(told["made"], (most[0], most[1]), stopped, audit, told)


def _most(trace: Path) -> int:
    """How often a message left at most, as a side's trace tells."""
    lines = (line for line in trace.read_bytes().splitlines() if b'"appearances"' in line[:24])
    return max((json.loads(line)["times"] for line in lines), default=0)


def _loop(case: Case, air: Medium, folder: Path) -> None:
    run_dir = folder / "run"
    scenario = folder / "keys.toml"
    text = (SCENARIOS / "keys.toml").read_text()
    text = text.replace("loss = 0.3 ", "loss = 0.0 ")
    text = text.replace("appearances = 1 ", f"appearances = {case.appearances} ")
    scenario.write_text(text.replace("eps_E = 0.3 ", f"eps_E = {case.eps_E} "))
    plant, controller, *taps = air.stations
    wyner = [sys.executable, "-m", "wyner"]
    knowledge = folder / "knowledge.json"
    knowledge.write_text(load_scenario(scenario).knowledge().model_dump_json())
    common = ["--scenario", str(scenario), "--run-dir", str(run_dir)]

    def at(station: Station, bus: int) -> str:
        kind = "udp" if case.transport == "udp" and bus == 7461 else "tcp"
        return f"{kind}/{station.address}:{bus}"

    def field(connect: Sequence[Station], here: Station) -> list[str]:
        if case.transport == "multicast":
            return ["--listen", f"field={GROUP}"]
        listen = ["--listen", f"field={at(here, 7461)}"]
        return listen + [w for one in connect for w in ("--connect", f"field={at(one, 7461)}")]

    commands = {}
    for i, tap in enumerate(taps):
        mine = run_dir if not i else folder / f"tap{i}"
        commands[f"tap{i}"] = [
            *tap.prefix,
            *wyner,
            "tap",
            "--knowledge",
            str(knowledge),
            "--run-dir",
            str(mine),
            "--eavesdropper",
            "nearest-centre",
            "--finish",
            "1",
            *field((), tap),
            "--listen",
            "adversary=tcp/127.0.0.1:7465",
        ]
    commands["plant"] = [
        *plant.prefix,
        *wyner,
        "plant",
        *common,
        "--pace",
        "x1",
        "--steps",
        str(case.steps),
        *field(taps, plant),
        "--listen",
        f"management={at(plant, 7463)}",
    ]
    commands["controller"] = [
        *controller.prefix,
        *wyner,
        "controller",
        *common,
        "--message",
        "hello",
        *field((plant, *taps), controller),
        "--listen",
        f"management={at(controller, 7464)}",
        "--connect",
        f"management={at(plant, 7463)}",
    ]
    processes: dict[str, subprocess.Popen[bytes]] = {}
    log = folder / "log"
    try:
        for i, (name, command) in enumerate(commands.items()):
            with log.open("ab") as file:
                processes[name] = subprocess.Popen(command, stdout=file, stderr=file)
            if name.startswith("tap"):  # it is to hear the first message
                _until(log, b"listening", i + 1)
        if processes["plant"].wait(60 + case.steps / 3) != 0:
            raise RuntimeError(log.read_text())
        for name in ("controller", *(name for name in processes if name.startswith("tap"))):
            processes[name].terminate()
            processes[name].wait(60)  # what makes keys runs where a core is idle
    finally:
        for process in processes.values():
            process.kill()
            process.wait()


def _until(log: Path, word: bytes, times: int) -> None:
    until = time.monotonic() + 60
    while log.read_bytes().count(word) < times:
        if time.monotonic() > until:
            raise RuntimeError(log.read_text())
        time.sleep(0.05)
    time.sleep(1.0)  # it says so before its socket is open


def _audit(radio: Radio, case: Case, folder: Path) -> KeyAudit:
    """What the radio holds, from a run's folder in which its capture is the tap's."""
    hers = folder / "radio"
    shutil.copytree(folder / "run", hers, ignore=shutil.ignore_patterns("tap"))
    header = {
        "vantage": "tap",
        "capture_version": CAPTURE_VERSION,
        "appearances": case.receivers if case.transport == "udp" else 1,
    }
    capture = RotatingLog(hers / CAPTURE, header, Bounds(free_bytes=0), logger("radio"))
    for t_ns, topic, fields in radio.heard:
        capture.write(mirror_line(t_ns, topic, to_json(fields)))
    capture.close()
    audit = audit_keys(Run.load(hers), load_scenario(folder / "keys.toml"))
    assert audit is not None
    return audit
