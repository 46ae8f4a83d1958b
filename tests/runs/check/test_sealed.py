"""A run of `sealed` on files: it passes, and what is changed in its positions and pads is seen."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE
from tests.support.checked_runs import failed
from tests.support.recorded_pair import Lines, RecordedPair, read_lines, write_lines

TEXT = b"Meet me at nine"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "sealed"
    loop = RecordedPair(folder, TEXT, name="sealed")
    loop.run(lambda: loop.delivered == 1)
    assert loop.received == [TEXT]
    loop.stop()
    return folder


def test_it_passes_and_a_transition_carries_where_it_has_digits(run: Path) -> None:
    assert failed(run) == set()
    steps = [line for line in read_lines(run / PLANT_TRACE) if line["event"] == "transition"]
    assert [s for s in steps if s.get("keyed")] == [s for s in steps if s["message_symbol"] >= 0]
    assert sum(s.get("keyed", False) for s in steps) >= 4 * len(TEXT)


def offers(lines: Lines) -> Lines:
    """The offers with digits, in a capture."""
    found = [line["message"] for line in lines if line.get("topic") == "offer"]
    return [message for message in found if message["stream_block"] >= 0]


def named_before(lines: Lines) -> None:
    offers(lines)[-3]["stream_at"] -= 1


def of_another_block(lines: Lines) -> None:
    offers(lines)[-3]["stream_block"] += 1


def without_position(lines: Lines) -> None:
    message = offers(lines)[-3]
    del message["stream_block"], message["stream_at"]


@pytest.mark.parametrize(
    ("change", "rule"),
    [(named_before, "once"), (of_another_block, "once"), (without_position, "bus")],
)
def test_a_position_in_the_capture_that_is_otherwise_is_seen(
    run: Path, tmp_path: Path, change: Callable[[Lines], None], rule: str
) -> None:
    folder = Path(shutil.copytree(run, tmp_path / "run"))
    lines = read_lines(folder / CAPTURE)
    change(lines)
    write_lines(folder / CAPTURE, lines)
    assert rule in failed(folder)


@pytest.mark.parametrize("trace", [PLANT_TRACE, CONTROLLER_TRACE])
@pytest.mark.parametrize("keyed", [True, False])
def test_a_transition_that_carries_and_has_no_digits_or_the_other_way_round_is_seen(
    run: Path, tmp_path: Path, trace: Path, keyed: bool
) -> None:
    folder = Path(shutil.copytree(run, tmp_path / "run"))
    lines = read_lines(folder / trace)
    step = [s for s in lines if s["event"] == "transition" and s.get("keyed") is keyed][-2:]
    if not step:  # before the first digit an offer names none
        step = [s for s in lines if s["event"] == "transition" and "keyed" not in s][-2:]
        step[0]["digits"] = [0, 0]
    step[0]["keyed"] = not keyed
    write_lines(folder / trace, lines)
    assert {"once", "sender", "receiver", "in-step"} & failed(folder)
