"""Keys that were delivered cannot be made again from any file of an end that has stopped."""

import base64
import json
from collections import defaultdict
from pathlib import Path

import pytest
from runtime.keys.store import KeyStore

from protocol.secret.blocks import Blocks
from protocol.secret.nonces import as_bytes
from runtime.journal import ControllerJournal, PlantJournal
from runtime.run_folder import (
    CAPTURE,
    CONTROLLER_JOURNAL,
    CONTROLLER_KEYS,
    PLANT_JOURNAL,
    PLANT_KEYS,
    SCENARIO,
)
from runtime.scenario_file import load_scenario
from tests.support.giving import deliver, deliver_named
from tests.support.recorded_loop import RecordedLoop
from tests.support.two_ends import SIDES


def confirmed(loop: RecordedLoop, block: int) -> bool:
    """Whether both ends have it on disk that a block is confirmed."""
    key_makers = [end.key_maker for end in loop.ends.values()]
    rows = [k.store.blocks(last=1) for k in key_makers if k is not None]
    return all(row and (row[0].number, row[0].state) == (block, "confirmed") for row in rows)


@pytest.fixture(scope="module", params=["at the last confirmation", "later"])
def stopped(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose ends have stopped, with all its keys delivered at both."""
    loop = RecordedLoop(tmp_path_factory.mktemp("erased") / "run", b"", "keys")
    if request.param == "later":
        loop.run(lambda: loop.transitions >= 400)
    else:
        loop.run(lambda: loop.transitions >= 300)
        loop.run(lambda: confirmed(loop, 2))
    loop.stop()
    folder = loop.folder
    with (
        KeyStore(folder / CONTROLLER_KEYS, "controller") as controller,
        KeyStore(folder / PLANT_KEYS, "plant") as plant,
    ):
        for mine, theirs in ((controller, plant), (plant, controller)):
            keys = deliver(mine, mine.available(), partner=theirs)
            ids = [key.key_id for key in keys]
            assert deliver_named(theirs, ids, partner=mine) == keys
        assert plant.counts().delivered == controller.counts().delivered == 63
    return folder


def delivered_blocks(folder: Path) -> set[tuple[str, int]]:
    with KeyStore(folder / PLANT_KEYS, "plant") as store:
        return {(b.session, b.number) for b in store.blocks() if b.state == "confirmed"}


def nonces(folder: Path) -> dict[tuple[str, int], list[bytes]]:
    """The nonces of every key block, as the wire carried them."""
    keys = load_scenario(folder / SCENARIO).keys
    assert keys is not None
    schedule = keys.schedule()
    assert schedule is not None
    found: dict[tuple[str, int], list[bytes]] = defaultdict(list)
    for line in (folder / CAPTURE).read_bytes().splitlines():
        event = json.loads(line)
        if event.get("topic") in ("offer", "measurement"):
            message = event["message"]
            # in this loop each step is a transition: k counts them
            number = schedule.block_of(message["k"])
            if message["nonce"] and number >= 0:
                found[message["session"], number].append(as_bytes(message["nonce"]))
    return found


def test_no_nonce_of_a_delivered_key_is_in_any_file(stopped: Path) -> None:
    blocks, of = delivered_blocks(stopped), nonces(stopped)
    assert len(blocks) >= 3
    looked_at = 0
    for side in SIDES:
        for path in (stopped / side).rglob("*"):
            if path.is_file():
                data = path.read_bytes()
                for at in blocks:
                    for nonce in of[at]:
                        looked_at += 1
                        assert nonce not in data, f"{path.name}: a nonce of block {at[1]}"
                        text = base64.b64encode(nonce)
                        assert text not in data, f"{path.name}: a nonce of block {at[1]}"
    assert looked_at > 1000
    # and such a look finds what is there: the block that is under way
    rest = [n for at, some in of.items() if at not in blocks for n in some]
    data = b"".join(p.read_bytes() for p in stopped.rglob("journal*"))
    assert any(nonce in data or base64.b64encode(nonce) in data for nonce in rest)


def test_no_delivered_block_can_be_made_from_either_journal(stopped: Path) -> None:
    scenario = load_scenario(stopped / SCENARIO)
    assert scenario.keys is not None
    schedule = scenario.keys.schedule()
    assert schedule is not None
    for kind, path in ((ControllerJournal, CONTROLLER_JOURNAL), (PlantJournal, PLANT_JOURNAL)):
        with kind(stopped / path, scenario.fingerprint()) as journal:
            record, *_, rows, _, _ = journal.load()
            assert record is not None
            assert record.session is not None
            blocks = Blocks(schedule, record.session, -1, "", rows)
            made = blocks.to_keep()
            assert made is None or (record.session, made.number) not in delivered_blocks(stopped)
