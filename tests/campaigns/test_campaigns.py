"""Short forms of the campaigns: enough to know that they work, and to see what breaks at once."""

import json
from pathlib import Path

import pytest

from runtime.addresses import Addresses
from runtime.zenoh_bus import open_bus
from tests.campaigns import exhaustive, live, schedules
from tests.support.programs import python


@pytest.mark.parametrize("options", [[], ["--networks"]])
def test_seeded_schedules_break_nothing(
    options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert schedules.main(["--first", "16", "--count", "40", *options]) == 0
    done = json.loads(capsys.readouterr().out)
    assert (done["schedules"], done["broken"]) == (40, 0)
    assert min(done["keys"], done["acting"]) > 0


@pytest.mark.long
def test_schedules_watch_steps_with_a_keyed_coin() -> None:
    seeds = [seed for seed in range(8000) if schedules.watched(seed)][:12]
    found = [schedules.outcome_of(seed) for seed in seeds]
    assert not [outcome.wrong for outcome in found if outcome.wrong]
    assert sum(outcome.watched for outcome in found) > 100


@pytest.mark.long
def test_an_exploration_says_how_far_it_came(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["--scheme", "pipelined", "--from-hello", "--no-keys", "--deepest", "4"]
    assert exhaustive.main(command) == 0
    assert capsys.readouterr().out.startswith("depth 4.000, ")


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "kills", "seed"),
    [("kills", 6, 5), ("tls", 6, 5), ("keys", 2, 3), ("watched", 8, 3), ("sealed", 8, 3)],
)
def test_a_run_whose_services_are_killed_delivers_once_and_passes(
    tmp_path: Path, kind: str, kills: int, seed: int
) -> None:
    """Seed 5 draws pace x20, and strikes both ends and the router early."""
    options = ["--seed", str(seed), "--kills", str(kills), "--failed", str(tmp_path)]
    kinds = [f"--{kind}"] if kind != "kills" else []
    # apart: Zenoh, once opened in a process, does not survive a fork
    done = python("-m", "tests.campaigns.kills", *options, *kinds, timeout=None)
    assert done.returncode == 0, done.stdout + done.stderr
    assert '"transitions": ' in done.stdout


def test_a_live_loop_is_not_forked_beside_zenoh(tmp_path: Path) -> None:
    with open_bus(Addresses()), pytest.raises(RuntimeError, match="its forks could not"):
        live.fork(["--version"], tmp_path / "log")
