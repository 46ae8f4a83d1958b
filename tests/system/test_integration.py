"""Three real processes over real Zenoh on loopback: by hand, by ``wyner up``, and under kill -9."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from protocol.messages import Measurement, Offer, PlantHello, SendCommand
from protocol.topics import key_of
from runtime.addresses import free_endpoints
from runtime.run_folder import PLANT_TRACE
from runtime.zenoh_bus import ZenohBus
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.programs import started, wyner
from tests.support.traces import events_of, recovered_in

pytestmark = [pytest.mark.slow, pytest.mark.integration]

WYNER = ("-m", "wyner")


def status(run_dir: Path, service: str) -> dict[str, Any]:
    try:
        value: dict[str, Any] = json.loads((run_dir / service / "status.json").read_bytes())
    except OSError:
        return {}
    return value


def counted(run_dir: Path, service: str, what: str = "transitions") -> int:
    """A figure of the step in a status; 0 before there is one."""
    return int(status(run_dir, service).get("step", {}).get(what, 0))


def children_of(pid: int) -> dict[str, int]:
    """The services that a process has started, by name."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            stat = (path / "stat").read_text().rpartition(")")[2].split()
            command = (path / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if stat[1] == str(pid) and stat[0] != "Z":
            for word in command:
                if word.endswith(b"_service"):
                    found[word.decode().removesuffix("_service")] = int(path.name)
    return found


def test_up_delivers_and_sums_up(tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    options = ["up", "--pace", "fast", "--until-delivered", "--json", "--seed", "3"]
    done = wyner(*options, "--message", "Grüße\taus\ndem Keller", "--run-dir", str(run_dir))
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout.splitlines()[-1])
    assert summary["delivered"]
    assert summary["sent"] == summary["recovered"] == "Grüße\taus\ndem Keller"
    assert summary["symbol_errors"] == 0
    assert summary["agreements"] > 100
    assert 1.5 < summary["bits_per_second"] < 3.0
    assert {"set-membership", "nearest-centre"} <= summary["taps"].keys()
    assert json.loads((run_dir / "manifest.json").read_text())["seed"] == 3
    assert "\x1b" not in done.stderr
    again = wyner("up", "--run-dir", str(run_dir))
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1


def kill_and_see_it_back(parent: int, victim: str, run_dir: Path) -> None:
    wait_for(lambda: victim in children_of(parent))
    pid = children_of(parent)[victim]
    os.kill(pid, signal.SIGKILL)
    wait_for(lambda: children_of(parent).get(victim, pid) != pid)
    before = counted(run_dir, "plant")
    wait_for(lambda: counted(run_dir, "plant") > before + 20)


@pytest.mark.slow
def test_the_promise_holds_under_kill_9(tmp_path: Path) -> None:
    """Each service is killed in the middle of the message; it arrives all the same."""
    run_dir = tmp_path / "run"
    command = [*WYNER, "up", "--pace", "x20", "--until-delivered", "--json"]
    command += ["--run-dir", str(run_dir), "--message", "Killed, and told all the same."]
    with started(*command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        wait_for(lambda: counted(run_dir, "plant") > 40)
        for victim in ("controller", "plant", "tap"):
            kill_and_see_it_back(process.pid, victim, run_dir)
        out, _ = process.communicate(timeout=PATIENCE_S)
    summary = json.loads(out.splitlines()[-1])
    assert process.returncode == 0
    assert summary["delivered"]
    assert summary["recovered"] == "Killed, and told all the same."
    assert summary["missed"] > 0
    sessions = {e["session"] for e in events_of(run_dir / PLANT_TRACE, "transition")}
    assert len(sessions) == 1, "a kill alone must not end the session"


def test_services_do_not_outlive_a_killed_parent(tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    command = [*WYNER, "up", "--pace", "x10", "--run-dir", str(run_dir)]
    with started(*command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        wait_for(lambda: counted(run_dir, "plant") > 5)
        services = children_of(process.pid)
        assert services.keys() == {"controller", "plant", "tap"}
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in services.values()))


class ByHand:
    """Three services started as the README says, on free ports."""

    def __init__(self, run_dir: Path) -> None:
        self.run_dir = run_dir
        self.field = dict(zip(("plant", "controller"), free_endpoints(2), strict=True))
        self.management = dict(zip(("plant", "controller"), free_endpoints(2), strict=True))
        self.processes: dict[str, subprocess.Popen[str]] = {}

    def start(self, service: str, *arguments: str) -> None:
        joins, listens = [], []
        for name, bus in (("field", self.field), ("management", self.management)):
            if service in bus:
                listens += ["--listen", f"{name}={bus[service]}"]
            if service == "controller":
                joins += ["--connect", f"{name}={bus['plant']}"]
        if service == "tap":
            for at in self.field.values():
                joins += ["--connect", f"field={at}"]
        run = ["--run-dir", str(self.run_dir), "--scenario", "runtime/scenarios/sustained.toml"]
        self.processes[service] = subprocess.Popen(
            [sys.executable, *WYNER, service, *run, *listens, *joins, *arguments],
            stderr=subprocess.PIPE,
            text=True,
        )

    def stop(self) -> dict[str, int]:
        for process in self.processes.values():
            process.terminate()
        return {name: process.wait(PATIENCE_S) for name, process in self.processes.items()}


@pytest.fixture
def by_hand(tmp_path: Path) -> Iterator[ByHand]:
    system = ByHand(tmp_path)
    yield system
    for process in system.processes.values():
        process.kill()
        process.communicate()


def test_by_hand_in_any_order_with_send_and_malformed(by_hand: ByHand, tmp_path: Path) -> None:
    """The controller comes first and waits; messages are sent to it while malformed flies."""
    by_hand.start("controller")
    by_hand.start("tap")
    by_hand.start("plant", "--pace", "x20")
    management = ["--connect", f"management={by_hand.management['controller']}"]
    sent = wyner("send", "first", *management)
    assert sent.returncode == 0, sent.stderr
    (tmp_path / "note").write_bytes(bytes(range(0, 256, 43)))
    assert wyner("send", f"@{tmp_path}/note", *management).returncode == 0
    with (
        ZenohBus(connect=[*by_hand.field.values()]) as field,
        ZenohBus(connect=[*by_hand.management.values()]) as bus,
    ):
        publishers = [field.publisher(key_of(kind, "loop")) for kind in (Measurement, Offer)]
        publishers += [bus.publisher(key_of(kind, "loop")) for kind in (PlantHello, SendCommand)]
        wait_for(lambda: all(p.matched for p in publishers))

        def counted() -> bool:
            for publisher in publishers:
                publisher.put(b"\x00garbage")
            malformed = [
                status(by_hand.run_dir, one).get("malformed", 0) for one in ("plant", "controller")
            ]
            return bool(min(malformed) > 50)

        wait_for(counted)
    recovered = partial(recovered_in, by_hand.run_dir)
    wait_for(lambda: len(recovered()) == 2)
    assert by_hand.stop() == {"controller": 0, "tap": 0, "plant": 0}
    checked = wyner("check", str(by_hand.run_dir))
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_a_run_can_be_joined_without_an_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the background of a script, where SIGINT is ignored until the run takes it back."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    message = "first\nline\tand more of it"
    command = [sys.executable, "-m", "wyner", "up", "--pace", "x10", "--json", "--message", message]
    in_background = ["sh", "-c", 'trap "" INT; exec "$@"', "sh", *command]
    with subprocess.Popen(
        [*in_background, "--run-dir", str(tmp_path / "joined")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            wait_for(lambda: counted(tmp_path / "joined", "plant", "k") > 0)
            assert wyner("send", "second").returncode == 2, "it is of another folder"
            sent = wyner("send", "second", "--run", "joined")
            assert sent.returncode == 0, sent.stderr
            told = " ".join(sent.stdout.split())
            assert f"at run {tmp_path / 'joined'}, loop loop: 6 bytes" in told
            assert "2 not delivered yet" in told
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
            with started(*WYNER, "dashboard", **pipes) as dashboard:
                joined = f"joining the run {tmp_path / 'joined'} (sustained)"
                assert joined in dashboard.stderr.readline()
                assert any("plant running" in line for line in dashboard.stdout)
                dashboard.send_signal(signal.SIGINT)
                dashboard.communicate(timeout=PATIENCE_S)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    assert process.returncode == 130, err
    summary = json.loads(out.splitlines()[-1])
    assert summary["sent"] == message
