"""The pages "How to add ..." are true: their programs run as they stand."""

import json
import os
import re
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import pytest

from plant_service.adapters.base import stepped
from protocol.messages import Measurement
from protocol.registry import load_file
from protocol.runtime.endpoints import free_endpoints
from protocol.runtime.zenoh_bus import ZenohBus
from protocol.scenario import load_scenario
from protocol.schemes.base import Scheme
from protocol.schemes.registry import SCHEMES
from protocol.topics import DEFAULT_LOOP, key_of
from tap_service.capture.transcript import Transcript
from tap_service.eavesdroppers import named
from tests.support.small_run import SmallRun
from wyner.cli.main import main
from wyner.studies.secrecy.runs import simulate

PAGES = Path(__file__).resolve().parents[2] / "docs" / "howto"


def program(page: str, folder: Path, name: str, language: str = "python") -> Path:
    """The page's first program, or other text, written to a file."""
    found = re.search(
        rf"^```{language}\n(.*?)^```$", (PAGES / page).read_text(), re.DOTALL | re.MULTILINE
    )
    assert found is not None
    path = folder / name
    path.write_text(found[1])
    return path


def test_the_scheme_of_the_page_carries_a_message_and_passes_the_check(tmp_path: Path) -> None:
    name = f"{program('scheme.md', tmp_path, 'pairs.py')}:Pairs"
    scheme = SCHEMES[name](2)
    assert isinstance(scheme, Scheme)
    state, pads = scheme.initial, []
    for verdict in (1, -1, 0, 1, 1, 0):
        assert scheme.advance(state, verdict)[1].pad == scheme.pad(state)
        state, carry = scheme.advance(state, verdict)
        pads.append(carry.pad)
    assert pads == [-1, -1, -1, 1, 0, -1]
    run = SmallRun(
        tmp_path / "run",
        (b"two by two",),
        changes=(("[secrecy]\n", f'[secrecy]\nscheme = "{name}"\n'),),
    )
    run.until_received(1)
    run.close()
    assert main(["check", str(tmp_path / "run")]) == 0


def test_the_eavesdropper_of_the_page_reads_the_message(tmp_path: Path) -> None:
    name = f"{program('eavesdropper.md', tmp_path, 'near.py')}:Near"
    run = simulate(1200, 5)
    tap, transcript = named(name)(run.scenario.knowledge()), Transcript()
    right = 0
    for transition in (t for m in run.messages for t in transcript.hear(m)):
        guess = tap.observe(transition)
        right += run.truth.keys.get((transition.session, transition.k)) == guess.best
    assert right == len(run.truth.keys) > 100
    assert len(tap.belief().symbols) > 50


def test_the_plant_of_the_page_moves(tmp_path: Path) -> None:
    program("plant.md", tmp_path, "room.py")
    room = stepped(load_file(tmp_path / "room.py").Room(), "room.py:Room")
    assert room.reset(None) == (20.0,)
    assert room.step((5.0,), 10.0) == pytest.approx((29.5,))


def test_the_scenario_of_the_plant_is_designed_and_its_model_is_the_room(tmp_path: Path) -> None:
    program("plant.md", tmp_path, "room.py")
    path = program("plant.md", tmp_path, "room.toml", "toml")
    assert main(["design", str(path)]) == 0
    scenario = load_scenario(path)
    point = scenario.plant.operating_point
    assert point is not None
    assert point.state is not None
    assert point.input is not None
    (at,), (rest,) = point.state, point.input
    room = stepped(load_file(tmp_path / "room.py").Room(), "room.py:Room")
    x = room.reset(None)[0] - at
    for u in (0.3, -0.3, 0.1):
        (t,) = room.step((rest + u,), scenario.plant.period_s)
        x = scenario.A[0][0] * x + scenario.B[0][0] * u
        assert t - at == pytest.approx(x)


def test_the_service_of_the_page_hears_what_the_plant_publishes(tmp_path: Path) -> None:
    text = textwrap.dedent("\n".join((PAGES / "service.md").read_text().split("\n   ")))
    blocks = re.findall(r"```python\n(.*?)\n```", text, re.DOTALL)
    package = tmp_path / "logger_service"
    package.mkdir()
    for name, block in zip(("row", "__init__", "command", "__main__"), blocks, strict=True):
        (package / f"{name}.py").write_text(block + "\n")
    (end,) = free_endpoints(1)
    measurement = Measurement(
        session="0" * 16, k=3, x=(1.0,), applied_k=2, x_after=(1.0,), copy_number=0
    )
    with (
        ZenohBus(listen=[end]) as field,
        subprocess.Popen(
            [sys.executable, "-m", "logger_service", "--connect", f"field={end}"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(PAGES.parents[1])},
            stdout=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        publisher = field.publisher(key_of(Measurement, DEFAULT_LOOP))
        assert process.stdout is not None
        lines: list[str] = []
        read = process.stdout.readline
        ready = threading.Thread(target=lambda: lines.append(read()), daemon=True)
        ready.start()
        while ready.is_alive():
            assert process.poll() is None
            publisher.put(measurement.wire())
            ready.join(0.1)
        assert json.loads(lines[0])["k"] == 3
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0


def test_a_start_beside_the_plants_own_is_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = program("plant.md", tmp_path, "room.toml", "toml")
    path.write_text(path.read_text().replace("period_s", "initial_state = [-1.0]\nperiod_s"))
    assert main(["design", str(path)]) == 2
    told = capsys.readouterr().err
    assert "plant.initial_state: got [-1.0], expected none: a plant of this kind begins" in told


def test_the_page_of_a_runs_folder_names_every_event_and_each_of_its_fields(
    tmp_path: Path,
) -> None:
    page = (PAGES / "run-folder.md").read_text()
    told = {
        name: row
        for row in page.splitlines()
        if row.startswith("| `")
        for name in re.findall(r"`(\w+)`", row.split("|")[1])
    }
    run = SmallRun(tmp_path / "run", (b"two by two",))
    run.until_received(1)
    run.close()
    events = [
        json.loads(line)
        for side in ("plant", "controller")
        for line in (tmp_path / "run" / side / "trace.jsonl").read_text().splitlines()
    ]
    seen = {event["event"] for event in events}
    assert {"transition", "session", "sent", "recovered", "end"} <= seen
    for event in events:
        if event["event"] != "header":
            for field in set(event) - {"event"}:
                assert f"`{field}`" in told[event["event"]], (event["event"], field)
    code = (PAGES.parents[1] / "protocol" / "link").rglob("*.py")
    named = {name for f in code for name in re.findall(r'"event": "(\w+)"', f.read_text())}
    assert len(named) > 8
    assert named <= set(told)


@pytest.mark.parametrize("page", sorted(PAGES.glob("*.md")), ids=lambda page: page.stem)
def test_a_page_names_what_is_there(page: Path) -> None:
    root = PAGES.parents[1]
    for target in re.findall(
        r"`((?:protocol|controller_service|plant_service|tap_service|wyner|tests)/[\w/]*\.?\w+/?)`",
        page.read_text(),
    ):
        assert (root / target).exists(), target
