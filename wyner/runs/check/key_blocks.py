"""The checks of keys: nonces leave once, both ends count alike, blocks and tags are the same."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from protocol.secret.blocks import Schedule
from wyner.runs.check.base import Check, Counter
from wyner.runs.check.capture import CapturedMessage
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.records import BlockLine, OtherLine, TracedTransition, Walked


class NonceOnce(Check):
    """No nonce travels twice, as copy 0 or as a dummy."""

    name = "nonce-once"
    source = "rule 8"
    says = "no nonce travels twice"
    of = "messages"
    needs = ("wire",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._known: set[int] = set()

    def feed(self, part: Part) -> None:
        for seen in part.seen:
            nonce = hash(str(seen.message.get("nonce")))
            text = f"{seen.where}: {seen.topic} {seen.k} carries a nonce that was there before"
            self.counter.count(nonce not in self._known, seen.session, -1, seen.k, text)
            self._known.add(nonce)


class Copy0Once(Check):
    """A step's copy 0 leaves at most once."""

    name = "copy-0-once"
    source = "rule 8"
    says = "a step's copy 0 leaves at most once"
    of = "copies 0"
    needs = ("wire",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._known: set[tuple[str, str, int]] = set()

    def feed(self, part: Part) -> None:
        for seen in part.seen:
            if seen.message.get("copy_number") == 0:
                at = (seen.topic, seen.session, seen.k)
                text = f"{seen.where}: a second copy 0 of {seen.topic} {seen.k}"
                self.counter.count(at not in self._known, seen.session, -1, seen.k, text)
                self._known.add(at)


class Counted(Check):
    """Both ends count the same copies of a transition, and those that they named."""

    name = "counted"
    source = "rule 9"
    says = "both ends count the same copies"
    of = "transitions"
    needs = ("plant",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._counts: dict[tuple[str, int], tuple[int, int]] = {}

    def feed(self, part: Part) -> None:
        for plant, controller in part.pairs:
            if plant is None:
                continue
            t = plant.t
            self._counts[t.session, t.k] = (t.counts, t.j)
            if controller is not None:
                text = f"the plant counts {t.counts}, the controller {controller.t.counts}"
                same = t.counts == controller.t.counts
                self.counter.count(same, t.session, t.j, t.k, text)
        for seen in part.seen:
            if not self.evidence.before(seen):
                self._named(seen)

    def _named(self, seen: CapturedMessage) -> None:
        """A copy that a message says was taken counts nothing for the plant."""
        by_controller = seen.topic == "measurement"
        named = seen.message.get("applied_copy" if by_controller else "heard")
        bit = 1 if by_controller else 2
        k = seen.message.get("applied_k", -1) if by_controller else seen.k
        mine, j = self._counts.get((seen.session, k), (0, 0)) if isinstance(k, int) else (0, 0)
        text = f"{seen.where}: copy {named} was taken, and the plant counts {mine}"
        self.counter.count(not (j and named and mine & bit), seen.session, j, k, text)


@dataclass(slots=True)
class TracedBlock:
    """A block as one end's transitions make it."""

    transitions: int = 0
    steps: int = 0
    counted: int = 0


@dataclass(slots=True)
class TracedBlocks:
    """The blocks of one end's trace, from its transitions, and those it says were confirmed."""

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

    def keys(self, at: tuple[str, int]) -> int | None:
        """How many keys a block must have made; None where it is not whole."""
        block = self.whole(at)
        if block is None:
            return None
        return max(0, self.rows(block) - 1)


class Blocks(Check):
    """Every block makes as many keys as its transitions allow, at both ends."""

    name = "blocks"
    source = "rule 10"
    says = "a block makes as many keys as its transitions allow"
    of = "blocks"
    needs = ("plant", "controller")

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        assert evidence.rules.schedule is not None
        self._schedule = evidence.rules.schedule
        self._ends = {side: TracedBlocks(self._schedule) for side, _ in evidence.readers()}

    def feed(self, part: Part) -> None:
        for side, line in _lines(part):
            if isinstance(line, TracedTransition):
                self._ends[side].transition(line)
            elif line.what == "confirmed":
                self._ends[side].stored[line.session, line.number] = line.keys

    def finish(self) -> None:
        readers = dict(self.evidence.readers())
        for side, end in self._ends.items():
            cut = readers[side].cut
            for at, keys in end.stored.items():
                if cut and at[0] == cut.session and at[1] <= self._schedule.block_of(cut.j + 1):
                    continue  # it began before what is left
                expected = end.keys(at)
                text = f"the {side} made {keys} keys of block {at[1]}, expected {expected}"
                self.counter.count(keys == expected, at[0], -1, -1, text)
        plant, controller = self._ends["plant"], self._ends["controller"]
        for at in plant.stored.keys() & controller.stored.keys():
            made = plant.stored[at], controller.stored[at]
            text = f"block {at[1]}: {made[0]} keys at the plant, {made[1]} at the controller"
            self.counter.count(made[0] == made[1], at[0], -1, -1, text)
        made_in_all = sum(plant.stored.values())
        self.counter.note = f"{made_in_all} keys made of {len(plant.stored)} blocks at the plant"


def _lines(part: Part) -> Iterator[tuple[str, TracedTransition | BlockLine]]:
    for side, items in part.sides():
        for item in items:
            if isinstance(item, Walked):
                yield side, item.t
            elif isinstance(item, OtherLine) and isinstance(item.line, BlockLine):
                yield side, item.line


class Tags(Check):
    """Each end shows one tag for a block, and the same as its partner."""

    name = "tags"
    source = "rule 10"
    says = "a block has one tag"
    of = "messages"
    needs = ("wire",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._known: dict[tuple[str, str, int], str] = {}

    def feed(self, part: Part) -> None:
        for seen in part.seen:
            block, tag = seen.message.get("block", -1), str(seen.message.get("tag"))
            if isinstance(block, int) and block >= 0:
                first = self._known.setdefault((seen.topic, seen.session, block), tag)
                text = f"{seen.where}: block {block} has another tag than before"
                self.counter.count(first == tag, seen.session, -1, seen.k, text)

    def finish(self) -> None:
        for (topic, session, block), tag in self._known.items():
            other = self._known.get(("offer", session, block))
            if topic == "measurement" and other is not None:
                text = f"block {block}: the ends' tags differ"
                self.counter.count(tag == other, session, -1, -1, text)


class RefusedAtZero(Check):
    """Where nothing is claimed there is no nonce and no key."""

    name = "refused-at-zero"
    source = "rule 10"
    says = "where nothing is claimed there is no key"
    of = "messages"

    def feed(self, part: Part) -> None:
        if self.evidence.rules.schedule is not None:
            return
        count = self.counter.count
        for seen in part.seen:
            text = ""
            if seen.message.get("nonce") or seen.message.get("tag"):
                text = f"{seen.where}: a nonce or a tag, and no key is claimed"
            count(not text, seen.session, -1, seen.k, text)
        for side, line in _lines(part):
            if isinstance(line, TracedTransition):
                text = f"the {side} counts copies, and no key is claimed" if line.counts else ""
                count(not text, line.session, line.j, line.k, text)
