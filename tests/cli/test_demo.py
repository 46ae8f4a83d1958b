"""``wyner demo``: five runs, four lines, and an exit code that means them."""

import json
from pathlib import Path

import pytest

from runtime.scenario_file import scenario_of
from tests.support.bare_figures import bare_figures
from wyner.cli import demo
from wyner.cli.main import main
from wyner.cli.up import Outcome
from wyner.deployment.one_machine import RunOptions


@pytest.mark.slow
@pytest.mark.integration
def test_the_demo_comes_to_its_point(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--json", "--run-dir", str(tmp_path / "demo")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["as_it_must"]
    assert list(bare_figures(told)) == []
    points = [line.split()[1] for line in told["verdict"]]
    assert points == ["Spoken:", "Sealed:", "Control:", "Attacked:"]
    spoken, sealed, control, caught, unseen = told["runs"].values()
    # at the limit of the channel, and she has it at the very step at which the plant has it
    made = 1 - spoken["missed"] / spoken["steps"]  # a busy machine misses some steps
    assert spoken["bits_per_second"] > 15 * made
    assert spoken["taps"]["nearest-centre"]["solved_k"] == spoken["delivered_k"] > 0
    assert spoken["keys"] is None
    assert sealed["keys"]["made"] > 0
    assert sealed["keys"]["held_by_tap_bits"] == 0
    assert sealed["keys"]["same_at_both_ends"]
    assert control["keys"]["made"] == 0
    assert "eps_E" in control["keys"]["refused"]
    # the same attack under a key that she does not have, and under one that she has
    assert caught["attack"]["alarm_k"] >= caught["attack"]["onset"]
    assert caught["attack"]["watched"] > 0
    assert caught["keys"]["held_by_tap_bits"] == 0
    assert unseen["attack"]["alarm_k"] == -1
    assert unseen["attack"]["watched"] > 0
    assert unseen["attack"]["away"] > 20
    assert unseen["keys"]["held_by_tap_bits"] > 0
    assert caught["attack"]["false_alarms"] == unseen["attack"]["false_alarms"] == 0
    # its folder is one of runs: `score` takes it as `check` does
    assert main(["score", str(tmp_path / "demo"), "--json"]) == 0
    scored = json.loads(capsys.readouterr().out)
    assert len(scored["control_cost"]) == len(told["runs"]) == 5
    assert list(bare_figures(scored)) == []


def test_an_attacked_run_in_which_no_key_came_is_made_again_with_a_later_onset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A busy machine had the first keys after the onset, and the demo showed nothing."""
    asked: list[tuple[str, int]] = []

    def session(options: RunOptions, *_: object, **__: object) -> Outcome:
        folder = Path(str(options.run_dir))
        folder.mkdir(parents=True)
        onset = int((options.attack or "@0").partition("@")[2])
        asked.append((folder.name, onset))
        watched = 40 if onset > demo.ONSETS[0] else 0
        alarm = onset + 1 if watched and folder.name == "caught" else -1
        found = {"onset": onset, "watched": watched, "alarm_k": alarm, "delay": 1}
        summary = {
            "attack": found, "taps": {}, "keys": {}, "failed": [], "delivered": True,
            "missed": 9, "steps": 460, "bits_per_second": 20.0, "delivered_k": 273,
        }  # fmt: skip
        scenario = scenario_of("packed")
        return Outcome(scenario, summary, failure=None, interrupted=False, left=False)

    monkeypatch.setattr(demo, "run_session", session)
    main(["demo", "--json", "--run-dir", str(tmp_path / "demo")])
    soon, late = demo.ONSETS
    assert asked[3:] == [("caught", soon), ("caught", late), ("unseen", late)]
    assert "caught 1 step after its onset" in json.loads(capsys.readouterr().out)["verdict"][-1]
