"""Short forms of what tries messages and files that nobody should send or read."""

from pathlib import Path

import pytest

from tests.campaigns import files, flood, fuzz
from tests.campaigns.listeners import LISTENERS
from tests.support.size import size


@pytest.mark.parametrize("name", LISTENERS)
def test_fuzzed_messages_stop_no_listener(name: str, tmp_path: Path) -> None:
    assert fuzz.fuzz_listener(name, 2000, seed=2, folder=tmp_path) == 2000


@pytest.mark.long
def test_mutants_of_every_file_are_a_line_each(tmp_path: Path) -> None:
    files.lay_out(tmp_path)
    wrong = {name: files.fuzz(tmp_path, name, size(1, 3), seed=5)[1] for name in files.TARGETS}
    assert {name: told for name, told in wrong.items() if told} == {}


@pytest.mark.long
def test_a_flood_on_every_bus_stops_no_service() -> None:
    told = flood.flood(1500, 1, seconds=size(4, 10))
    assert told["of_16_mb"] == 3
    assert max(told["mb_most"].values()) < 400
    assert max(told["log_lines"].values()) < 30 + 20 * told["seconds"]
