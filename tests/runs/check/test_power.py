"""An honest run passes the check after the machine lost its power, and an unexplained cut fails."""

from pathlib import Path

import pytest

import runtime.journal as journals
from protocol.link.records import Side
from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE
from tests.support.recorded_pair import RecordedPair

TRACES: dict[Side, Path] = {"plant": PLANT_TRACE, "controller": CONTROLLER_TRACE}


def cut(path: Path, lines: int, *, torn: bool) -> None:
    """Take the newest lines of a recording, and half of the one before them."""
    whole = path.read_bytes().splitlines(keepends=True)
    kept = whole[: max(1, len(whole) - lines)]
    if torn and len(kept) > 1:
        kept[-1] = kept[-1][: len(kept[-1]) // 2]
    path.write_bytes(b"".join(kept))


def failed(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    taken: dict[Side, int],
    *,
    power: bool = True,
    torn: bool = False,
    times: int = 1,
    name: str = "keys",
) -> RecordedPair:
    """A run that lost so many lines where both ends were killed; ``power``: the machine died.

    Where it lost some of both traces, it lost some of the capture as well.
    """
    boot = folder.parent / "boot"
    boot.write_text("0")
    monkeypatch.setattr(journals, "BOOT_ID", boot)
    loop = RecordedPair(folder, b"a", name=name)
    for number in range(1, times + 1):
        loop.steps(20)
        loop.queue(f"{number}", b"b")
        loop.queue(f"{number}-again", b"b")
        loop.steps(20)
        for side in TRACES:
            loop.ends[side].files.journal.db.close()  # else it would note that it was closed
            loop.kill(side)
        for side, lines in taken.items():
            cut(folder / TRACES[side], lines, torn=torn)
        if len(taken) == len(TRACES):
            cut(folder / CAPTURE, 5, torn=torn)
            loop.restart_tap()
        if power:
            boot.write_text(f"{number}")
        for side in TRACES:
            loop.start(side)
    loop.queue("last", b"d")
    loop.run(lambda: loop.transitions >= 30 and loop.delivered >= 2 * times + 2)
    loop.stop()
    return loop


def both(lines: int) -> dict[Side, int]:
    """So many lines of either trace."""
    return dict.fromkeys(TRACES, lines)


@pytest.mark.parametrize("torn", [False, True])
@pytest.mark.parametrize("ends", [("plant",), ("controller",), ("plant", "controller")])
@pytest.mark.parametrize("lines", [2, 7, 30])
def test_what_a_power_failure_took_accuses_nobody_and_the_same_cut_without_one_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: tuple[Side, ...], lines: int, torn: bool
) -> None:
    """The newest line alone is no loss: its step is in the journal, and is traced again."""
    taken: dict[Side, int] = dict.fromkeys(ends, lines)
    assert failed(tmp_path / "power", monkeypatch, taken, torn=torn).wrong() == []
    assert failed(tmp_path / "cut", monkeypatch, taken, torn=torn, power=False).wrong()


@pytest.mark.parametrize("name", ["watched", "sealed", "encoder", "noisy"])
def test_nor_does_a_second_one_whatever_the_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    assert failed(tmp_path / "run", monkeypatch, both(9), name=name, times=2).wrong() == []


@pytest.mark.parametrize("side", TRACES)
def test_a_line_before_what_it_took_is_still_missed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: Side
) -> None:
    loop = failed(tmp_path / "run", monkeypatch, both(9))
    path = loop.folder / TRACES[side]
    whole = path.read_bytes().splitlines(keepends=True)
    back = next(i for i, line in enumerate(whole) if b'"power_failed"' in line)
    last = max(i for i in range(back) if b'"event":"transition"' in whole[i])
    before = max(i for i in range(last) if b'"event":"transition"' in whole[i])
    path.write_bytes(b"".join(whole[:before] + whole[before + 1 :]))
    assert any(text.startswith("traces: ") for text in loop.wrong())


def test_a_power_failure_is_told_where_a_process_begins_and_nowhere_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = failed(tmp_path / "run", monkeypatch, both(9))
    path = loop.folder / PLANT_TRACE
    whole = path.read_bytes().splitlines(keepends=True)
    back = next(i for i, line in enumerate(whole) if b'"power_failed"' in line)
    moved = [*whole[:back], *whole[back + 1 : back + 8], whole[back], *whole[back + 8 :]]
    path.write_bytes(b"".join(moved))
    assert any("expected where a process begins" in text for text in loop.wrong())
