"""``wyner up --demo``: five runs, four lines, and an exit code that means them."""

import json
from pathlib import Path
from typing import Any

import pytest

from runtime.scenario_file import scenario_of
from tests.support.bare_figures import bare_figures
from wyner.cli import demo
from wyner.cli.main import main
from wyner.cli.session import Outcome
from wyner.deployment.one_machine import RunOptions


@pytest.mark.long
@pytest.mark.integration
@pytest.mark.timeout(900)  # beside sixteen other programs its runs are made again, at a lower pace
def test_the_demo_comes_to_its_point(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["up", "--demo", "--json", "--run-dir", str(tmp_path / "demo")])
    told = json.loads(capsys.readouterr().out)
    assert (code, told["as_it_must"]) == (0, True), told["verdict"]
    assert list(bare_figures(told)) == []
    points = [line.split()[1] for line in told["verdict"]]
    assert points == ["Spoken:", "Keys:", "Compare:", "Attacked:"]
    spoken, keys, control, caught, unseen = told["runs"].values()
    # at the limit of the channel, and she has it at the very step at which the plant has it
    made = 1 - spoken["missed"] / spoken["steps"]  # a busy machine misses some steps
    assert spoken["bits_per_second"] > 15 * made
    assert spoken["taps"]["nearest-centre"]["solved_k"] == spoken["delivered_k"] > 0
    assert spoken["keys"] is None
    assert keys["keys"]["made"] > 0
    assert keys["keys"]["held_by_tap_bits"] == 0
    assert control["keys"]["made"] == 0
    assert "eps_E" in control["keys"]["refused"]
    # the same attack under a key that Eve does not have, and where the claim on her is refuted
    assert caught["attack"]["alarm_k"] >= caught["attack"]["onset"]
    assert caught["attack"]["watched"] > 0
    assert caught["keys"]["held_by_tap_bits"] == 0
    assert unseen["attack"]["alarm_k"] == -1
    assert unseen["attack"]["watched"] == 0 < unseen["attack"]["unwatched"]
    assert unseen["attack"]["away"] > 10  # where it is pushed to hangs on the coins
    assert unseen["keys"]["made"] == 0
    assert any("refuted" in line for line in unseen["keys"]["warnings"])
    assert caught["attack"]["false_alarms"] == unseen["attack"]["false_alarms"] == 0
    # its folder is one of runs: `score` takes it as `check` does
    assert main(["score", str(tmp_path / "demo"), "--json"]) == 0
    scored = json.loads(capsys.readouterr().out)
    assert len(scored["control_cost"]) == len(told["runs"]) == 5
    assert list(bare_figures(scored)) == []


@pytest.mark.parametrize(("missed", "most"), [(99, 2), (0, 8)])
def test_a_run_that_shows_nothing_is_made_again_at_half_the_pace_and_those_after_it_too(
    missed: int, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """A busy machine had the first keys after the onset, or a claim refuted after them."""
    asked: list[tuple[str, str]] = []

    def session(options: RunOptions, *_: object, **__: object) -> Outcome:
        folder = Path(str(options.run_dir))
        folder.mkdir(parents=True)
        asked.append((folder.name, options.pace))
        watched = 40 if options.pace == f"x{demo.ATTACKED_PACE / 8:g}" else 0
        alarm = 361 if watched and folder.name == "caught" else -1
        made = folder.name in ("keys", "unseen")
        summary = {
            "attack": {"onset": 360, "watched": watched, "alarm_k": alarm, "delay": 1},
            "taps": {}, "failed": [], "delivered": folder.name != "spoken",
            "keys": {"made": made, "held_by_tap_bits": 0, "audited": {"all": {"refuted": True}}},
            "missed": missed, "steps": 460,
        }  # fmt: skip
        scenario = scenario_of("packed")
        return Outcome(summary, [], scenario, failure=None, interrupted=False, left=False)

    monkeypatch.setattr(demo, "run_session", session)
    monkeypatch.setattr(demo, "SLOWEST", most)
    assert main(["up", "--demo", "--json", "--run-dir", str(tmp_path / "demo")]) == 1
    spoken, *_, attacked = json.loads(capsys.readouterr().out)["verdict"]
    assert spoken == f"1. Spoken:  not delivered: {missed} of 460 steps missed."
    slow = [1, 2, 4, 8][: most.bit_length()]
    assert asked[: len(slow) + 1] == [
        *(("spoken", f"x{demo.PACE / n:g}") for n in slow),
        ("keys", f"x{demo.PACE / slow[-1]:g}"),
    ]
    assert asked[-2:] == [(n, f"x{demo.ATTACKED_PACE / slow[-1]:g}") for n in ("caught", "unseen")]
    caught = slow[-1] == 8
    assert ("caught 1 step after its onset" in attacked) == caught
    assert ("no key was there in time" in attacked) == (not caught)
    assert attacked.endswith("where Eve hears all keys were made before the claim was refuted.")


def test_keys_under_a_claim_that_is_never_refuted_are_not_the_machines_doing() -> None:
    keys = {"made": 3, "audited": {"offers": {"refuted": False}}}
    line, as_it_must = demo.ACTS[-1].verdict({"attack": None, "keys": keys})
    assert (line.endswith("that must not be."), as_it_must) == (True, False)
