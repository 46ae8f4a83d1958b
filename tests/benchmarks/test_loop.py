"""The loop's benchmark: the shape and the arithmetic of its result, never its speed."""

import json
import statistics
from pathlib import Path
from typing import Any

import pytest

from benchmarks.bare import bare_round
from benchmarks.loop import ServiceProcess, measure, render
from benchmarks.loop_parts import Stopwatch
from protocol.scenario import ScenarioError
from runtime.errors import Failure

ROUNDS = 2
STEPS = 800  # a tap that joins half a second late has still heard most of it


@pytest.fixture(scope="module")
def said() -> list[str]:
    return []


@pytest.fixture(scope="module")
def result(said: list[str]) -> dict[str, Any]:
    return measure(rounds=ROUNDS, steps=STEPS, progress=said.append)


@pytest.mark.long
@pytest.mark.integration
def test_the_ratio_is_that_of_the_two_medians(result: dict[str, Any]) -> None:
    for key in ("steps_per_second", "bare_round_trips_per_second"):
        values = [one[key] for one in result["rounds"]]
        assert len(values) == ROUNDS
        assert result[key] == statistics.median(values)
        assert result["spread"][key] == [min(values), max(values)]
        assert min(values) > 0
    assert result["ratio"] == result["steps_per_second"] / result["bare_round_trips_per_second"]
    for one in result["rounds"]:
        assert one["ratio"] == one["steps_per_second"] / one["bare_round_trips_per_second"]


@pytest.mark.long
@pytest.mark.integration
def test_the_parts_add_up_to_the_step(result: dict[str, Any]) -> None:
    parts = result["parts"]
    assert result["step_us"] == 1e6 / result["steps_per_second"]
    assert sum(parts.values()) == pytest.approx(result["step_us"])
    measured = {name: us for name, us in parts.items() if not name.startswith("rest")}
    assert all(us > 0 for us in measured.values())
    for word in ("transport", "parse", "dump", "law", "decide", "plant: journal"):
        assert any(word in name for name in measured), word
    assert all(us > 0 for us in result["while_waiting"].values())
    for word in ("count", "trace", "telemetry"):
        assert any(word in name for name in result["while_waiting"]), word
    bare = 1e6 / result["bare_round_trips_per_second"]
    assert parts["transport: bare round trip"] == bare


@pytest.mark.long
@pytest.mark.integration
def test_the_result_is_an_object_for_machines(result: dict[str, Any], said: list[str]) -> None:
    assert json.loads(json.dumps(result)) == result
    assert set(result["startup_s"]) == {"controller", "plant", "tap"}
    assert result["steps"] == STEPS
    assert len(said) == ROUNDS


@pytest.mark.long
@pytest.mark.integration
def test_the_table_says_what_was_measured_and_whether_the_target_was_reached(
    result: dict[str, Any],
) -> None:
    text = render(result)
    assert f"{result['ratio']:.2f}" in text
    assert all(name in text for name in result["parts"])
    for ratio, verdict in ((0.7, "reached"), (0.3, "MISSED")):
        assert verdict in render({**result, "ratio": ratio})


@pytest.mark.long
@pytest.mark.integration
def test_bare_round_trips_carry_any_payload() -> None:
    for way in ("channel", "queue"):
        assert bare_round(b"there", b"and back", 50, way) > 0


def test_a_scenario_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises((Failure, ScenarioError), match=r"none\.toml"):
        measure(rounds=1, steps=10, scenario=tmp_path / "none.toml")


def test_a_service_that_fails_is_named_with_its_last_words() -> None:
    service = ServiceProcess("plant", ["--pace", "backwards"])
    try:
        with pytest.raises(Failure, match=r"plant did not start: .*backwards"):
            service.wait_until_up()
    finally:
        service.stop()


def test_the_stopwatch_keeps_medians_and_takes_inner_parts_off() -> None:
    watch = Stopwatch()
    for _ in range(3):
        assert watch.time("outer", lambda: watch.time("inner", lambda: sum(range(2000)))) == 1999000
        watch.take_off("outer", "inner")
    medians = watch.medians_us()
    assert medians["outer"] >= 0
    assert medians["inner"] > 0
