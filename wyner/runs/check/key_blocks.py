"""The clauses of keys: nonces leave once, both ends count alike, blocks and ids are the same."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Final

from protocol.secret.blocks import Schedule
from protocol.secret.records import Side, StoreError
from runtime.keys.ledger import spent_rows
from runtime.keys.store import KeyStore
from runtime.run_folder import CONTROLLER_KEYS, PLANT_KEYS
from wyner.runs.check.clause import Judging, Tally, need, to_the_end
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.records import BlockStoredLine, Told, TracedTransition, Walked

FILES: Final[tuple[tuple[Side, str], ...]] = (
    ("controller", str(CONTROLLER_KEYS)),
    ("plant", str(PLANT_KEYS)),
)


def nonce_once(e: Evidence, tally: Tally) -> Judging:
    """No nonce travels twice, as copy 0 or as a dummy."""
    if not need(tally, capture=e.wire):
        return
    known: set[int] = set()
    while (part := (yield)) is not None:
        for seen in part.seen:
            nonce = hash(str(seen.message.get("nonce")))
            text = f"{seen.where}: {seen.topic} {seen.k} carries a nonce that was there before"
            tally.count(nonce not in known, seen.session, -1, seen.k, text)
            known.add(nonce)


def copy_0_once(e: Evidence, tally: Tally) -> Judging:
    """A step's copy 0 leaves at most once."""
    if not need(tally, capture=e.wire):
        return
    known: set[tuple[str, str, int]] = set()
    while (part := (yield)) is not None:
        for seen in part.seen:
            if seen.message.get("copy_number") == 0:
                at = (seen.topic, seen.session, seen.k)
                text = f"{seen.where}: a second copy 0 of {seen.topic} {seen.k}"
                tally.count(at not in known, seen.session, -1, seen.k, text)
                known.add(at)


def counted(e: Evidence, tally: Tally) -> Judging:
    """Both ends count the same copies of a transition, and those that they named."""
    if not need(tally, plant_trace=e.plant):
        return
    counts: dict[tuple[str, int], tuple[int, int]] = {}
    while (part := (yield)) is not None:
        for plant, controller in part.pairs:
            if plant is not None:
                t = plant.t
                counts[t.session, t.k] = (t.counts, t.j)
                if controller is not None:
                    text = f"the plant counts {t.counts}, the controller {controller.t.counts}"
                    same = t.counts == controller.t.counts
                    tally.count(same, t.session, t.j, t.k, text)
        for seen in part.seen:
            if e.before(seen):
                continue
            named = seen.message.get("applied_copy" if seen.topic == "measurement" else "heard")
            bit = 1 if seen.topic == "measurement" else 2
            k = seen.message.get("applied_k", -1) if bit == 1 else seen.k
            mine, j = counts.get((seen.session, k), (0, 0)) if isinstance(k, int) else (0, 0)
            text = f"{seen.where}: copy {named} was taken, and the plant counts {mine}"
            tally.count(not (j and named and mine & bit), seen.session, j, k, text)


@dataclass(slots=True)
class TracedBlock:
    """A block as one end's transitions make it."""

    transitions: int = 0
    steps: int = 0
    counted: int = 0


@dataclass(slots=True)
class TracedBlocks:
    """The blocks of one end's trace, from its transitions, and those it says it stored."""

    schedule: Schedule
    blocks: dict[tuple[str, int], TracedBlock] = field(default_factory=dict)
    stored: dict[tuple[str, int], int] = field(default_factory=dict)
    last_k: dict[str, int] = field(default_factory=dict)

    def transition(self, t: TracedTransition) -> None:
        """Count the next transition."""
        before = self.last_k.get(t.session, t.k)
        self.last_k[t.session] = t.k
        number = self.schedule.block_of(t.j)
        if number >= 0:
            block = self.blocks.setdefault((t.session, number), TracedBlock())
            block.transitions += 1
            block.steps += t.k - before
            block.counted += self.schedule.assumption.counting(t.counts).bit_count()

    def whole(self, at: tuple[str, int]) -> TracedBlock | None:
        """A block all of whose transitions were traced."""
        block = self.blocks.get(at)
        return block if block and block.transitions == self.schedule.length(at[1]) else None

    def rows(self, block: TracedBlock) -> int:
        """R of a block."""
        return self.schedule.assumption.rows(block.transitions, block.steps, block.counted)

    def keys(self, at: tuple[str, int], *, signed: bool) -> int | None:
        """How many keys a block must have made; None where it is not whole."""
        block = self.whole(at)
        if block is None:
            return None
        rows = self.rows(block)
        return max(0, rows - (spent_rows(rows) if signed else 1))


def blocks(e: Evidence, tally: Tally) -> Judging:
    """Every block makes as many keys as its transitions allow, at both ends."""
    if not need(tally, plant_trace=e.plant, controller_trace=e.controller):
        return
    assert e.rules.schedule is not None
    ends = {side: TracedBlocks(e.rules.schedule) for side, _ in e.readers()}
    readers = dict(e.readers())
    while (part := (yield)) is not None:
        for side, line in _lines(part):
            if isinstance(line, TracedTransition):
                ends[side].transition(line)
            else:
                ends[side].stored[line.session, line.number] = line.keys
    signed = {side for side, name in _notes(e, "secret").items() if name}
    for side, end in ends.items():
        cut = readers[side].cut
        for at, keys in end.stored.items():
            if cut and at[0] == cut.session and at[1] <= e.rules.schedule.block_of(cut.j + 1):
                continue  # it began before what is left
            expected = end.keys(at, signed=side in signed)
            text = f"the {side} made {keys} keys of block {at[1]}, expected {expected}"
            # a block without a pad for its tag makes none
            tally.count(keys == expected or not keys, at[0], -1, -1, text)
    plant, controller = ends["plant"], ends["controller"]
    for at in plant.stored.keys() & controller.stored.keys():
        made = plant.stored[at], controller.stored[at]
        text = f"block {at[1]}: {made[0]} keys at the plant, {made[1]} at the controller"
        tally.count(len(set(made)) == 1, at[0], -1, -1, text)
    made_in_all = sum(plant.stored.values())
    tally.note = f"{made_in_all} keys made of {len(plant.stored)} blocks at the plant"


def _lines(part: Part) -> Iterator[tuple[str, TracedTransition | BlockStoredLine]]:
    for side, items in part.sides():
        for item in items:
            if isinstance(item, Walked):
                yield side, item.t
            elif isinstance(item, Told) and isinstance(item.line, BlockStoredLine):
                yield side, item.line


def tags(e: Evidence, tally: Tally) -> Judging:
    """Each end shows one tag for a block, and the same as its partner where tags are public."""
    if not need(tally, capture=e.wire):
        return
    known: dict[tuple[str, str, int], str] = {}
    while (part := (yield)) is not None:
        for seen in part.seen:
            block, tag = seen.message.get("block", -1), str(seen.message.get("tag"))
            if isinstance(block, int) and block >= 0:
                first = known.setdefault((seen.topic, seen.session, block), tag)
                text = f"{seen.where}: block {block} has another tag than before"
                tally.count(first == tag, seen.session, -1, seen.k, text)
    signed = any(_notes(e, "secret").values())
    for (topic, session, block), tag in known.items():
        other = known.get(("offer", session, block))
        if topic == "measurement" and other is not None and not signed:
            tally.count(tag == other, session, -1, -1, f"block {block}: the ends' tags differ")
    tally.note = "signed with a shared secret" if signed else "public"


def pads_once(_e: Evidence, tally: Tally) -> Judging:
    """A set of pads signs one block, at whichever end."""
    owner: dict[str, tuple[str, int]] = {}
    while (part := (yield)) is not None:
        for side, line in _lines(part):
            if not isinstance(line, BlockStoredLine) or not line.signed:
                continue
            at = line.session, line.number
            first = owner.setdefault(line.signed, at)
            text = f"the {side} signs block {at[1]} of session {at[0]} under {line.signed}, which "
            text += f"signed block {first[1]} of session {first[0]}"
            tally.count(first == at, line.session, -1, -1, text)
    if not owner:
        tally.skipped = "no block is signed"


def given_once(e: Evidence, tally: Tally) -> Judging:
    """What one end gave has its mark at the other, for the same use."""
    yield from to_the_end()
    with ExitStack() as stack:
        stores = [open_store(e, side, name, tally, stack) for side, name in FILES]
        if not all(stores):
            tally.skipped = tally.skipped or "no key store at one of the ends"
            return
        uses = [store.uses() for store in stores if store is not None]
        unknown = 0
        for mine, theirs in (uses, uses[::-1]):
            for name, (given, _) in mine.items():
                mark = theirs.get(name, ("", ""))[1]
                if given and mark:
                    text = f"key {name} was given for {given!r}, and its mark is {mark!r}"
                    tally.count(given == mark, "", -1, -1, text)
                unknown += bool(given) and not mark
    if unknown:
        tally.note = f"{unknown} more have no mark: a key store was put back, or removed"


def key_ids(e: Evidence, tally: Tally) -> Judging:
    """Both stores hold the same ids in the same order, in disjoint halves."""
    yield from to_the_end()
    with ExitStack() as stack:
        stores = [open_store(e, side, name, tally, stack) for side, name in FILES]
        if not all(stores):
            tally.skipped = tally.skipped or "no key store at one of the ends"
            return
        mine, theirs = (store.ids() for store in stores if store is not None)
        names = [name for name, _ in mine], [name for name, _ in theirs]
        shared = set(names[0]) & set(names[1])
        pairs = zip(
            (n for n in names[0] if n in shared), (n for n in names[1] if n in shared), strict=True
        )
        for a, b in pairs:
            tally.count(a == b, "", -1, -1, f"key {a} at the controller stands where {b} does")
        own = [store.own_ids() for store in stores if store is not None]
        both = set(own[0]) & set(own[1])
        tally.count(not both, "", -1, -1, f"{len(both)} keys belong to both halves")


def refused_at_zero(e: Evidence, tally: Tally) -> Judging:
    """Where nothing is claimed there is no nonce and no key; a seeded run's keys are refused."""
    while (part := (yield)) is not None:
        if e.rules.schedule is not None:
            continue
        for seen in part.seen:
            empty = not seen.message.get("nonce") and not seen.message.get("tag")
            text = f"{seen.where}: a nonce or a tag, and no key is claimed"
            tally.count(empty, seen.session, -1, seen.k, text)
        for side, line in _lines(part):
            if isinstance(line, TracedTransition):
                text = f"the {side} counts copies, and no key is claimed"
                tally.count(not line.counts, line.session, line.j, line.k, text)
    seeded = (e.manifest or {}).get("seed") is not None
    if e.scenario.keys is None or (e.rules.schedule is not None and not seeded):
        return
    for side, note in _notes(e, "refused").items():
        tally.count(bool(note), "", -1, -1, f"the {side}'s keys are not refused")


def open_store(
    e: Evidence, side: Side, name: str, tally: Tally, stack: ExitStack
) -> KeyStore | None:
    """A copy of a side's key store, if it is there; one that cannot be read fails the clause."""
    path = e.run_dir / name
    if not path.is_file():
        return None
    try:
        return stack.enter_context(KeyStore.copy_of(path, side))
    except StoreError as error:
        tally.fail("", -1, -1, str(error))
        return None


def _notes(e: Evidence, note: str) -> dict[Side, str | None]:
    """A note of each store that is there."""
    found: dict[Side, str | None] = {}
    with ExitStack() as stack:
        for side, name in FILES:
            store = open_store(e, side, name, Tally(), stack)
            if store is not None:
                found[side] = store.note(note)
    return found
