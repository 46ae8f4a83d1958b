"""The loop's benchmark: the shape and the arithmetic of its result, never its speed."""

import json
import statistics
from pathlib import Path
from typing import Any

import pytest

from benchmarks.loop import ServiceProcess, measure, render
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
def test_the_speed_is_the_median_of_the_rounds(result: dict[str, Any]) -> None:
    assert len(result["rounds"]) == ROUNDS
    assert result["steps_per_second"] == statistics.median(result["rounds"])
    assert result["spread"] == [min(result["rounds"]), max(result["rounds"])]
    assert min(result["rounds"]) > 0


@pytest.mark.long
@pytest.mark.integration
def test_the_result_is_an_object_for_machines(result: dict[str, Any], said: list[str]) -> None:
    assert json.loads(json.dumps(result)) == result
    assert set(result["startup_s"]) == {"controller", "plant", "tap"}
    assert result["steps"] == STEPS
    assert len(said) == ROUNDS


@pytest.mark.long
@pytest.mark.integration
def test_the_text_says_what_was_measured(result: dict[str, Any]) -> None:
    text = render(result)
    assert f"{result['steps_per_second']:.0f}" in text
    assert all(name in text for name in result["startup_s"])


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
