"""Fleets: their files, loops that fail alone, and too many of them."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest

from controller_service import command as controllers
from controller_service.laws.base import CandidateLaw
from protocol.messages import (
    LATENCY_BOUNDS_S,
    ControllerStatus,
    Offer,
    PlantStatus,
)
from protocol.topics import key_of
from runtime import end_service, host
from runtime.errors import DONE, UsageError
from runtime.fleet import read_fleet
from runtime.run_folder import (
    CONTROLLER_STATUS,
    CONTROLLER_TRACE,
    PLANT_JOURNAL,
    PLANT_STATUS,
    PLANT_TRACE,
)
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.recorded_pair import law_of
from tests.support.scenarios import text_of
from tests.support.statuses import read_status
from tests.support.traces import events_of
from wyner.cli.main import main

ONE = '[[loop]]\nid = "one"\nmessage = "m"\nseed = 1\n'
TWO = '[[loop]]\nid = "two"\nseed = 2\n'


# --- files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "loop: expected here"),
        ("loop = 3", "loop: got 3, expected a list"),
        ("x = 1\n" + ONE, "x: got 1, no such field"),
        ("[[loop]]\n", "loop.0.id: expected"),
        ('[[loop]]\nid = "a b"\n', "loop.0.id: got \"a b\", loop: got 'a b'"),
        ('[[loop]]\nid = "a"\nseed = -1\n', "loop.0.seed: got -1, "),
        ('[[loop]]\nid = "a"\ncolour = 1\n', "loop.0.colour: got 1, no such field"),
        ('[[loop]]\nid = "a"\nmessage = 3\n', "loop.0.message: got 3, expected a text"),
        (ONE + ONE, "an id for each of its own"),
        ("[[loop", "not TOML"),
    ],
)
def test_a_wrong_file_names_the_loop_and_the_field(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as error:
        read_fleet(path)
    assert said in str(error.value)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["plant", "--fleet", "0"], "--fleet: got 0"),
        (["plant", "--fleet", "2", "--loop", "a"], "--loop: is for a single loop"),
        (["plant", "--fleet", "2", "--steps", "5"], "--steps: a fleet runs until"),
        (["plant", "--fleet", "2", "--attack", "no@step"], "--attack: "),
        (["plant", "--fleet", "2", "--attack", "no@step", "--check"], "--attack: "),
        (["plant", "--fleet", "2", "--scenario", "nowhere"], "nowhere: no such file"),
        (["plant", "--fleet", "2", "--scenario", "pendulum"], "expected linear in a fleet"),
        (["controller", "--fleet", "nowhere.toml"], "nowhere.toml: cannot be read"),
    ],
)
def test_options_that_do_not_go_together(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*options, "--run-dir", str(tmp_path / "run")]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("wrong", [["--attack", "no@step"], []], ids=["attack", "scenario"])
def test_a_fleet_with_a_wrong_loop_starts_none(
    wrong: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(ONE if wrong else ONE + '[[loop]]\nid = "bad"\nscenario = "nowhere"\n')
    options = ["--fleet", str(path), *wrong, "--run-dir", str(tmp_path / "run")]
    assert main(["plant", *options]) == 2
    told = capsys.readouterr().err
    assert ("one: --attack: " if wrong else "bad: nowhere: no such file") in told
    assert not (tmp_path / "run").exists()


# --- hosts ----------------------------------------------------------------------------------------


class Hosts:
    """The command of the controllers and that of the plants, on hubs in memory."""

    def __init__(self, law: CandidateLaw, folder: Path, *options: str) -> None:
        self.law, self.folder, self.options = law, folder, options
        self.field, self.management = MemoryHub(), MemoryHub()
        self.codes: list[int] = []

    @contextmanager
    def running(self, pace: str, *of_controllers: str) -> Iterator[None]:
        stopping = threading.Event()

        @contextmanager
        def buses_of(*_: object) -> Iterator[tuple[MemoryBus, MemoryBus]]:
            yield MemoryBus(self.field), MemoryBus(self.management)

        def run(service: str, *more: str) -> None:
            common = [*self.options, "--run-dir", str(self.folder), "--pace", pace]
            self.codes.append(main([service, *common, *more]))

        threads = [
            threading.Thread(target=run, args=("controller", *of_controllers)),
            threading.Thread(target=run, args=("plant",)),
        ]
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(end_service, "buses_of", buses_of)
            patched.setattr(end_service, "stop_on_signals", lambda: nullcontext(stopping))
            patched.setattr(controllers, "designed", lambda _: self.law)
            for thread in threads:
                thread.start()
            try:
                yield
            finally:
                stopping.set()
                for thread in threads:
                    thread.join(PATIENCE_S)
                assert self.codes == [DONE, DONE]

    def status(self, loop: str) -> PlantStatus | None:
        try:
            return read_status(self.folder / loop / PLANT_STATUS, PlantStatus)
        except OSError:
            return None

    wait = staticmethod(wait_for)

    def delivered(self, loop: str) -> bool:
        status = self.status(loop)
        return status is not None and status.frame.messages > 0


@pytest.mark.slow
def test_every_loop_of_a_fleet_delivers_its_own_message_into_its_own_folder(
    sustained_law: CandidateLaw, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hosts = Hosts(sustained_law, tmp_path, "--fleet", "3", "--seed", "1")
    names = [f"loop-{number:04d}" for number in range(3)]
    with hosts.running("x10", "--message", "hi"):
        hosts.wait(lambda: all(map(hosts.delivered, names)))
        hosts.wait(lambda: main(["status", str(tmp_path)]) == 0)
        assert "3 of 3 loops without a warning" in capsys.readouterr().out
    sessions = set()
    for name in names:
        trace = tmp_path / name / PLANT_TRACE
        assert [e["payload"] for e in events_of(trace, "recovered")] == ["aGk="]
        sessions |= {e["session"] for e in events_of(trace, "transition")}
        status = hosts.status(name)
        assert status is not None
        assert len(status.timing.latency_counts) == len(LATENCY_BOUNDS_S) + 1
        assert sum(status.timing.latency_counts) > 0
    assert len(sessions) == 3
    capsys.readouterr()
    assert main(["check", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines[:3]] == names
    assert lines[3:] == ["3 of 3 loops PASS"]
    assert main(["check", "--json", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["passed"]
    assert [loop["failed"] for loop in told["loops"]] == [0, 0, 0]
    # one loop's plant traces a transition that never was: that loop fails, and no other
    path = tmp_path / names[1] / PLANT_TRACE
    path.write_bytes(path.read_bytes().replace(b'"coin":1', b'"coin":0'))
    assert main(["check", str(tmp_path)]) == 1
    assert "2 of 3 loops PASS" in capsys.readouterr().out


@pytest.mark.slow
def test_a_loop_that_cannot_run_harms_no_other(sustained_law: CandidateLaw, tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(TWO + ONE)
    journal = tmp_path / "run" / "two" / PLANT_JOURNAL
    journal.parent.mkdir(parents=True)
    journal.write_bytes(b"no journal" * 1000)
    hosts = Hosts(sustained_law, tmp_path / "run", "--fleet", str(path))
    with hosts.running("x20"):
        hosts.wait(lambda: hosts.delivered("one"))
    assert hosts.status("two") is None


ATTACK = """
from attacker_service.base import SensorAttack


class Heard(SensorAttack):
    name = "heard"
    knows = frozenset({"bus"})

    def sensor(self, observed):
        return observed.shown if observed.candidates is None else 0 * observed.shown + 0.01
"""


@pytest.mark.slow
def test_the_attack_of_a_loops_scenario_is_made_in_a_fleet_too(
    sustained_law: CandidateLaw, tmp_path: Path
) -> None:
    """It hears the bus of its own loop, and no other loop is attacked."""
    (tmp_path / "heard.py").write_text(ATTACK)
    attacked = tmp_path / "attacked.toml"
    table = f'\n[attack]\nkind = "{tmp_path}/heard.py:Heard"\nonset = 5\nknows = ["bus"]\n'
    attacked.write_text(text_of("sustained") + table)
    path = tmp_path / "fleet.toml"
    path.write_text(ONE + TWO + f'scenario = "{attacked}"\n')
    hosts = Hosts(sustained_law, tmp_path / "run", "--fleet", str(path))

    def reported(loop: str) -> bool:
        status = hosts.status(loop)
        return status is not None and status.step.k > 10

    with hosts.running("x20"):
        hosts.wait(lambda: reported("one") and reported("two"))
    traces = {loop: hosts.folder / loop / PLANT_TRACE for loop in ("one", "two")}
    assert not events_of(traces["one"], "attack")
    assert [event["onset"] for event in events_of(traces["two"], "attack")] == [5]
    assert any(set(e["x_next"]) == {0.01} for e in events_of(traces["two"], "transition"))


def test_an_interrupt_while_its_threads_are_started_stays_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A thread that was not started cannot be joined; that must not be what a program ends with."""

    def interrupted(_self: threading.Thread) -> None:
        raise KeyboardInterrupt

    running = host.Host(MemoryBus(MemoryHub()), MemoryBus(MemoryHub()), threading.Event())
    running.subscribe(Offer, key_of(Offer, "loop"))
    monkeypatch.setattr(threading.Thread, "start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        running.run()


@pytest.mark.long
def test_every_loop_of_a_fleet_has_a_keyed_coin_after_its_first_block(tmp_path: Path) -> None:
    """In version 1.0.0 no key of a fleet ever served, and its status named the defence."""
    watched = law_of("watched")[1]
    hosts = Hosts(watched, tmp_path, "--fleet", "20", "--scenario", "watched", "--seed", "1")
    names = [f"loop-{number:04d}" for number in range(20)]
    steps = 10

    def keyed(name: str) -> bool:
        path = tmp_path / name / CONTROLLER_STATUS
        return path.exists() and read_status(path, ControllerStatus).alarms.watched >= steps

    with hosts.running("realtime"):
        hosts.wait(lambda: all(map(keyed, names)))
    for name in names:
        trace = tmp_path / name / CONTROLLER_TRACE
        served = [e["k"] for e in events_of(trace, "transition") if e.get("keyed")]
        after = [e["k"] for e in events_of(trace, "transition") if e["k"] >= served[0]]
        assert served == after
        assert not events_of(trace, "alarm")
