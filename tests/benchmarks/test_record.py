"""A ratio that fell by more than its noise is named, and chance is not."""

import json
import random
from pathlib import Path

import pytest

import benchmarks.loop
from benchmarks import record
from benchmarks.__main__ import main


def rounds(seed: int, ratio: float, noise: float, count: int = 5) -> list[float]:
    draw = random.Random(seed)
    return [draw.gauss(ratio, noise * ratio) for _ in range(count)]


def loop(ratios: list[float]) -> dict[str, dict[str, object]]:
    return {"loop": {"rounds": [{"ratio": r} for r in ratios]}}


@pytest.mark.parametrize("noise", [0.01, 0.05, 0.1])
def test_the_same_speed_hardly_ever_falls(noise: float) -> None:
    pairs = [(rounds(s, 0.6, noise), rounds(s + 10_000, 0.6, noise)) for s in range(400)]
    fell = sum(record.compare(before, now).fell for before, now in pairs)
    assert fell <= 0.03 * len(pairs)


def test_a_fall_beyond_the_noise_is_seen() -> None:
    pairs = [(rounds(s, 0.6, 0.03), rounds(s + 10_000, 0.48, 0.03)) for s in range(200)]
    assert sum(record.compare(before, now).fell for before, now in pairs) >= 0.97 * len(pairs)
    assert not any(record.compare(now, before).fell for before, now in pairs)
    assert not record.compare([0.6], [0.3]).fell  # nobody knows how noisy one round was
    assert not record.compare([0.6, 0.6, 0.6], [0.58, 0.58, 0.58]).fell


def test_the_newest_entry_that_has_the_ratio_is_compared_with(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    record.add(loop([0.9, 0.91, 0.92]), "1", path)
    record.add(loop([0.6, 0.61, 0.62]), "2", path)
    record.add({"sets": {"ratios": [500.0, 510.0]}, "engine": {"ratios": None}}, "3", path)
    record.add({"engine": {"ratios": [90.0]}}, "3", path)
    entries = record.read(path)
    assert [e["version"] for e in entries] == ["1", "2", "3"]
    assert list(entries[2]["ratios"]) == ["sets", "engine"]
    found = record.falls(loop([0.6, 0.6, 0.61]), entries)
    assert not found["loop"].fell
    found = record.falls(loop([0.3, 0.3, 0.31]), entries)
    assert record.render(found, entries).startswith("FELL   loop         0.61 (2, ")


def test_what_is_no_record_is_said(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    path.write_text('{"a": 1}')
    with pytest.raises(ValueError, match="expected a list of entries"):
        record.read(path)
    assert record.read(tmp_path / "none") == []
    assert record.render({}, []) == "nothing on record to compare with"


def test_the_command_ends_with_1_where_a_ratio_fell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "record.json"
    monkeypatch.setattr(record.read, "__defaults__", (path,))
    monkeypatch.setattr(record.add, "__defaults__", (path,))
    measured = loop([0.6, 0.61, 0.62])["loop"]
    monkeypatch.setattr(benchmarks.loop, "measure", lambda **_: measured)
    assert main(["record", "--of", "loop"]) == 0
    assert json.loads(path.read_text())[0]["ratios"] == {"loop": [0.6, 0.61, 0.62]}
    assert main(["compare", "--of", "loop", "--json"]) == 0
    measured["rounds"] = [{"ratio": 0.2}, {"ratio": 0.21}]
    assert main(["compare", "--of", "loop"]) == 1
    assert "FELL" in capsys.readouterr().out
    assert main(["record", "--of", "nothing"]) == 2
    assert main(["loop", "--of", "loop"]) == 2


def test_the_record_of_this_tree_can_be_read() -> None:
    entries = record.read()
    assert all(set(e["ratios"]) <= set(record.WATCHED) for e in entries)
