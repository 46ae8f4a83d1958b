"""``wyner up``: who listens, and when a run is over."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from runtime.errors import Failure, UsageError
from runtime.scenario_file import scenario_of
from tests.support.scenarios import text_of
from wyner.cli import session, up
from wyner.cli.main import main
from wyner.deployment.one_machine import RunOptions


def progress(returned: int | None) -> tuple[Any, SimpleNamespace]:
    plant = SimpleNamespace(returned=returned)
    supervisor: Any = SimpleNamespace(poll=lambda: None, child=lambda _name: plant)
    return session.Progress(until_delivered=True, supervisor=supervisor), plant


def test_a_run_is_over_with_its_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "GRACE_S", 0.0)
    watching, plant = progress(None)
    assert not watching.over()
    plant.returned = 0
    assert watching.over()


def test_a_service_that_never_says_anything_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user's file may not return while its service is opened."""
    watching, plant = progress(None)
    plant.log = Path("run/plant/log")
    assert not watching.over()
    monkeypatch.setattr(session, "SAID_S", 0.0)
    watching.controller_said("", b"{}", 0)
    with pytest.raises(Failure, match=r"^plant: no status of it within 0 s \(log: run/pl"):
        watching.over()
    watching.plant_said("", b"{}", 0)
    assert not watching.over()


def test_eavesdroppers_asked_for_listen_besides_the_scenarios_own(tmp_path: Path) -> None:
    """They replaced the shipped ones, and what the weakest left was called true."""
    (tmp_path / "mine.py").write_text(
        "from tap_service.eavesdroppers.nearest_centre import NearestCentre\n"
        "class Mine(NearestCentre):\n    name = 'mine'\n"
        "class Shadow(NearestCentre):\n    pass\n"
    )
    scenario = scenario_of("sustained")
    mine = f"{tmp_path}/mine.py:Mine"

    def listening(asked: str | None) -> tuple[str, ...]:
        return session.eavesdroppers_of(RunOptions(eavesdropper=asked), scenario)

    usual = listening(None)
    assert "list-decoder" in usual
    assert listening(mine) == (*usual, mine)
    assert listening("nearest-centre,oracle") == (*usual, "oracle")
    with pytest.raises(UsageError, match="are both named 'nearest-centre'"):
        listening(f"{tmp_path}/mine.py:Shadow")
    with pytest.raises(UsageError, match="expected at least one name"):
        listening(",")


def test_who_wants_whole_states_is_refused_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from tap_service.eavesdroppers.nearest_centre import NearestCentre\n"
        "class Mine(NearestCentre):\n    name = 'mine'\n    reads_outputs = False\n"
    )
    encoder = scenario_of("encoder")
    for name in ("oracle", f"{tmp_path}/mine.py:Mine"):
        with pytest.raises(UsageError, match=r"--eavesdropper: .*plant\.C"):
            session.eavesdroppers_of(RunOptions(eavesdropper=name), encoder)
    assert session.eavesdroppers_of(RunOptions(eavesdropper="list-decoder"), encoder)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("[keys]\neps_E = 0.3", "[keys]\neps_E = 1.0", "keys.eps_E: got 1.0, expected less than 1"),
        ("[keys]\neps_E = 0.3", "[keys]\neps_E = 0.0", "takes distilled keys, and eps_E = 0"),
        ("[keys]\neps_E = 0.3", "[keys]\neps_E = 1e-4", "no block is long enough for a key"),
        ("[keys]\neps_E = 0.3", "", "expected a table [keys] beside it"),
    ],
)
@pytest.mark.parametrize("name", ["sealed", "watched"])
def test_a_claim_that_makes_no_key_is_one_line_before_anything_starts(
    name: str, old: str, new: str, line: str, tmp_path: Path, capsys: Any
) -> None:
    rest = [] if new else [("appearances = 1", "")]
    file, run_dir = tmp_path / "changed.toml", tmp_path / "run"
    file.write_text(text_of(name, (old, new), *rest), encoding="utf-8")
    options = ["--scenario", str(file), "--message", "hi", "--run-dir", str(run_dir)]
    assert main(["up", *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert line in said.err
    assert not run_dir.exists()


@pytest.mark.parametrize(("failed", "code"), [([], 0), (["mine"], 1)])
def test_a_run_whose_eavesdropper_failed_ends_with_1(
    failed: list[str], code: int, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """What she would have had nobody knows: it is no success."""
    summary = {"failed": failed, "delivered": True}
    scenario = scenario_of("sustained")
    outcome = session.Outcome(summary, [], scenario, None, interrupted=False, left=False)
    monkeypatch.setattr(up, "run_session", lambda _options: outcome)
    assert main(["up", "--json", "--until-delivered"]) == code
    assert json.loads(capsys.readouterr().out)["failed"] == failed
