"""The key stores of a run: each holds what its end stored."""

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Final

from protocol.secret.records import Side, key_id
from runtime.keys.store import TOMBSTONES, KeyStore
from runtime.keys.store_file import check_of

from wyner.runs.check.base import Check, Counter
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.key_blocks import FILES, TracedBlocks, open_store
from wyner.runs.check.records import (
    BlockJudgedLine,
    BlockStoredLine,
    Item,
    OtherLine,
    SessionLine,
    Walked,
)

KEY_BYTES: Final = 32

At = tuple[str, int]
"""A block: its session and number."""

_AFTER: Final = {
    "stored": ("stored", "delivered", "dropped"),
    "confirmed": ("confirmed", "delivered", "dropped"),
    "dropped": ("delivered", "dropped"),
    "empty": (),
}
"""States in which the keys of a block in each state can be."""

_JUDGED: Final = {"confirmed": "confirmed", "unequal": "dropped"}
"""What a block becomes by the partner's word."""


@dataclass(slots=True)
class _End:
    """What one end's trace says of its key store."""

    blocks: TracedBlocks
    sessions: dict[str, int] = field(default_factory=dict)
    judged: dict[At, str] = field(default_factory=dict)

    def feed(self, item: Item) -> None:
        if isinstance(item, Walked):
            self._session(item.t.session)
            self.blocks.transition(item.t)
        elif isinstance(item, OtherLine) and isinstance(item.line, SessionLine):
            self._session(item.line.session or "")
        elif isinstance(item, OtherLine) and isinstance(item.line, BlockStoredLine):
            self.blocks.stored[item.line.session, item.line.number] = item.line.keys
        elif isinstance(item, OtherLine) and isinstance(item.line, BlockJudgedLine):
            self.judged[item.line.session, item.line.number] = item.line.what

    def _session(self, session: str) -> None:
        self.sessions.setdefault(session, len(self.sessions))

    def older(self, at: At, store: KeyStore) -> bool:
        """Whether a block began before its store, which took the place of one that was removed."""
        begun, _, transitions = (store.note("begun") or "None/0").rpartition("/")
        if begun == "None":
            return False
        if at[0] == begun:
            return self.blocks.schedule.begins(at[1]) < int(transitions)
        return self.sessions.get(at[0], 0) < self.sessions.get(begun, len(self.sessions))


class KeyStores(Check):
    """Each end's store holds the blocks that its trace says were stored, with all their keys."""

    name = "key-stores"
    source = "rule 10"
    says = "each store holds what its end stored, and nobody changed it"
    of = "rows"

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        schedule = evidence.rules.schedule
        assert schedule is not None
        self._ends = {side: _End(TracedBlocks(schedule)) for side, _ in evidence.readers()}

    def feed(self, part: Part) -> None:
        for name, items in part.sides():
            for item in items:
                self._ends[name].feed(item)

    def finish(self) -> None:
        e, counter = self.evidence, self.counter
        with ExitStack() as stack:
            stores: dict[Side, KeyStore] = {}
            for side, name in FILES:
                end = self._ends.get(side)
                store = open_store(e, side, name, counter, stack)
                if store is not None:
                    stores[side] = store
                    _Store(side, store, counter).look(e, end)
                elif end is not None and not (e.run_dir / name).exists():
                    for at in end.blocks.stored:
                        text = f"the {side}'s key store is gone, and block {at[1]} was stored in it"
                        counter.count(False, at[0], -1, -1, text)
            if len(stores) == len(FILES):
                _same(stores["controller"], stores["plant"], counter)
        if not counter.counted and not stores:
            counter.skipped = "no key store in this run's folder"


@dataclass(slots=True)
class _Store:
    """One end's store, looked at row by row."""

    side: Side
    store: KeyStore
    counter: Counter

    def look(self, e: Evidence, end: _End | None) -> None:
        blocks = self._blocks()
        self._keys(blocks)
        assert e.scenario.keys is not None
        claim = e.scenario.keys.assumption().sentence()
        told = self.store.note("assumption")
        self._count(told in (None, claim), "", "its claim is not the scenario's")
        if end is not None:
            self._as_traced(e, end, {(b["session"], b["number"]): b for b in blocks})

    def _count(self, holds: bool, session: str, text: str) -> None:
        self.counter.count(holds, session, -1, -1, f"the {self.side}'s key store: {text}")

    def _blocks(self) -> list[dict[str, Any]]:
        names = "place, session, number, transitions, steps, counted, rows, keys, state, tag"
        found = []
        for *row, check in self.store.rows(f"SELECT {names}, check_ FROM block ORDER BY place"):
            b = dict(zip(names.split(", "), row, strict=True))
            found.append(b)
            good = check == check_of(b["session"], b["number"], b["tag"], b["keys"])
            most = max(0, b["rows"] - 1)
            good = good and b["state"] in _AFTER and b["keys"] in (0, most)
            self._count(good, b["session"], f"block {b['number']} is not as it was written")
        return found

    def _keys(self, blocks: list[dict[str, Any]]) -> None:
        """Rows 1, 2, ... of every block, under their ids; the oldest of a million may be gone."""
        expected = [
            (b["place"], row, key_id(b["session"], b["number"], row), b)
            for b in blocks
            for row in range(1, b["keys"] + 1)
        ]
        rows = self.store.rows(
            "SELECT block, row, id, own, state, body, check_, t_ns FROM key ORDER BY place"
        )
        lacking = max(0, len(expected) - TOMBSTONES) if len(rows) == TOMBSTONES else 0
        expected = expected[lacking:]
        text = f"it has {len(rows)} keys, its blocks made {len(expected)}"
        self._count(len(rows) == len(expected), "", text)
        odd_is_own = self.side == "controller"
        for row, wanted in zip(rows, expected, strict=False):
            *at, own, state, body, check, t_ns = row
            place, number, name, block = wanted
            kept = state in ("stored", "confirmed")
            good = at == [place, number, name] and own == ((number % 2 == 1) == odd_is_own)
            good = good and state in _AFTER.get(block["state"], ())
            good = good and (t_ns is not None) == (state == "delivered")
            if kept:
                good = good and body is not None and len(body) == KEY_BYTES
                good = good and check == check_of(name, number, own, body)
            else:
                good = good and body is None
            self._count(good, block["session"], f"key {name} is not as it was written")

    def _as_traced(self, e: Evidence, end: _End, blocks: dict[At, dict[str, Any]]) -> None:
        reader = dict(e.readers())[self.side]
        for at, keys in end.blocks.stored.items():
            block = blocks.get(at)
            if block is None:
                gone = end.older(at, self.store)
                self._count(gone, at[0], f"block {at[1]} was stored in it, and is not there")
                continue
            text = f"block {at[1]} has {block['keys']} keys, the trace says {keys}"
            self._count(keys in (0, block["keys"]), at[0], text)
            what = end.judged.get(at)
            text = f"block {at[1]} is {block['state']}, the trace says {what}"
            self._count(what is None or block["state"] == _JUDGED[what], at[0], text)
        if reader.gone or reader.behind:
            return  # what is left of the trace is not all that its blocks were made of
        for at, block in blocks.items():
            traced = end.blocks.whole(at)
            if traced is not None:
                said = [block[name] for name in ("transitions", "steps", "counted", "rows")]
                made = [traced.transitions, traced.steps, traced.counted, end.blocks.rows(traced)]
                text = f"block {at[1]} has (N, K, C, R) = {said}, its transitions make {made}"
                self._count(said == made, at[0], text)


def _same(controller: KeyStore, plant: KeyStore, counter: Counter) -> None:
    """Keys that both ends still hold are the same."""
    rows = "SELECT id, body FROM key WHERE state = 'confirmed'"
    mine, theirs = dict(controller.rows(rows)), dict(plant.rows(rows))
    for name in mine.keys() & theirs.keys():
        counter.count(mine[name] == theirs[name], "", -1, -1, f"key {name} differs at the two ends")
