"""The check `guarded` on a run whose messages are tagged, and on that run changed."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from runtime.run_folder import CAPTURE, CONTROLLER_TRACE
from tests.support.recorded_loop import RecordedLoop
from tests.support.small_run import read_lines, write_lines
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

MAC = '\n[defence]\nmessages = "mac"\n'
Lines = list[dict[str, Any]]


@pytest.fixture(scope="module")
def tagged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    loop = RecordedLoop(tmp_path_factory.mktemp("runs") / "run", name="keys", more=MAC)
    loop.run(lambda: loop.transitions >= 900)
    loop.stop()
    return loop.folder


def results(folder: Path) -> dict[str, str]:
    return {r.check.name: r.result for r in check(read_evidence(folder))}


def test_an_honest_run_passes_and_tags_are_recomputed(tagged: Path) -> None:
    found = {r.check.name: r for r in check(read_evidence(tagged))}
    assert all(r.result != "FAIL" for r in found.values()), results(tagged)
    counter = found["guarded"].counter
    assert counter.counted > 100
    assert int(counter.note.split()[0]) > 50


def last_tagged(lines: Lines) -> dict[str, Any]:
    """The message of the newest batch's first slot that was heard."""
    found = [m["message"] for m in lines if m.get("message", {}).get("mac")]
    message: dict[str, Any] = [m for m in found if not m["guard"].endswith("/")][-1]
    return message


def other_tag(lines: Lines) -> None:
    message = last_tagged(lines)
    message["mac"] = ("0" if message["mac"][0] != "0" else "1") + message["mac"][1:]


def other_slot(lines: Lines) -> None:
    message = last_tagged(lines)
    batch, slot = message["guard"].split("/")
    message["guard"] = f"{batch}/{int(slot) - 1}"


def other_content(lines: Lines) -> None:
    message = last_tagged(lines)
    message["block"] += 1


def no_slot(lines: Lines) -> None:
    del last_tagged(lines)["guard"]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (other_tag, "guarded"),
        (other_slot, "guarded"),
        (other_content, "guarded"),
        (no_slot, "public-fields"),
    ],
)
def test_a_changed_one_is_named(
    change: Callable[[Lines], None], named: str, tagged: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(tagged, tmp_path / "run"))
    lines = read_lines(folder / CAPTURE)
    change(lines)
    write_lines(folder / CAPTURE, lines)
    assert results(folder)[named] == "FAIL"


def test_an_honest_message_that_was_refused_is_named(tagged: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(tagged, tmp_path / "run"))
    lines = read_lines(folder / CONTROLLER_TRACE)
    session = next(m["session"] for m in lines if m["event"] == "transition")
    refused = {"event": "forged", "session": session, "k": 9, "message": "measurement"}
    lines.append({**refused, "why": "its tag is wrong"})
    write_lines(folder / CONTROLLER_TRACE, lines)
    assert results(folder)["guarded"] == "FAIL"
