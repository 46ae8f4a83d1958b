"""The table of a fleet: what it says of each loop, and who comes first."""

import os
import pty
import termios
from pathlib import Path

import pytest

from controller_service.laws.base import CandidateLaw
from controller_service.service import ControllerConfig, open_controller
from plant_service.service import PlantConfig, open_plant
from protocol.messages import ControllerStatus, Message, PlantStatus, TapStatus
from protocol.scenario import Scenario
from protocol.topics import key_of
from runtime.memory_bus import MemoryBus, MemoryHub
from runtime.pace import Pace
from wyner.dashboard import fleet as fleet_module
from wyner.dashboard.fleet import COLUMNS, PRINTED, SILENT_S, FleetTable, plain, watch
from wyner.dashboard.model import TAPS_KEPT
from wyner.dashboard.source import WAITING_AT_MOST

TAP = TapStatus(
    seq=1, t_ns=1, name="nearest-centre", steps=9, lost=2, mirrored=20, dropped=0,
    behind=0, malformed=0, message="hi", confidence=0.97, candidates_left=0,
    solved_k=5,
)  # fmt: skip


class Fleet:
    """Three loops on hubs in memory, and the table that watches them."""

    def __init__(self, scenario: Scenario, law: CandidateLaw, folder: Path) -> None:
        management, adversary = MemoryHub(), MemoryHub()
        self.table = FleetTable()
        self.table.attach(MemoryBus(management), MemoryBus(adversary))
        self.management, self._adversary = MemoryBus(management), MemoryBus(adversary)
        plant, files = open_plant(PlantConfig(scenario, folder, "a", Pace("realtime")), 0.0)
        files.close()
        self.plant = plant.status(0.0).model_copy(update={"phase": "running"})
        config = ControllerConfig(scenario, folder, "a", law)
        controller, files = open_controller(config)
        files.close()
        self.controller = controller.status()

    def say(self, loop: str, status: Message, **changes: object) -> None:
        bus = self._adversary if isinstance(status, TapStatus) else self.management
        told = status.model_copy(update=changes)
        bus.publisher(key_of(type(status), loop)).put(told.wire())


def lines(fleet: Fleet, now_s: float, width: int = PRINTED, most: int | None = None) -> list[str]:
    return plain(fleet.table.shown(now_s, width, most))


@pytest.fixture
def fleet(sustained: Scenario, sustained_law: CandidateLaw, tmp_path: Path) -> Fleet:
    return Fleet(sustained, sustained_law, tmp_path)


def test_who_is_in_trouble_comes_first(fleet: Fleet) -> None:
    for loop in ("a", "b", "c"):
        fleet.say(loop, fleet.plant, k=100)
    fleet.table.take(0.0)
    fleet.say("a", fleet.plant, k=110)
    fleet.say("c", fleet.plant, k=110, missed=7)
    fleet.table.take(SILENT_S + 1)
    total, header, *rows = lines(fleet, SILENT_S + 1)
    assert total == "2 of 3 loops run, 7 steps missed, 7 of them lately"
    assert all(column.title in header for column in COLUMNS)
    assert [row.split()[:2] for row in rows] == [
        ["b", "silent"],
        ["c", "running"],
        ["a", "running"],
    ]
    assert rows[1].split()[2:5] == ["110", "7", "7"]


def test_a_claim_stands_beside_the_truth(fleet: Fleet) -> None:
    for loop, last in (("a", "hi"), ("b", "no"), ("c", "")):
        fleet.say(loop, fleet.plant, last_message=last)
        fleet.say(loop, fleet.controller, queue=4)
        fleet.say(loop, TAP)
        fleet.say(loop, TAP, name="set-membership", confidence=0.1, message="x")
    fleet.table.take(1.0)
    rows = lines(fleet, 1.0)[2:]
    claims = [row.partition("nearest-centre is ")[2] for row in rows]
    assert claims == ["97 % sure, right, 2 lost", "97 % sure, wrong, 2 lost", "97 % sure, 2 lost"]
    assert all(row.split()[-9 if "right" in row or "wrong" in row else -8] == "4" for row in rows)


def test_keys_made_and_bits_held_are_told(fleet: Fleet) -> None:
    fleet.say("a", fleet.plant, keys_made=63)
    fleet.say("a", TAP)
    fleet.say("a", TAP, name="key-solver", confidence=0.0, key_bits_held=512)
    fleet.table.take(1.0)
    _, header, row = lines(fleet, 1.0)
    at = header.index("keys made")
    assert row[at : at + 9].strip() == "63"
    assert row.endswith("2 lost, 512 bits of keys held")


def test_a_long_table_is_cut_where_the_loops_are_well(fleet: Fleet) -> None:
    for number in range(20):
        fleet.say(f"loop-{number:02d}", fleet.plant, missed=number)
    fleet.table.take(0.0)
    cut = lines(fleet, 0.0, most=10)
    assert len(cut) == 10
    assert cut[-1] == "... and 13 more that are well or better"


def test_a_narrow_table_drops_whole_columns(fleet: Fleet) -> None:
    fleet.say("a", fleet.plant, k=123)
    fleet.say("a", TAP)
    fleet.table.take(0.0)
    for width in (60, 80, 120, 200):
        _, header, row = lines(fleet, 0.0, width)
        assert all(len(text) <= width for text in (header, row))
        named = [column for column in COLUMNS if column.title in header]
        left_out = [column for column in COLUMNS if column not in named]
        assert max(c.rank for c in named) < min((c.rank for c in left_out), default=99)
        assert "..." not in row
        assert "…" not in row


def test_malformed_bytes_and_terminal_codes_do_no_harm(
    fleet: Fleet, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet.management.publisher(key_of(PlantStatus, "a")).put(b"{")
    fleet.management.publisher(key_of(ControllerStatus, "a")).put(b"\xff")
    fleet.say("a", fleet.plant, k=5)
    fleet.say("a", TAP, name="\x1b[31mred")
    looks = iter([False, True])
    watch(fleet.table, lambda: next(looks), screen=False)
    said = capsys.readouterr().out
    assert fleet.table.malformed == 2
    assert "1 of 1 loops run" in said
    assert "0 of them lately; 2 messages were malformed\n" in said
    assert "\x1b" not in said


def test_q_leaves_the_screen_and_gives_the_terminal_back(fleet: Fleet) -> None:
    leader, follower = pty.openpty()
    before = termios.tcgetattr(follower)

    def types_and_goes_on() -> bool:
        os.write(leader, b"xq")
        return False

    watch(fleet.table, types_and_goes_on, screen=True, keyboard=follower)
    assert termios.tcgetattr(follower) == before
    os.close(leader)
    os.close(follower)


def test_a_plant_that_counts_anew_has_missed_nothing_less_than_nothing(fleet: Fleet) -> None:
    for now_s, missed in enumerate((5, 9, 0, 2)):
        fleet.say("a", fleet.plant, missed=missed)
        fleet.table.take(float(now_s))
    assert lines(fleet, 3.0)[0].endswith("2 steps missed, 2 of them lately")


def test_a_flood_takes_a_bounded_room(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of bytes between two looks, of loops, and of eavesdroppers of a loop."""
    monkeypatch.setattr(fleet_module, "LARGEST_FLEET", 3)
    for number in range(TAPS_KEPT + 5):
        fleet.say(f"loop-{number}", fleet.plant)
        fleet.say("loop-0", TAP, name=f"tap-{number}", confidence=number / 100)
    fleet.table.take(0.0)
    total, _, *rows = lines(fleet, 0.0)
    assert total.startswith("3 of 3 loops run")
    claims = [row for row in rows if row.startswith("loop-0")]
    assert f"tap-{TAPS_KEPT - 1} is {TAPS_KEPT - 1} % sure" in claims[0]
    beyond = WAITING_AT_MOST // 2**18 + 4
    for _ in range(beyond):
        fleet.management.publisher(key_of(PlantStatus, "loop-0")).put(bytes(2**18))
    fleet.table.take(0.0)
    assert lines(fleet, 0.0)[0].endswith("; 5 came faster than they were read")
    assert fleet.table.malformed == beyond - 5
