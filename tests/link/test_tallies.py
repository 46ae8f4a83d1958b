"""Every field that either end remembers or says, beside a tally of what happened to them.

The two ends hear each other over a network that repeats and loses, on the plant on a line; their
processes die. The tally knows the coins, the disturbances and the messages, and asks the ends for
nothing but nonces.
"""

import random
from dataclasses import replace
from itertools import accumulate
from typing import Any
from zlib import crc32

import pytest

from protocol.agreement import NO_SYMBOL, AgreementResult
from protocol.link.distiller import BlockEnded
from protocol.link.incoming import SYMBOLS_AT_ONCE
from protocol.link.records import ControllerRecord, PlantRecord
from protocol.link.session import CountedTransition
from protocol.link.step import Read
from protocol.messages import Measurement, Offer, SendCommand
from protocol.schemes.base import Scheme
from protocol.schemes.framing import IDLE, encode_frame
from protocol.schemes.pipelined import Pipelined
from protocol.schemes.switched import Switched
from protocol.secret.blocks import NO_TAG, Schedule
from protocol.secret.bound import Assumption
from protocol.secret.nonces import Contribution, as_bytes
from protocol.vectors import Vector
from tests.support.controller_in_hand import ControllerInHand, Done
from tests.support.line_ends import line_rules
from tests.support.plant_in_hand import PlantInHand
from tests.support.records import changed, controller_record, plant_record
from tests.support.size import size

SESSION, PLANT, CONTROLLER = "1" * 16, "a" * 16, "c" * 16
PAYLOADS = (b"one", b"", b"three, which takes two chunks")
APART = 4.0
"""Between two candidates' centres: D_c = [-1, 1] around one has nothing of another's."""


class Outbox:
    queued = len(PAYLOADS)

    def payload(self, number: int) -> bytes | None:
        return PAYLOADS[number] if number < len(PAYLOADS) else None

    def crc_of(self, identifier: str) -> int | None:
        payload = self.payload(int(identifier)) if identifier.isdigit() else None
        return None if payload is None else crc32(payload)

    def identifier(self, number: int) -> str:
        return str(number)


class Draws:
    """Random symbols that say for which transition they were drawn."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def symbol(self, transition: int, size: int) -> int:
        self.asked.append(transition)
        return transition * 7 % size


class Ends:
    """Both ends and the tally; each method does one thing and compares."""

    def __init__(self, scheme: Scheme[Any], seed: int, *, keys: bool) -> None:
        self.random = random.Random(seed)
        self.size, self.pipelined, self.keys = scheme.alphabet, scheme.name == "pipelined", keys
        schedule = Schedule(Assumption(0.1), 64, 64) if keys else None
        rules = line_rules(alpha=1000.0, largest_input=1e9, scheme=scheme)
        self.rules = replace(rules, schedule=schedule)
        self.draws = Draws()
        self.rows: list[Contribution] = []
        self.symbols = ""
        first = plant_record(session=SESSION, k=0, x=(0.5,), u=(0.25,))
        self.sender = self.controller(None)
        self.receiver = PlantInHand(self.rules, PLANT, first)
        frames = [encode_frame(payload, self.size) for payload in PAYLOADS]
        self.ends = list(accumulate(map(len, frames)))
        self.stream = b"".join(frames)
        self.no_tag = NO_TAG if keys else ""
        self.said = controller_record(
            session=SESSION, incarnation=1, state=scheme.initial, tag=self.no_tag
        )
        self.kept = changed(first, state=scheme.initial, controller=CONTROLLER, tag=self.no_tag)
        self.uncounted: CountedTransition | None = None
        self.contribution: Contribution | None = None
        self.unsaved: tuple[Contribution, ...] = ()
        self.woke = keys
        """Whether the plant's process woke up in this step: then it does not know what has left."""
        self.delivered: list[int] = []
        self.inbox: list[bytes] = []
        self.meet()
        self.compare()

    def controller(self, record: ControllerRecord | None, **step: Any) -> ControllerInHand:
        """A process of it, with the rows that its journal has."""
        counted = [] if record is None else self.rows_of(record)
        return ControllerInHand(
            self.rules,
            self.propose,
            CONTROLLER,
            record,
            contributions=counted,
            messages=Outbox(),
            fresh=self.draws,
            **step,
        )

    def rows_of(self, record: ControllerRecord | PlantRecord) -> list[Contribution]:
        """Rows in the journal with a record: those of the open block."""
        begins = 1 + max(0, record.link.transitions - 1) // 64 * 64
        return [row for row in self.rows if begins <= row.j < record.link.transitions]

    def meet(self) -> None:
        """A life greets, or the same once more; the plant saves which it was."""
        self.unsaved = ()
        self.kept = changed(self.kept, incarnation=self.said.session.incarnation)
        self.receiver.heard_controller(self.sender.greeting(), "9" * 16)
        accepted = self.sender.heard_plant(self.receiver.hello()).reply
        assert accepted is not None
        assert self.receiver.heard_controller(accepted, "9" * 16) == "accepted"

    def propose(self, x: Vector) -> tuple[Vector, ...]:
        return tuple((APART * i - x[0],) for i in range(self.size))

    def compare(self) -> None:
        nonce = self.receiver.record.link.nonce
        assert bool(nonce) == (self.keys and self.kept.link.k > 0)
        counted = self.kept.link.transitions
        begun = 1 + (counted - 2) // 64 if self.keys and counted > 1 else 0
        assert self.receiver.record == changed(self.kept, nonce=nonce, blocks_begun=begun)
        assert changed(self.sender.record, blocks_begun=0) == self.said
        assert self.sender.carries == (self.said.link.state[1] != NO_SYMBOL)

    def poor(self, counted: CountedTransition | None) -> tuple[BlockEnded, ...]:
        """The block that a transition ends: copies are lost so often that none makes a key."""
        if not self.keys or counted is None or counted.j == 0 or counted.j % 64:
            return ()
        return (BlockEnded(SESSION, counted.j // 64 - 1, "poor"),)

    # --- what happens -----------------------------------------------------------------------------

    def die(self) -> None:
        """One of the two, between two things that it did; it comes back as its journal has it."""
        if self.random.random() < 0.5:
            self.sender = self.controller(self.said)
            self.said = changed(self.said, incarnation=self.said.session.incarnation + 1)
        else:
            record = self.receiver.record
            self.receiver = PlantInHand(
                self.rules, PLANT, record, self.symbols, self.rows_of(record)
            )
            self.woke, self.unsaved = self.keys, ()
        self.meet()
        self.compare()

    def miss(self) -> None:
        x_next, u = (self.random.uniform(-1, 1),), (self.random.uniform(-1, 1),)
        self.receiver.missed(u, x_next)
        k, missed = self.kept.link.k + 1, self.kept.applied.missed + 1
        self.kept = changed(self.kept, k=k, x=x_next, u=u, missed=missed)
        self.woke, self.unsaved = False, ()
        self.compare()

    def measure(self) -> Measurement:
        """A copy of this step's measurement: the first, or one of those after it."""
        measurement = self.receiver.measurement()
        assert measurement == Measurement(
            session=SESSION,
            k=self.kept.link.k,
            x=self.kept.link.x,
            applied_k=self.kept.link.applied_k,
            x_after=self.kept.applied.x_after,
            copy_number=measurement.copy_number,
            nonce=measurement.nonce,
            applied_copy=self.kept.applied.copy,
            tag=self.no_tag,
        )
        first = measurement.copy_number == 0
        assert first == (measurement.nonce == self.receiver.record.link.nonce)
        assert bool(measurement.nonce) == self.keys
        return measurement

    def hear(self) -> Offer:
        """The controller hears it once, or again; a copy of its offer."""
        measurement = self.measure()
        assert measurement.copy_number == self.woke
        for _ in range(self.random.choice((0, 0, 1))):
            measurement = self.measure()
            assert measurement.copy_number == self.keys
        effects = self.sender.measured(measurement)
        offer = effects.offer
        assert offer is not None
        assert effects == Done(append=True, offer=offer)
        if self.random.random() < 0.1:  # it dies once it has saved that
            self.sender = self.controller(self.said, offer=offer, measurement=measurement)
            self.said = changed(self.said, incarnation=self.said.session.incarnation + 1)
        self.finish_step(measurement, offer)
        assert offer == Offer(
            session=SESSION,
            k=self.kept.link.k,
            candidates=self.propose(self.kept.link.x),
            cipher=self.said.frame.cipher,
            nonce=offer.nonce,
            heard=measurement.copy_number,
            tag=self.no_tag,
        )
        if self.sender.plant is None:
            self.meet()
        again = self.sender.measured(self.measure()).offer
        assert again is not None
        assert again == offer.model_copy(
            update={"copy_number": int(self.keys), "nonce": again.nonce}
        )
        assert (again.nonce == offer.nonce) == (not self.keys)
        return self.random.choice((offer, again))

    def finish_step(self, measurement: Measurement, offer: Offer) -> None:
        """What was applied since is counted, and the next symbol is decided."""
        counted, contribution = self.uncounted, self.contribution
        before = self.said
        self.uncounted = self.contribution = None
        self.said = changed(
            before,
            k=measurement.k,
            x=measurement.x,
            offer=offer,
            nonce="" if measurement.copy_number else measurement.nonce,
            tag=self.no_tag,
        )
        delivered = None
        if counted is not None:
            if counted.role == "message" and counted.p in self.ends:
                delivered = self.ends.index(counted.p)
                self.delivered.append(delivered)
            key, p = self.kept.link.state[1], counted.p
            carries = key != NO_SYMBOL
            framed = carries and p < len(self.stream)
            message = sum(end <= p for end in self.ends)
            within = p - ([0, *self.ends][message]) if message < len(self.ends) else 0
            symbol = (self.stream[p] if framed else IDLE) if carries else NO_SYMBOL
            agreed = counted.symbol != NO_SYMBOL
            self.said = changed(
                self.said,
                state=self.kept.link.state,
                applied_k=counted.k,
                transitions=counted.j + 1,
                agreements=before.link.agreements + agreed,
                p=p,
                cipher=(symbol + key if carries else (counted.j + 1) * 7) % self.size,
                message_symbol=symbol,
                framed=framed,
                message=message,
                offset=within + framed,
            )
        if counted is not None:
            counted = counted.shared
        if counted is not None and delivered is not None:
            command = SendCommand(id=str(delivered), payload=PAYLOADS[delivered])
            counted = counted._replace(delivered=command)
        assert self.sender.finish_step() == Done(
            save=delivered is not None,
            transition=counted,
            delivered=None if delivered is None else str(delivered),
            rows=() if delivered is None or contribution is None else (contribution,),
            blocks=self.poor(counted),
        )
        assert not self.sender.unfinished
        self.compare()

    def apply(self, offer: Offer) -> None:
        """The plant tosses and is disturbed: within D_c, out of all, or up to the next centre."""
        coin = self.random.randrange(self.size)
        d = self.random.choice((0.9, -0.9, 0.5, 0.0, 1.1, APART, -APART))
        before, x = self.kept, self.kept.link.x[0]
        x_next = (x + offer.candidates[coin][0] + d,)
        gauges = tuple(abs(x_next[0] - (x + u)) for (u,) in offer.candidates)
        fits = [i for i, g in enumerate(gauges) if g <= 1]
        symbol = fits[0] if fits else NO_SYMBOL
        pad = before.link.state[1]
        tested = self.pipelined or pad == NO_SYMBOL
        agreed = symbol if tested else NO_SYMBOL
        carried = pad != NO_SYMBOL
        m = (offer.cipher - pad) % self.size if carried else NO_SYMBOL
        if carried:
            assert m == (self.stream[before.link.p] if before.link.p < len(self.stream) else IDLE)
        p = before.link.p + carried
        counts = (1 - offer.copy_number) + 2 * (1 - offer.heard)
        if not (self.keys and before.link.transitions):
            counts = 0
        else:
            original = self.said.offer
            assert original is not None
            self.contribution = Contribution(
                before.link.transitions,
                before.link.k - before.link.applied_k,
                None if offer.copy_number else as_bytes(original.nonce),
                None if offer.heard else as_bytes(self.said.link.nonce),
            )
        frame, partial, chunk = self.frame(p, carried, m)
        self.uncounted = CountedTransition(
            session=SESSION,
            j=before.link.transitions,
            k=before.link.k,
            x=before.link.x,
            candidates=offer.candidates,
            cipher=offer.cipher,
            x_next=x_next,
            role="message" if carried else "test",
            verdict=AgreementResult(gauges, symbol, len(fits)),
            symbol=agreed,
            key=pad,
            message_symbol=m,
            p=p,
            s=1 if agreed == NO_SYMBOL else 2,
            tested=tested,
            counts=counts,
            coin=coin,
            u=offer.candidates[coin],
            recovered=frame,
        )
        self.kept = changed(
            before,
            k=before.link.k + 1,
            x=x_next,
            u=offer.candidates[coin],
            applied_k=before.link.k,
            x_after=x_next,
            partial=partial,
            stored=0 if frame is not None else before.frame.stored + len(chunk),
            state=(self.uncounted.s, agreed),
            transitions=before.link.transitions + 1,
            p=p,
            agreements=before.link.agreements + (agreed != NO_SYMBOL),
            symbol_errors=before.applied.symbol_errors + (agreed not in (NO_SYMBOL, coin)),
            messages=before.frame.messages + (frame is not None),
            applied_copy=offer.copy_number,
        )
        assert self.receiver.check(offer) == "current"
        rows, unsaved = self.rows_of(self.receiver.record), self.unsaved
        self.rows += [] if self.contribution is None else [self.contribution]
        self.woke = False
        if self.random.random() < 0.2:  # it dies before it has counted
            record, step = self.receiver.record, self.receiver.dies_over(offer, coin, x_next)
            assert step.rows.contributions == unsaved
            self.receiver = PlantInHand(
                self.rules,
                PLANT,
                record,
                self.symbols,
                rows,
                step=step.step,
            )
            self.woke, unsaved = self.keys, ()
            counted = [e for e in self.receiver.events if isinstance(e, CountedTransition)]
        else:
            counted = [self.receiver.applied(offer, coin, x_next)]
            assert self.receiver.step is not None
            assert self.receiver.step.rows.contributions == unsaved
        assert counted == [self.uncounted]
        row = () if self.contribution is None else (self.contribution,)
        saved = self.receiver.saved
        assert [(s.symbols, s.received, s.rows.contributions) for s in saved] == (
            [(chunk, frame, row)] if chunk or frame is not None else []
        )
        self.unsaved = () if saved else row
        last = self.receiver.step
        assert last is None or (isinstance(last.step, Read) and last.step.coin == coin)
        self.symbols = "" if frame is not None else self.symbols + chunk
        if not self.receiver.accepted:
            self.meet()
        self.compare()
        assert self.receiver.check(offer) == "stale"

    def frame(self, p: int, carried: bool, symbol: int) -> tuple[bytes | None, str, str]:
        """The frame that ends with this symbol; what is kept of one under way, and what leaves."""
        partial = self.kept.frame.partial
        if not carried or p > len(self.stream):
            return None, partial, ""
        if p in self.ends:
            self.inbox.append(PAYLOADS[self.ends.index(p)])
            return self.inbox[-1], "", ""
        digits = 1 if self.size <= 16 else 2
        partial += f"{symbol:0{digits}x}"
        return (
            (None, "", partial) if len(partial) == SYMBOLS_AT_ONCE * digits else (None, partial, "")
        )


SCHEMES: list[Scheme[Any]] = size(
    [Switched(16), Switched(17), Pipelined(2)],
    [Switched(2), Switched(16), Switched(17), Pipelined(2), Pipelined(5)],
)


@pytest.mark.parametrize("keys", [False, True], ids=["no keys", "keys"])
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name}-{s.alphabet}")
def test_both_ends_remember_and_say_what_happened(scheme: Scheme[Any], keys: bool) -> None:
    ends = Ends(scheme, 1, keys=keys)
    while len(ends.delivered) < len(PAYLOADS) or ends.said.link.p < ends.ends[-1] + 5:
        for _ in range(ends.random.choice((0, 0, 0, 1, 2))):
            if ends.random.random() < 0.5:
                ends.hear()  # and its offers are lost
            ends.miss()
        if ends.random.random() < 0.1:
            ends.die()
        ends.apply(ends.hear())
    assert ends.delivered == [0, 1, 2]
    assert ends.inbox == list(PAYLOADS)
    assert ends.kept.applied.symbol_errors > 0
    assert ends.kept.applied.missed > 0
    asked = ends.draws.asked
    assert asked == sorted(set(asked)), "once, and in order"
