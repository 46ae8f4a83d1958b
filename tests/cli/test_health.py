"""`wyner status --healthy`, `wyner design --knowledge`: what containers' checks and taps use."""

import json
import socket
import threading
import time
from pathlib import Path

import pytest

from protocol.link.distiller import Distiller
from protocol.link.records import KeyRecord
from protocol.scenario import Scenario
from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from protocol.secret.nonces import Contribution
from runtime.chance import fresh_nonce
from runtime.files import write_atomically
from runtime.health import Look
from wyner.cli.healthy import MAX_AGE_S, advances
from wyner.cli.main import main


def write_status(
    run_dir: Path, service: str, transitions: int, age_s: float = 0.0, **more: str
) -> None:
    path = run_dir / service / "status.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    status = {
        "t_ns": time.time_ns() - int(age_s * 1e9),
        "transitions": transitions,
        "phase": "running",
        "detail": "",
        **more,
    }
    path.with_suffix(".new").write_text(json.dumps(status))
    path.with_suffix(".new").replace(path)


def health(run_dir: Path, service: str) -> int:
    return main(["status", str(run_dir), "--healthy", service, "--within", "0.6"])


@pytest.mark.parametrize("service", ["plant", "controller"])
def test_a_loop_that_counts_transitions_is_healthy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], service: str
) -> None:
    write_status(tmp_path, service, 10)
    later = threading.Timer(0.2, write_status, (tmp_path, service, 11))
    later.start()
    assert health(tmp_path, service) == 0
    later.join()
    assert capsys.readouterr().out == f"{service} advances: running, 11 transitions\n"


def test_a_loop_that_makes_no_keys_any_more_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    distiller = Distiller(Schedule(Assumption(0.95, eps_sec=1e-2), 3, 6), 4, fresh_nonce)
    none_counts = [Contribution(j, 1, None, None) for j in (1, 2, 3)]
    told = []
    for rows in (none_counts[:2], none_counts):  # block 0 is open, and then over
        distiller.resume("0" * 16, KeyRecord(), rows=rows)
        told.append(distiller.status_fields()["keys_stopped"])
    assert told == ["", "block 0 lost too many copies to make one"]
    why = {"keys_stopped": told[1]}
    write_status(tmp_path, "plant", 10, **why)
    later = threading.Timer(0.2, write_status, (tmp_path, "plant", 11), why)
    later.start()
    assert health(tmp_path, "plant") == 0
    later.join()
    told_last = capsys.readouterr().out
    assert told_last.endswith("; keys stopped: block 0 lost too many copies to make one\n")


def test_a_service_that_reports_but_whose_loop_stands_still_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_status(tmp_path, "plant", 10)
    assert health(tmp_path, "plant") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "stands still: running, 10 transitions, no more within 0.6 s" in line


def test_a_service_that_reports_no_more_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_status(tmp_path, "plant", 10, age_s=MAX_AGE_S + 1)
    assert health(tmp_path, "plant") == 1
    assert "last report 6.0 s ago, expected 5 s at most" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "{}", "[]", "not json", '{"t_ns": "x"}'])
def test_a_report_that_is_none_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    (tmp_path / "plant").mkdir()
    (tmp_path / "plant/status.json").write_text(text)
    assert health(tmp_path, "plant") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected a status with" in line


@pytest.mark.parametrize("service", ["plant", "controller", "tap"])
def test_a_service_that_has_not_started_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], service: str
) -> None:
    assert health(tmp_path, service) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "cannot be read" in line


def test_a_new_session_that_counts_from_nought_is_healthy_when_it_advances() -> None:
    looks = iter([100, 1, 2])
    seen = advances(lambda: Look(0.0, n := next(looks), f"{n}"), within_s=1.0)
    assert seen.count == 2


def write_tap(run_dir: Path, captured: int, age_s: float = 0.0) -> None:
    path = run_dir / "tap" / "status.json"
    path.parent.mkdir(exist_ok=True)
    t_ns = time.time_ns() - int(age_s * 1e9)
    write_atomically(path, json.dumps({"t_ns": t_ns, "captured": captured}).encode())


def test_a_tap_is_healthy_when_its_capture_grows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_tap(tmp_path, 7)
    assert health(tmp_path, "tap") == 1
    assert "stands still: 7 messages captured" in capsys.readouterr().err
    later = threading.Timer(0.2, write_tap, (tmp_path, 8))
    later.start()
    assert health(tmp_path, "tap") == 0
    later.join()


def test_a_tap_that_is_frozen_is_not_healthy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_tap(tmp_path, 7, age_s=60)
    assert health(tmp_path, "tap") == 1
    assert "last report 60.0 s ago" in capsys.readouterr().err


def test_a_router_is_healthy_when_it_takes_a_connection(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        assert main(["status", "--endpoint", endpoint]) == 0
    assert main(["status", "--endpoint", endpoint, "--within", "1"]) == 1
    assert f"{endpoint}: no answer" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--healthy", "plant"], "--healthy: expected RUN_DIR as well"),
        (["--endpoint", "tcp/nowhere"], "--endpoint: got 'tcp/nowhere', expected PROTOCOL/HOST"),
        (["--healthy", "plant", "--within", "0"], "--within: got 0, expected more than 0"),
        (["--healthy", "plant", "--endpoint", "tcp/a:1"], "not allowed with argument"),
    ],
)
def test_wrong_arguments_are_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    assert main(["status", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line


# --- knowledge ------------------------------------------------------------------------------------


def test_knowledge_is_the_eavesdroppers_and_not_the_defenders(
    tmp_path: Path, sustained: Scenario, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "knowledge.json"
    assert main(["design", "sustained", "--knowledge", str(path)]) == 0
    assert main(["design", "sustained", "--knowledge"]) == 0
    assert capsys.readouterr().out == path.read_text()
    written = json.loads(path.read_text())
    assert written["alpha"] is None
    assert set(written["policy"]) == {
        "law",
        "costs",
        "gain",
        "together",
        "certain",
        "regulator",
        "spacing",
    }  # no set of the design
    D_c, D_e = sustained.defender.disturbance.half_widths, written["disturbance_h"]
    assert D_c is not None
    assert D_e == [sustained.secrecy.alpha * w for w in D_c for _ in range(2)]


def test_knowledge_that_cannot_be_written_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main(["design", "sustained", "--knowledge", str(tmp_path / "file/k.json")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "cannot be written" in line
    assert main(["design", "nowhere.toml", "--knowledge"]) == 2


@pytest.mark.parametrize(("grows", "code"), [(True, 0), (False, 1)])
def test_for_machines_it_is_one_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], grows: bool, code: int
) -> None:
    write_status(tmp_path, "plant", 10)
    later = threading.Timer(0.2, write_status, (tmp_path, "plant", 10 + grows))
    later.start()
    command = ["status", str(tmp_path), "--healthy", "plant", "--within", "0.6"]
    assert main([*command, "--json"]) == code
    later.join()
    told = json.loads(capsys.readouterr().out)
    detail = told.pop("detail")
    assert detail == "plant advances: running, 11 transitions" or not grows
    assert told == {
        "healthy": grows,
        "service": "plant",
        "endpoint": None,
        "loops": 0,
        "unwell": {},
    }


def test_of_a_fleet_it_names_the_loops_that_are_not_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        write_status(tmp_path / name, "plant", 10)
        (tmp_path / name / "scenario.toml").write_text("")
    later = threading.Timer(0.2, write_status, (tmp_path / "a", "plant", 11))
    later.start()
    command = ["status", str(tmp_path), "--healthy", "plant", "--within", "0.6"]
    assert main([*command, "--json"]) == 1
    later.join()
    told = json.loads(capsys.readouterr().out)
    assert (told["healthy"], told["loops"], list(told["unwell"])) == (False, 2, ["b"])
