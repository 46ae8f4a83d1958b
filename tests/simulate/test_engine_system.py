"""Engine, single-process simulation and live services: one system, step for step."""

import base64
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic_core import to_json

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.scenario import Scenario
from protocol.schemes.framing import frame_length
from protocol.schemes.switched import MESSAGE, TEST
from runtime.recording import TraceReader, TraceWriter
from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from runtime.scenario_file import load_scenario
from tests.support.plain_loop import plain_run
from tests.support.size import size
from wyner.runs.run import Run
from wyner.runs.score.replay import Replay
from wyner.runs.score.score import read_truth, score
from wyner.simulate.engine import Runs, Transfer, simulate_runs, transfer
from wyner.simulate.faults import Faults
from wyner.simulate.network import Simulation

ROOT = Path(__file__).resolve().parents[2]
TEXT = b"Meet me where the river bends, at the second lamp after the bridge."
WINDOW = 1000

Event = dict[str, Any]


@cache
def system(name: str) -> tuple[Scenario, CandidateLaw]:
    scenario = load_scenario(ROOT / "runtime" / "scenarios" / f"{name}.toml")
    return scenario, make_law(scenario, cached_design(scenario))


@dataclass(frozen=True)
class Case:
    """One run of one system. The services take the streams of run 0."""

    name: str
    steps: int
    seed: int
    run: int = 0
    payload: bytes = TEXT

    @cached_property
    def engine(self) -> tuple[Runs, Transfer]:
        runs = simulate_runs(
            *system(self.name),
            seed=self.seed,
            runs=range(self.run, self.run + 1),
            steps=self.steps,
            record=True,
        )
        return runs, transfer(runs, payloads=[self.payload])

    def delivered(self) -> list[bytes]:
        """The messages that arrive, as the engine says."""
        size = system(self.name)[0].secrecy.candidates
        arrives = self.engine[1].p[-1, 0] >= frame_length(len(self.payload), size)
        return [self.payload] if arrives else []


# --- three ways to the same events ---------------------------------------------------------------


def engine_events(case: Case) -> Iterator[Event]:
    """The engine's run as the transitions of a plant's trace, but for the session."""
    runs, t = case.engine
    assert runs.x is not None
    assert runs.candidates is not None
    assert runs.gauges is not None
    x = runs.x[:, :, 0].tolist()
    candidates = runs.candidates[..., 0].tolist()
    gauges = runs.gauges[..., 0].tolist()
    coin = runs.coin[:, 0].tolist()
    cipher, agreed, pad, message_symbol, p = (
        column[:, 0].tolist() for column in (t.cipher, t.agreed, t.pad, t.message_symbol, t.p)
    )
    for j in range(case.steps):
        yield {
            "event": "transition",
            "j": j,
            "k": j,
            "x": x[j],
            "candidates": candidates[j],
            "cipher": cipher[j],
            "x_next": x[j + 1],
            "role": "test" if pad[j] == NO_SYMBOL else "message",
            "gauges": gauges[j],
            "symbol": agreed[j],
            "key": pad[j],
            "message_symbol": message_symbol[j],
            "p": p[j],
            "s": TEST if agreed[j] == NO_SYMBOL else MESSAGE,
            "counts": 0,
            "coin": coin[j],
            "u": candidates[j][coin[j]],
        }


def simulate(case: Case, folder: Path, faults: Faults | None = None) -> Path:
    """Simulate, and leave both traces as the services would; a window at a time in memory."""
    scenario, law = system(case.name)
    simulation = Simulation(
        scenario, law, seed=case.seed, run=case.run, payloads=(case.payload,), faults=faults
    )
    history = simulation.history
    plant = TraceWriter(folder / PLANT_TRACE, "plant", {"scenario": case.name})
    controller = TraceWriter(folder / CONTROLLER_TRACE, "controller", {"scenario": case.name})
    for first in range(0, case.steps, WINDOW):
        simulation.run(steps=min(first + WINDOW, case.steps))
        simulation.run(until=lambda: len(history.controller) >= len(history.plant))
        for transition in history.plant.values():
            plant.write(transition.as_event())
        for transition in history.controller.values():
            controller.write(transition.as_event())
        for kept in (history.plant, history.controller, history.offered):
            kept.clear()
    for payload in history.inbox:
        plant.write({"event": "recovered", "payload": base64.b64encode(payload).decode()})
    for number in history.delivered:
        text = base64.b64encode((case.payload,)[number]).decode()
        controller.write({"event": "delivered", "payload": text})
    plant.close()
    controller.close()
    return folder


@contextmanager
def live(case: Case, folder: Path) -> Iterator[None]:
    """The three services as processes over Zenoh on loopback, while the caller does other work."""
    log = folder.with_suffix(".log")
    command = [
        sys.executable,
        "-m",
        "wyner.cli.main",
        "up",
        "--scenario",
        case.name,
        "--message",
        case.payload.decode(),
        "--seed",
        str(case.seed),
        "--pace",
        "fast",
        "--steps",
        str(case.steps),
        "--headless",
        "--eavesdropper",
        "nearest-centre",
        "--run-dir",
        str(folder),
    ]
    with log.open("wb") as out, subprocess.Popen(command, stdout=out, stderr=out) as process:
        try:
            yield
            assert process.wait() == 0, log.read_text()
        finally:
            process.kill()  # the services end with it


# --- the comparison ------------------------------------------------------------------------------


def events(path: Path, kind: str) -> Iterator[Event]:
    return (event for event in TraceReader(path) if event["event"] == kind)


def same(mine: Event, theirs: Event) -> None:
    """Equal in every field, and no zero of the other sign: the same bits."""
    if to_json(mine) != to_json(theirs):
        assert mine == theirs
        raise AssertionError(f"a zero of the other sign: {mine}, {theirs}")


def compare(case: Case, folder: Path) -> None:
    """Both ends' traces and messages below ``folder`` against the engine.

    A service's controller may lack the last transition: the plant waits a second, no longer, for
    its last report to be heard.
    """
    controller = events(folder / CONTROLLER_TRACE, "transition")
    plant = events(folder / PLANT_TRACE, "transition")
    for mine, at_plant in zip(engine_events(case), plant, strict=True):
        session = at_plant.pop("session")
        same(mine, at_plant)
        at_controller = next(controller, None)
        if at_controller is None:
            assert mine["j"] == case.steps - 1
            break
        assert at_controller.pop("session") == session
        del mine["coin"], mine["u"]
        same(mine, at_controller)
    assert not any(controller)
    for trace, kind in ((PLANT_TRACE, "recovered"), (CONTROLLER_TRACE, "delivered")):
        payloads = [base64.b64decode(e["payload"]) for e in events(folder / trace, kind)]
        assert payloads == case.delivered()


def compare_all(case: Case, folder: Path) -> None:
    """Simulation and live services against the engine, while a tap hears and mirrors them all."""
    with live(case, folder / "live"):
        compare(case, simulate(case, folder / "simulated"))
    compare(case, folder / "live")
    # On a busy machine she leaves some out while it goes on; her recording has all of them.
    replay = Replay(folder / "live", ("nearest-centre",))
    replay.run()
    (said,) = replay.outputs()
    share = score(read_truth(Run.load(folder / "live")), said).keys.share
    assert share is not None
    assert share > 0.99


# --- the tests -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "case",
    [
        Case("paper", 1500, seed=11),
        Case("sustained", 3000, seed=11, run=4),
        Case("quadruple-tank", 300, seed=11, run=1),
        Case("packed", 1500, seed=11, run=2),
        Case("packed-quadruple-tank", 300, seed=11, run=1),
    ],
    ids=lambda case: case.name,
)
def test_simulation_and_engine_are_one_system(case: Case, tmp_path: Path) -> None:
    compare(case, simulate(case, tmp_path))


def test_a_faulty_network_changes_nothing_that_the_engine_says(tmp_path: Path) -> None:
    # In lock-step a lost message is repeated until it arrives: the same transitions all the same.
    case = Case("sustained", 400, seed=5)
    compare(case, simulate(case, tmp_path, Faults(loss=0.2, repeat=0.2, delay_s=0.3)))


@pytest.mark.long
@pytest.mark.integration
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "case",
    [
        # Under the paper's own law the candidates coincide after ten steps: fewer are enough.
        Case("paper", size(500, 10_000), seed=2),
        Case(
            "sustained",
            size(1500, 100_000),
            seed=2,
            payload=size(TEXT[:24], 36 * TEXT),
        ),
        Case(
            "quadruple-tank",
            size(700, 20_000),
            seed=2,
            payload=size(TEXT[:8], 6 * TEXT),
        ),
        Case("packed", 1000, seed=21),
    ],
    ids=lambda case: case.name,
)
def test_live_services_simulation_and_engine_are_one_system(case: Case, tmp_path: Path) -> None:
    assert case.delivered() == ([] if case.name == "paper" else [case.payload])
    compare_all(case, tmp_path)
    shutil.rmtree(tmp_path)  # 200 MB of traces, which pytest would keep


@pytest.mark.long
def test_the_plain_way_comes_to_the_same_verdicts() -> None:
    # OSQP and the linear programs are another road to the same sets: an independent oracle.
    scenario, law = system("sustained")
    plain_symbols = plain_run(scenario, law.design, seed=7, run=3, steps=120).symbols
    runs = simulate_runs(scenario, law, seed=7, runs=range(3, 4), steps=120)
    possible = runs.largest[:, 0] <= scenario.secrecy.alpha
    assert plain_symbols == np.where(possible, runs.symbol[:, 0], -1).tolist()
    assert len(set(plain_symbols)) == 3
