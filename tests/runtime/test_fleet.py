"""Fleets: their files, loops that fail alone, and too many of them."""

import argparse
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from controller_service.command import ControllerOptions
from controller_service.laws.base import CandidateLaw
from controller_service.service import run_controllers
from plant_service.service import run_plants
from protocol.link.effects import Effects
from protocol.link.endpoint import Endpoint
from protocol.messages import (
    LATENCY_BOUNDS_S,
    ControllerStatus,
    Message,
    Offer,
    PlantStatus,
    SendCommand,
)
from protocol.topics import key_of
from runtime import host
from runtime.bus_options import add_service_arguments, fleet_of
from runtime.errors import DONE, UsageError
from runtime.fleet import Fleet, numbered, read_fleet
from runtime.health import read_status
from runtime.options import message_of, picked
from runtime.pace import Pace
from runtime.ports import Files
from runtime.recording import Bounds
from runtime.run_folder import (
    CONTROLLER_STATUS,
    CONTROLLER_TRACE,
    PLANT_JOURNAL,
    PLANT_STATUS,
    PLANT_TRACE,
)
from runtime.shipped import SCENARIOS
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.recorded_pair import law_of
from tests.support.traces import read_trace
from wyner.cli.main import main

ONE = '[[loop]]\nid = "one"\nmessage = "m"\nseed = 1\n'
TWO = '[[loop]]\nid = "two"\nseed = 2\n'


# --- files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "loop: expected at least one table"),
        ("loop = 3", "loop: expected at least one table"),
        ("x = 1\n" + ONE, "x: expected tables"),
        ("[[loop]]\n", "loop 1: id: expected"),
        ('[[loop]]\nid = "a b"\n', "loop 1: id: loop: got 'a b'"),
        ('[[loop]]\nid = "a"\nseed = -1\n', "loop 1: seed: "),
        ('[[loop]]\nid = "a"\ncolour = 1\n', "loop 1: colour: "),
        (ONE + ONE, "loop 2: id: 'one' is there already"),
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
        (["plant", "--loops", "0"], "--loops: got 0"),
        (["plant", "--loops", "2", "--loop", "a"], "--loop: is for a single loop"),
        (["plant", "--loops", "2", "--steps", "5"], "--steps: a fleet runs until"),
        (["controller", "--fleet", "nowhere.toml"], "nowhere.toml: cannot be read"),
    ],
)
def test_options_that_do_not_go_together(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*options, "--run-dir", str(tmp_path / "run")]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("service", ["controller", "plant"])
def test_a_check_reads_the_scenario_of_every_loop_and_its_files_of_delays(
    service: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It looked at the scenario of a single loop, which a fleet does not have."""
    (tmp_path / "delays.txt").write_text("0.01\nlate\n")
    delayed = tmp_path / "delayed.toml"
    network = '[network]\nto_plant = { delay = "measured", file = "delays.txt" }\n'
    delayed.write_text((SCENARIOS / "sustained.toml").read_text() + network)
    rows = {"one": "sustained", "two": str(delayed), "three": "nowhere", "four": str(delayed)}
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(
        "".join(f'[[loop]]\nid = "{name}"\nscenario = "{at}"\n' for name, at in rows.items())
    )
    asked = [service, "--fleet", str(fleet), "--check", "--run-dir", str(tmp_path / "run")]
    assert main(asked) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "two: network: " in lines[0]
    assert "delay 2: got late, expected seconds" in lines[0]
    assert "three: " in lines[1]
    assert "nowhere" in lines[1]
    (tmp_path / "delays.txt").write_text("0.01\n")
    fleet.write_text(ONE)
    assert main(asked) == 0
    assert main([service, "--loops", "3", "--scenario", str(delayed), "--check"]) == 0
    assert main([service, "--loops", "3", "--scenario", "nowhere", "--check"]) == 2
    assert "loop-" not in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("option", ["--message", "--message-file"])
def test_each_loop_of_a_number_has_the_message_that_was_given(tmp_path: Path, option: str) -> None:
    """``wyner`` itself takes the text off its command line, and hands it on as a file."""
    given = tmp_path / "text"
    given.write_bytes("zwölf".encode() + b"\xff")
    value = str(given) if option == "--message-file" else "zwölf"
    parser = argparse.ArgumentParser()
    add_service_arguments(parser, "controller", ControllerOptions)
    args = parser.parse_args(["--loops", "2", option, value])
    options = picked(ControllerOptions, vars(args))
    fleet = fleet_of(options, message_of(options.message, options.message_file))
    assert fleet is not None
    expected = given.read_bytes() if option == "--message-file" else value.encode()
    assert [loop.payload for loop in fleet.loops.values()] == [expected] * 2


# --- hosts ----------------------------------------------------------------------------------------


class Hosts:
    """A host of controllers and one of plants on hubs in memory."""

    def __init__(self, fleet: Callable[[], Fleet], law: CandidateLaw, folder: Path) -> None:
        self.fleet, self.law, self.folder = fleet, law, folder
        self.field, self.management = MemoryHub(), MemoryHub()
        self.codes: list[int] = []

    @contextmanager
    def running(self, pace: str) -> Iterator[None]:
        stopping = threading.Event()

        def controllers() -> None:
            rest = Bounds(), Pace(pace), MemoryBus(self.field), MemoryBus(self.management), stopping
            self.codes.append(run_controllers(self.fleet(), self.folder, lambda _: self.law, *rest))

        def plants() -> None:
            rest = Bounds(), MemoryBus(self.field), MemoryBus(self.management), stopping
            self.codes.append(run_plants(self.fleet(), self.folder, Pace(pace), *rest))

        threads = [threading.Thread(target=one) for one in (controllers, plants)]
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
        return status is not None and status.messages > 0


@pytest.mark.slow
def test_every_loop_of_a_fleet_delivers_its_own_message_into_its_own_folder(
    sustained_law: CandidateLaw, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hosts = Hosts(lambda: numbered(3, "sustained", "hi", seed=1), sustained_law, tmp_path)
    names = list(hosts.fleet().loops)
    with hosts.running("x10"):
        hosts.wait(lambda: all(map(hosts.delivered, names)))
        hosts.wait(lambda: main(["status", str(tmp_path), "--healthy", "plant"]) == 0)
        assert "plant advances on all 3 loops" in capsys.readouterr().out
    assert main(["status", str(tmp_path), "--healthy", "plant", "--within", "1"]) == 1
    assert "3 of 3 loops do not advance" in capsys.readouterr().err
    sessions = set()
    for name in names:
        trace = read_trace(tmp_path / name / PLANT_TRACE)
        assert [e["payload"] for e in trace.of("recovered")] == ["aGk="]
        sessions |= {e["session"] for e in trace.of("transition")}
        status = hosts.status(name)
        assert status is not None
        assert len(status.latency_counts) == len(LATENCY_BOUNDS_S) + 1
        assert sum(status.latency_counts) > 0
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
    path.write_text(TWO + ONE + '[[loop]]\nid = "bad"\nscenario = "nowhere"\n')
    journal = tmp_path / "run" / "two" / PLANT_JOURNAL
    journal.parent.mkdir(parents=True)
    journal.write_bytes(b"no journal" * 1000)
    hosts = Hosts(lambda: read_fleet(path), sustained_law, tmp_path / "run")
    with hosts.running("x20"):
        hosts.wait(lambda: hosts.delivered("one"))
    assert hosts.status("two") is None


class Overloaded:
    """An end that is always due, and that is told of commands."""

    hears: tuple[type[Message], ...] = (SendCommand,)
    says: tuple[type[Message], ...] = ()
    makes_keys = False
    code = None

    def __init__(self) -> None:
        self.commands = self.wakes = 0

    def start(self, _now: float) -> Effects:
        return ()

    def wake_at(self) -> float:
        return -inf

    def wake(self, _now: float) -> Effects:
        self.wakes += 1
        time.sleep(0.001)
        return ()

    def receive(self, *_: object) -> Effects:
        self.commands += 1
        return ()

    def stop(self, _now: float) -> Effects:
        return ()


def test_an_end_that_is_always_due_is_told_of_commands_and_stops() -> None:
    hub = MemoryHub()
    stopping = threading.Event()
    end = Overloaded()
    running = host.Host(MemoryBus(MemoryHub()), MemoryBus(hub), stopping)
    files = SimpleNamespace(health=Path("status.json"), close=lambda: None)
    running.add("loop", cast("Endpoint", end), cast("Files", files), logging.getLogger("overload"))
    thread = threading.Thread(target=running.run)
    thread.start()
    publisher = MemoryBus(hub).publisher(key_of(SendCommand, "loop"))
    try:
        for _ in range(20):
            publisher.put(b"a command")
        wait_for(lambda: end.commands == 20)
        assert end.wakes > 0
    finally:
        stopping.set()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


class Slow:
    """A law that takes its time, as long as it is told to."""

    def __init__(self, law: CandidateLaw) -> None:
        self.seconds = 0.0
        self._law = law

    def __getattr__(self, name: str) -> object:
        return getattr(self._law, name)

    def candidates(self, x: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
        time.sleep(self.seconds)
        return self._law.candidates(x)


@pytest.mark.slow
def test_twice_too_much_is_missed_evenly_and_nothing_is_missed_afterwards(
    sustained_law: CandidateLaw, tmp_path: Path
) -> None:
    """Ten loops at 20 Hz ask a controller that can answer a hundred times a second."""
    law = Slow(sustained_law)
    hosts = Hosts(lambda: numbered(10, "sustained", seed=1), cast("CandidateLaw", law), tmp_path)
    names = list(hosts.fleet().loops)

    def counts() -> list[tuple[int, int]]:
        found = [hosts.status(name) for name in names]
        return [(s.transitions, s.missed) for s in found if s is not None]

    with hosts.running("x2"):
        hosts.wait(lambda: len(counts()) == 10 and all(made > 5 for made, _ in counts()))
        law.seconds = 0.01
        time.sleep(1.0)

        def shared_evenly() -> bool:
            """There is an overload, nothing collapsed, and no loop starves."""
            before = counts()
            time.sleep(6.0)  # a status is written once a second; a short window counts its lateness
            after = counts()
            made = [b[0] - a[0] for a, b in zip(before, after, strict=True)]
            missed = [b[1] - a[1] for a, b in zip(before, after, strict=True)]
            whole = sum(made) + sum(missed)
            alike = min(made) > 0.2 * sum(made) / len(made)
            return sum(missed) > 0 and sum(made) > 0.15 * whole and alike

        def calm() -> bool:
            before = [missed for _, missed in counts()]
            time.sleep(1.2)
            return [missed for _, missed in counts()] == before

        # what else runs here may disturb one look; a collapse never ends
        hosts.wait(shared_evenly)
        law.seconds = 0.0
        hosts.wait(calm)


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
    hosts = Hosts(lambda: numbered(20, "watched", seed=1), watched, tmp_path)
    names = list(hosts.fleet().loops)
    steps = 10

    def keyed(name: str) -> bool:
        path = tmp_path / name / CONTROLLER_STATUS
        return path.exists() and read_status(path, ControllerStatus).watched >= steps

    with hosts.running("realtime"):
        hosts.wait(lambda: all(map(keyed, names)))
    for name in names:
        trace = read_trace(tmp_path / name / CONTROLLER_TRACE)
        served = [e["k"] for e in trace.of("transition") if e.get("keyed")]
        after = [e["k"] for e in trace.of("transition") if e["k"] >= served[0]]
        assert served == after
        assert not list(trace.of("alarm"))
