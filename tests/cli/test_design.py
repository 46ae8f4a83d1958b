"""``wyner design``: the text, the object, the cache, and errors in one line."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from controller_service.laws import registry
from controller_service.sets.design import SynthesisError
from protocol.scenario import Scenario
from wyner.advice import rate
from wyner.cli.main import main

PLANAR = """
name = "{name}"
[plant]
A = [[1.0, 0.0975], [0.0, 0.9512]]
B = [[0.0246], [0.4877]]
period_s = 0.1
initial_state = {start}
[plant.disturbance]
half_widths = [0.1, 0.1]
[defender.disturbance]
half_widths = [0.12, 0.12]
[control]
horizon = 12
gain = {gain}
[control.inputs]
half_widths = [6.0]
[secrecy]
alpha = 4.0
"""


@pytest.fixture(autouse=True)
def apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of the test's own, and a short simulation."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(rate, "RUNS", 6)
    monkeypatch.setattr(rate, "BURN_IN", 60)
    monkeypatch.setattr(rate, "STEPS", 60)


def scenario(folder: Path, text: str = PLANAR, **fields: Any) -> str:
    path = folder / "plant.toml"
    values = {"name": "short", "start": [1.0, -0.5], "gain": [[-13.27, -2.26]], **fields}
    path.write_text(text.format(**values))
    return str(path)


def designs(folder: Path) -> list[Path]:
    return list((folder / "cache").rglob("*.npz"))


def test_the_text_shows_sets_gain_and_rate(tmp_path: Path, capsys: Any) -> None:
    assert main(["design", scenario(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert max(map(len, out.splitlines())) < 80
    whole = out.replace("\n  ", " ")
    assert re.match(r"secrecy: .*\ncost: .*\nattack: .*\n\n", whole)
    lines = out.partition("\n\n")[2].splitlines()
    assert lines[0] == "short: 2 state(s), 1 input(s), law sustained"
    assert lines[1].startswith("sets T_0..T_12 computed in")
    assert "K (given): -13.27 -2.26" in lines
    assert "Rakovic's approximation of order 11" in out
    table = lines[lines.index("  index  facets  area") + 1 :]
    assert [row.split()[0] for row in table[:6]] == ["0", "1", "2", "5", "10", "12"]
    areas = [float(row.split()[2]) for row in table[:6]]
    assert areas == sorted(areas)
    assert "initial state [1.0, -0.5]: index" in out
    assert (
        "settled (6 runs, half from x(0), half from the origin: 60 steps after the first 60, "
        "seed 1; 95 % intervals over runs)"
    ) in whole
    assert "ceiling 5 bit/s" in out


def test_the_object_is_one_and_consistent(tmp_path: Path, capsys: Any) -> None:
    assert main(["design", scenario(tmp_path), "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    r = json.loads(out)
    assert (r["scenario"], r["states"], r["inputs"], r["horizon"]) == ("short", 2, 1, 12)
    assert r["terminal"]["method"] == "rakovic"
    assert r["start"]["index"] >= 1
    assert 0 < r["largest_deflation"] < 1e-11
    assert r["seconds"] <= r["ready_seconds"]
    told = r["rate"]
    p, (low, high) = told["agreement_probability"], told["agreement_interval_95"]
    assert 0 <= low <= p <= high <= 1
    assert told["bits_per_second"] == pytest.approx(p / (1 + p) / 0.1, rel=0.15)
    low, high = told["bits_per_second_interval_95"]
    assert low <= told["bits_per_second"] <= high <= told["ceiling_bits_per_second"] == 5
    assert (told["runs"], told["burn_in"], told["steps"]) == (6, 60, 60)
    assert (told["silent"], told["still_moves"]) == (False, None)


def test_the_second_time_is_from_the_cache(tmp_path: Path, capsys: Any) -> None:
    results = []
    for _ in range(2):
        assert main(["design", scenario(tmp_path), "--json"]) == 0
        results.append(json.loads(capsys.readouterr().out))
    assert [r["cached"] for r in results] == [False, True]
    assert len(designs(tmp_path)) == 1
    for key in ("sets", "gain", "start", "rate", "fingerprint", "largest_deflation"):
        assert results[0][key] == results[1][key]
    assert main(["design", scenario(tmp_path)]) == 0
    assert "read from the cache, computed once in" in capsys.readouterr().out


def test_a_start_outside_every_set_is_said(tmp_path: Path, capsys: Any) -> None:
    path = scenario(tmp_path, start=[1e6, 0.0])
    assert main(["design", path]) == 1
    out = capsys.readouterr().out.replace("\n  ", " ")
    assert "is outside T_12, the largest set" in out
    assert "settled rate: none" in out
    assert main(["design", path, "--json"]) == 1
    r = json.loads(capsys.readouterr().out)
    assert r["rate"] is None
    assert "outside" in r["start"]


@pytest.mark.parametrize("name", ["up", "controller"])
def test_who_computes_a_design_shows_its_progress_on_a_terminal(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told = []

    def cached_design(_scenario: object, progress: object = None) -> None:
        told.append(progress)
        raise SynthesisError("far enough")

    monkeypatch.setattr(registry, "cached_design", cached_design)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main([name, "--scenario", "quadruple-tank"]) == 2
    assert callable(told[0])
    assert capsys.readouterr().err == "wyner: quadruple-tank: far enough\n"


def test_a_message_under_distilled_keys_has_a_rate_and_no_settled_one(capsys: Any) -> None:
    """Its rate was simulated as if its scheme tested for keys: 0 bit/s, "the law falls silent"."""
    assert main(["design", "sealed", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["under_keys"] == {"bits_per_second_at_most": 20.0, "first_step": 48}
    assert (result["rate"], result["why"]) == (None, None)
    assert main(["design", "sealed"]) == 0
    out = capsys.readouterr().out.replace("\n  ", " ")
    assert "message rate: 20 bit/s at most, from step 48 on at the earliest" in out
    assert "settled rate" not in out


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
    assert written == sustained.knowledge().model_dump(mode="json")
    D_c, D_e = sustained.defender.disturbance.half_widths, written["disturbance_h"]
    assert D_c is not None
    assert D_e == [sustained.secrecy.alpha * w for w in D_c for _ in range(2)]
