"""No nonce, digit or key that has served stands in any file of an end that has stopped."""

import base64
import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from protocol.link.records import Side
from protocol.secret.key_digits import digits
from protocol.secret.nonces import as_bytes
from protocol.secret.stream import BlockKeys, KeyStream, Position
from runtime.run_folder import (
    CAPTURE,
    CONTROLLER_TRACE,
    PLANT_TRACE,
    SCENARIO,
)
from runtime.scenario_file import load_scenario
from tests.support.pair import SIDES
from tests.support.recorded_pair import RecordedPair
from tests.support.traces import events_of

RUN = 16
"""Digits in a row that are looked for: 32 bits, so that none is found by chance."""

TRACES = {"plant": PLANT_TRACE, "controller": CONTROLLER_TRACE}


class Stopped(NamedTuple):
    """A run whose ends have stopped, and the keys of each block that both have confirmed."""

    folder: Path
    keys: dict[int, Sequence[bytes]]


def confirmed(loop: RecordedPair) -> int:
    """The newest block that both ends have confirmed."""
    return min(loop.plant.state.keys.record.confirmed, loop.controller.state.keys.record.confirmed)


@pytest.fixture(scope="module", params=["at a confirmation", "later"])
def stopped(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Stopped:
    keys: dict[int, Sequence[bytes]] = {}
    add = KeyStream.add

    def noted(self: KeyStream, block: int, new: Sequence[bytes]) -> tuple[BlockKeys, ...]:
        assert keys.setdefault(block, new) == new
        return add(self, block, new)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(KeyStream, "add", noted)
        loop = RecordedPair(tmp_path_factory.mktemp("erased") / "run", b"a message", name="sealed")
        loop.run(lambda: confirmed(loop) >= 2)
        if request.param == "later":
            loop.steps(100)
        over = confirmed(loop)
        loop.stop()
    return Stopped(loop.folder, {block: keys[block] for block in range(over + 1)})


def contents(folder: Path, side: Side) -> dict[str, bytes]:
    """The files of an end."""
    files = [path for path in (folder / side).rglob("*") if path.is_file()]
    return {path.name: path.read_bytes() for path in files}


def nonces(folder: Path) -> dict[int, list[bytes]]:
    """The nonces of every key block, as the wire carried them."""
    keys = load_scenario(folder / SCENARIO).keys
    schedule = None if keys is None else keys.schedule()
    assert schedule is not None
    found: dict[int, list[bytes]] = defaultdict(list)
    for line in (folder / CAPTURE).read_bytes().splitlines():
        event = json.loads(line)
        if event.get("topic") in ("offer", "measurement"):
            message = event["message"]
            # in this loop each step is a transition: k counts them
            number = schedule.block_of(message["k"])
            if message["nonce"] and number >= 0:
                found[number].append(as_bytes(message["nonce"]))
    return found


def forms(secret: bytes) -> tuple[bytes, ...]:
    """How it may stand in a file."""
    return secret, base64.b64encode(secret), secret.hex().encode()


@pytest.mark.parametrize("side", SIDES)
def test_no_nonce_of_a_block_that_is_over_and_no_key_that_was_begun_is_in_any_file(
    stopped: Stopped, side: Side
) -> None:
    files, of = contents(stopped.folder, side), nonces(stopped.folder)
    last = newest(stopped, side)
    looked_at, left = 0, False
    for block, keys in stopped.keys.items():
        assert keys
        over, first = list(of[block]), 0
        for key in keys:
            if Position(block, first) <= last:
                over.append(key)
            else:
                left |= any(key in data for data in files.values())
            first += len(digits(key, 4))
        for secret in over:
            looked_at += 1
            for name, data in files.items():
                found = any(form in data for form in forms(secret))
                assert not found, f"{name}: of block {block}"
    assert looked_at > 250
    assert left, "such a look finds keys that are to come"
    # and such a look finds what is there: the block that is under way
    rest = [nonce for block, some in of.items() if block > max(stopped.keys) for nonce in some]
    assert any(form in data for n in rest for form in forms(n) for data in files.values())


@pytest.mark.parametrize("side", SIDES)
def test_no_digit_that_has_served_is_in_any_file(stopped: Stopped, side: Side) -> None:
    """A digit is a byte of a part in the journal; those that are left of the key in use stand
    side by side there."""
    files = contents(stopped.folder, side)
    last = newest(stopped, side)
    looked_at, left = 0, False
    for block, keys in stopped.keys.items():
        first = 0
        for key in keys:
            row = bytes(digits(key, 4))
            for at in range(0, len(row) - RUN + 1, RUN):
                run = row[at : at + RUN]
                there = any(run in data for data in files.values())
                if Position(block, first + at + RUN - 1) <= last:
                    looked_at += 1
                    assert not there, f"digits of block {block} that have served"
                left |= there
            first += len(row)
    assert looked_at >= 4
    assert left, "such a look finds digits that are to come"


def newest(stopped: Stopped, side: Side) -> Position:
    """Of the digits that have served, as an end has counted."""
    steps = events_of(stopped.folder / TRACES[side], "transition")
    return max(Position(*e["digits"]) for e in steps if e.get("keyed"))
