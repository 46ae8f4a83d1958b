"""The guides are true: their programs run as they stand."""

import json
import os
import re
import shutil
import signal
import subprocess
import threading
from pathlib import Path

import pytest

from attacker_service.attacks import ATTACKS
from plant_service.adapters.base import stepped
from protocol.messages import Measurement
from protocol.plugins import module_at
from protocol.scenario import PLANTS
from protocol.schemes.base import Scheme
from protocol.schemes.registry import make_scheme
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.addresses import free_endpoints
from runtime.recording import MARKS
from runtime.scenario_file import load_scenario
from runtime.zenoh_bus import ZenohBus
from studies.secrecy.runs import simulate
from tap_service.capture.transcript import Transcript
from tap_service.eavesdroppers import LADDER, named
from tests.support.programs import ROOT, started
from tests.support.recorded_pair import RecordedPair, read_lines
from tests.support.scenarios import text_of
from wyner.cli.main import main

GUIDES = (ROOT / "docs" / "guides.md").read_text(encoding="utf-8")
EXAMPLES = ROOT / "examples"


def guide(title: str) -> str:
    """The part of the page under one of its headings."""
    _, found, rest = GUIDES.partition(f"\n## {title}\n")
    assert found, title
    return rest.partition("\n## ")[0]


def program(title: str, folder: Path, name: str) -> Path:
    """The program that the guide names, beside the run."""
    assert f"examples/own/{name}" in guide(title)
    return Path(shutil.copy(EXAMPLES / "own" / name, folder))


@pytest.mark.parametrize(
    ("title", "shipped"),
    [
        ("A plant of your own", PLANTS),
        ("Eavesdroppers", LADDER),
        ("Attacks", ATTACKS),
    ],
)
def test_the_tables_have_a_row_for_each_that_is_shipped(title: str, shipped: list[str]) -> None:
    rows = re.findall(r"^\| `([\w-]+)` \|", guide(title), re.MULTILINE)
    assert sorted(rows) == sorted(shipped), f"docs/guides.md, {title}: a row for each"


@pytest.mark.slow
@pytest.mark.integration
def test_the_attack_of_the_page_runs_live(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = program("Attacks", tmp_path, "frozen.py")
    run = tmp_path / "run"
    said = ["up", "--scenario", "packed", "--attack", f"{name}:Frozen@30", "--steps", "60"]
    assert main([*said, "--pace", "fast", "--json", "--run-dir", str(run)]) == 0
    attack = json.loads(capsys.readouterr().out)["attack"]
    assert (attack["kind"], attack["at"], attack["onset"]) == (f"{name}:Frozen", "sensor", 30)
    assert attack["failed"] == ""
    assert attack["away_most"] >= attack["away"] >= 0
    assert attack["away_most"] > 0.01
    assert main(["check", str(run)]) == 0
    assert main(["report", str(run)]) == 0
    assert "x1 in truth" in (run / "report.html").read_text()


def test_the_tables_of_the_page_make_an_attack_on_a_scenario_visible(tmp_path: Path) -> None:
    blocks = re.findall(r"^```toml\n(.*?)^```$", guide("Attacks"), re.DOTALL | re.MULTILINE)
    own = tmp_path / "own.toml"
    own.write_text(text_of("packed") + "\n".join(blocks))
    scenario = load_scenario(own)
    assert scenario.attack is not None
    assert scenario.keys is not None
    assert scenario.keys.refusal() is None
    assert (scenario.defence.coin, scenario.tap.loss) == ("keys", scenario.keys.eps_E)


def test_the_scheme_of_the_page_carries_a_message_and_passes_the_check(tmp_path: Path) -> None:
    name = f"{program('A scheme of your own', tmp_path, 'pairs.py')}:Pairs"
    scheme = make_scheme(name, 2)
    assert isinstance(scheme, Scheme)
    state, pads = scheme.initial, []
    for verdict in (1, -1, 0, 1, 1, 0):
        assert scheme.advance(state, verdict)[1].pad == scheme.pad(state)
        state, carry = scheme.advance(state, verdict)
        pads.append(carry.pad)
    assert pads == [-1, -1, -1, 1, 0, -1]
    run = RecordedPair(
        tmp_path / "run",
        b"two by two",
        changes=(("[secrecy]\n", f'[secrecy]\nscheme = "{name}"\n'),),
    )
    run.until_received(1)
    run.stop()
    assert main(["check", str(tmp_path / "run")]) == 0


@pytest.mark.slow
@pytest.mark.integration
def test_the_law_of_the_page_runs_in_every_process_and_passes_the_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    title = "A control law of your own"
    program(title, tmp_path, "nearer.py")
    (stated,) = re.findall(r"^```toml\n\[control\]\n(.*?)^```$", guide(title), re.DOTALL | re.M)
    text = text_of(
        "sustained",
        ("horizon = 250", "horizon = 60"),
        ("initial_state = [4.0, -2.0]", "initial_state = [0.5, -0.2]"),
        ('law = "sustained"\n', stated.replace("examples/own/nearer.py", "nearer.py")),
    )
    (tmp_path / "own.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    assert main(["design", "own.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["law"] == "nearer.py:Nearer"
    up = ["up", "--scenario", "own.toml", "--pace", "fast", "--run-dir", "run"]
    assert main([*up, "--message", "Hi", "--until-delivered"]) == 0
    assert main(["check", "run"]) == 0
    assert "PASS  admissible" in capsys.readouterr().out


def test_the_eavesdropper_of_the_page_reads_the_message(tmp_path: Path) -> None:
    name = f"{program('Eavesdroppers', tmp_path, 'near.py')}:Near"
    run = simulate(1200, 5)
    tap, transcript = named(name)(run.scenario.knowledge()), Transcript()
    right = 0
    for transition in (t for m in run.messages for t in transcript.hear(m)):
        guess = tap.observe(transition)
        right += run.truth.keys.get((transition.session, transition.k)) == guess.best
    assert right == len(run.truth.keys) > 100
    assert len(tap.message_symbols()) > 50


def test_the_scenario_of_the_plant_is_designed_and_its_model_is_the_room(tmp_path: Path) -> None:
    path = shutil.copytree(EXAMPLES / "room", tmp_path / "room") / "room.toml"
    assert main(["design", str(path)]) == 0
    scenario = load_scenario(path)
    point = scenario.plant.operating_point
    assert point is not None
    assert point.state is not None
    assert point.input is not None
    (at,), (rest,) = point.state, point.input
    room = stepped(module_at("room.py", path.parent)[0].Room(), "room.py:Room")
    x = room.reset(None)[0] - at
    for u in (0.3, -0.3, 0.1):
        (t,) = room.step((rest + u,), scenario.plant.period_s)
        x = scenario.A[0][0] * x + scenario.B[0][0] * u
        assert t - at == pytest.approx(x)


def test_the_service_of_the_page_hears_what_the_plant_publishes(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "logger_service", tmp_path / "logger_service")
    (end,) = free_endpoints(1)
    measurement = Measurement(
        session="0" * 16, k=3, x=(1.0,), applied_k=2, x_after=(1.0,), copy_number=0
    )
    with (
        ZenohBus(listen=[end]) as field,
        started(
            *("-m", "logger_service", "--connect", f"field={end}"),
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
        ) as process,
    ):
        publisher = field.publisher(key_of(Measurement, DEFAULT_LOOP))
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


def test_the_page_of_a_runs_folder_names_every_event_and_each_of_its_fields(
    tmp_path: Path,
) -> None:
    rows = [row for row in guide("A run's folder").splitlines() if row.startswith("| `")]
    told = {name: row for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    run = RecordedPair(tmp_path / "run", b"two by two")
    run.until_received(1)
    run.stop()
    for trace in (tmp_path / "run").glob("*/trace.jsonl"):
        for event in read_lines(trace):
            if (name := event.pop("event")) not in MARKS:
                assert all(f"`{field}`" in told[name] for field in event), name
    code = (ROOT / "protocol" / "link").rglob("*.py")
    named = {name for f in code for name in re.findall(r'"event": "(\w+)"', f.read_text())}
    assert len(named) > 8
    assert named <= set(told)
