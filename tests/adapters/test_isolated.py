"""A user's plant stays a guest: whatever its code does, it stops itself alone, in its limits."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from plant_service.adapters import Operated, PlantError
from plant_service.adapters.registry import KINDS, open_plant
from protocol.scenario import Scenario
from runtime import sandbox
from tests.adapters.test_device import line
from tests.support.patience import PATIENCE_S

PLANT = """
import ctypes, os, subprocess, sys, threading, time
from tests.adapters.plants import PythonLine

class Line(PythonLine):
    steps = 0
    def step(self, u, period_s):
        self.steps += 1
        if self.steps == 3:
            {act}
        return super().step(u, period_s)
"""


def scenario_of(folder: Path, act: str, **limits: float) -> Scenario:
    (folder / "line.py").write_text(PLANT.format(act=act))
    s = line("line.py:Line")
    return s.model_copy(update={"plant": s.plant.model_copy(update=limits)})


def opened(folder: Path, act: str, **limits: float) -> Operated:
    return open_plant(scenario_of(folder, act, **limits), folder)


def stepped(plant: Operated, steps: int) -> list[tuple[float, ...]]:
    xs = [plant.start(None)]
    for _ in range(steps):
        plant.apply((0.5,))
        xs.append(plant.sample())
    return xs


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def gone(pid: int) -> bool:
    until = time.monotonic() + PATIENCE_S
    while alive(pid) and time.monotonic() < until:
        time.sleep(0.01)
    return not alive(pid)


def written(note: Path, within_s: float = PATIENCE_S) -> str:
    until = time.monotonic() + within_s
    while not (note.exists() and note.read_text()) and time.monotonic() < until:
        time.sleep(0.01)
    return note.read_text() if note.exists() else ""


def test_a_second_close_leaves_the_next_plant_alone(tmp_path: Path) -> None:
    first = opened(tmp_path, "pass")
    first.start(None)
    first.close()
    second = opened(tmp_path, "pass")  # in the same process
    first.close()
    assert len(stepped(second, 2)) == 3
    second.close()


def test_a_process_that_ended_while_nobody_used_it_is_not_handed_out(tmp_path: Path) -> None:
    first = opened(tmp_path, "pass")
    first.start(None)
    first.close()
    for process in sandbox.idle.values():
        os.kill(process.child.pid, signal.SIGKILL)
        process.child.wait(PATIENCE_S)
    second = opened(tmp_path, "pass")
    assert len(stepped(second, 2)) == 3
    second.close()


def test_an_idle_process_is_not_handed_out_in_another_folder_as_its_own_may_be_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    first = opened(tmp_path, "os.getcwd()")
    assert len(stepped(first, 4)) == 5
    first.close()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gone").rmdir()
    second = opened(tmp_path, "os.getcwd()")  # as libraries do that load native code
    assert len(stepped(second, 4)) == 5
    second.close()


def test_it_steps_as_in_the_services_own_process(tmp_path: Path) -> None:
    far, near = opened(tmp_path, "pass"), open_plant(line())
    assert stepped(far, 20) == stepped(near, 20)
    far.close()
    near.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("act", "why"),
    [
        ("sys.exit(0)", "the process ended"),
        ("os._exit(3)", "the process ended"),
        ("os.kill(os.getpid(), 9)", "the process ended"),
        ("ctypes.string_at(0)", "the process ended"),
        ("raise ValueError('no\\nidea')", "ValueError: no idea"),
        ("x = bytearray(8 << 30)", "MemoryError"),
        ("os.closerange(0, 50)", "the process ended"),
        ("time.sleep(60)", "too slow: no answer within 2 s"),
        ("while True: pass", "too slow: no answer within 2 s"),
        ("return ['?', 1]", "got the reading ['?', 1], expected a sequence of numbers"),
        ("return object()", "expected a sequence of numbers"),
    ],
)
def test_what_it_does_stops_it_alone(tmp_path: Path, act: str, why: str) -> None:
    answer_s = 2.0 if "too slow" in why else PATIENCE_S
    plant = opened(tmp_path, act, answer_s=answer_s, memory_mib=1024)
    with pytest.raises(PlantError, match=r"^plant: sample: ") as error:
        stepped(plant, 3)
    assert why in str(error.value)
    assert "\n" not in str(error.value)
    assert plant.fault
    with pytest.raises(PlantError, match="is in its safe state"):
        plant.sample()
    plant.close()
    fine = opened(tmp_path, "pass")  # the next one is a plant like any other
    assert len(stepped(fine, 4)) == 5
    fine.close()


@pytest.mark.slow
def test_an_answer_that_floods_is_none(tmp_path: Path) -> None:
    plant = opened(tmp_path, "return [0.0] * 3_000_000", answer_s=30.0)
    with pytest.raises(PlantError, match="an answer that is none"):
        stepped(plant, 3)
    plant.close()


@pytest.mark.parametrize(
    "act", ['print("x" * 10**6, flush=True)', 'sys.stderr.write("x" * 10**6)', "os.write(1, b'x')"]
)
def test_what_it_prints_disturbs_nobody(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], act: str
) -> None:
    plant = opened(tmp_path, act)
    assert len(stepped(plant, 5)) == 6
    plant.close()
    assert capfd.readouterr() == ("", "")


FORKS = """note = open({note!r}, "a")
            if os.fork() == 0:
                {leave}
                note.write(str(os.getpid())); note.close()
                time.sleep(60)
                os._exit(0)
            note.close()
            {then}"""


@pytest.mark.slow
@pytest.mark.parametrize("leave", ["pass", "os.setsid()", "os.setsid(); os.fork() and os._exit(0)"])
@pytest.mark.parametrize("then", ["time.sleep(0.2)", "time.sleep(60)", "os._exit(0)"])
def test_what_it_started_ends_with_it(tmp_path: Path, leave: str, then: str) -> None:
    note = tmp_path / "pid"
    act = FORKS.format(note=str(note), leave=leave, then=then)
    plant = opened(tmp_path, act, answer_s=2.0 if then == "time.sleep(60)" else PATIENCE_S)
    if then == "time.sleep(0.2)":
        stepped(plant, 4)
        guest_of(plant).close()
    else:
        with pytest.raises(PlantError):
            stepped(plant, 4)
    if pid := written(note, 0.5):  # it may have been ended before it said who
        assert gone(int(pid))
    plant.close()


def guest_of(plant: Operated) -> sandbox.SandboxProcess:
    found: sandbox.SandboxProcess = plant.adapter.plant.far.process  # type: ignore[attr-defined]
    return found


SERVICE = """
import os, sys, time
from pathlib import Path
from plant_service.adapters.registry import open_plant
from tests.adapters.test_isolated import FORKS, guest_of, scenario_of, stepped
folder = Path(sys.argv[1])
act = FORKS.format(note=str(folder / "pid"), leave="os.setsid()", then="pass")
plant = open_plant(scenario_of(folder, act), folder)
stepped(plant, 4)
print(guest_of(plant).child.pid, flush=True)
time.sleep(60)
"""


@pytest.mark.slow
def test_it_ends_with_a_service_that_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SERVICE, str(tmp_path)],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).resolve().parents[2],
    ) as service:
        assert service.stdout is not None
        supervisor, forked = int(service.stdout.readline()), int(written(tmp_path / "pid"))
        assert alive(supervisor)
        assert alive(forked)
        service.kill()
    assert gone(supervisor)
    assert gone(forked)


@pytest.mark.slow
def test_plants_one_after_the_other_share_a_process(tmp_path: Path) -> None:
    pids = set()
    for _ in range(3):
        plant = opened(tmp_path, "pass")
        assert stepped(plant, 2)[0] == stepped(open_plant(line()), 1)[0]
        pids.add(guest_of(plant).child.pid)
        plant.close()
    assert len(pids) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "why"),
    [
        ("raise RuntimeError('no')", "plant: line.py: cannot be loaded: RuntimeError: no"),
        ("import os; os._exit(1)", "plant: the process ended"),
        ("import time; time.sleep(60)", "plant: too slow: no answer within 1.5 s"),
    ],
)
def test_one_that_cannot_be_loaded_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: str, why: str
) -> None:
    if "time" in before:
        monkeypatch.setattr("plant_service.adapters.isolated.START_S", 1.5)
    scenario = scenario_of(tmp_path, "pass")
    (tmp_path / "line.py").write_text(before)
    with pytest.raises(PlantError) as error:
        open_plant(scenario, tmp_path)
    assert str(error.value) == why


def test_shipped_plants_run_in_the_services_process() -> None:
    shipped = [s for s in (line("runtime.scenarios.plants:Tank"), line()) if s.plant.shipped]  # type: ignore[attr-defined]
    assert len(shipped) == 1
    assert {k.__name__ for k in KINDS if not hasattr(k, "shipped")} == {"LinearPlant"}


def test_a_number_of_processes_is_its_bound(tmp_path: Path) -> None:
    if os.getuid() == 0:
        pytest.skip("root is not held to a number of processes")
    plant = opened(tmp_path, "[os.fork() for _ in range(12)]")
    with pytest.raises(PlantError):
        stepped(plant, 3)
