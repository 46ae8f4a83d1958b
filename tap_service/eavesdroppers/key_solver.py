"""`key-solver`: goes for the keys, and counts what can be computed of each block.

She knows the claim, and so where blocks begin, how many rows they have and the matrix; which copies
counted she reads off the messages, and takes each for counted of which she did not hear. A step
that the plant missed, and she did not hear so, she takes for a transition: her blocks are then off
by one, and `wyner score`, which reads the plant's trace, counts exactly.

A block of R rows of which she missed e counted copies gives her R - e combinations of rows: none,
where the claim holds, and no key by itself where she missed one. So she computes the keys of blocks
that she heard all of, and reads what travels under them (scheme `sealed`).
"""

from collections import deque
from dataclasses import dataclass
from typing import ClassVar, Final

from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage, Offer
from protocol.messages.adversary import HeldBlock, KeysHeld
from protocol.schemes.base import decrypt
from protocol.schemes.framing import Deframer
from protocol.secret.blocks import schedule_of
from protocol.secret.extractor import extract
from protocol.secret.key_digits import digits
from protocol.secret.nonces import NONCE_BYTES, as_bytes
from protocol.secret.stream import NOWHERE, Position
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import (
    Belief,
    Eavesdropper,
    Guess,
    KnowledgeError,
    MessageSymbols,
    even,
)
from tap_service.inference.miss_rate import ALL, Audit, worst

KEPT_BLOCKS: Final = 64
"""Blocks whose keys she keeps, and blocks that she tells of."""

KEPT_SESSIONS: Final = 8
"""Sessions of which steps are kept that are not settled: the one before may have some, and a
message may be a stray."""

KEPT_STEPS: Final = 8192
"""Steps of a session that are kept until they are settled: more than a transcript bridges."""

BOTH: Final = ("measurements", "offers")


def bits_held(rows: int, missed: int) -> int:
    """Bits that one who missed so many of a block's counted copies can compute of its rows.

    Of R rows from copies of which she missed e she can compute R - e combinations, as every square
    part of the Cauchy matrix can be inverted: none where e is R, and no row by itself where e is
    not 0.
    """
    return 8 * NONCE_BYTES * max(0, rows - missed)


@dataclass(slots=True)
class _Step:
    """What she heard of one step: nonces of its copies 0, which were taken, the offer's digits."""

    position: Position = NOWHERE
    offer: bytes | None = None
    measurement: bytes | None = None
    offer_taken: int = 0
    measurement_taken: int = 0


class KeySolver(Eavesdropper):
    """Solves for key bits; of the loop's own symbols she knows nothing."""

    name: ClassVar[str] = "key-solver"
    hears_messages: ClassVar[bool] = True
    guesses: ClassVar[bool] = False

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        schedule = None if knowledge.keys is None else schedule_of(knowledge.keys)
        if schedule is None:
            raise KnowledgeError(
                f"{self.name}: knowledge lacks keys, expected a claim that makes some"
            )
        self._schedule = schedule
        self._claim = schedule.assumption
        self._even = even(self.size)
        directions = self._claim.directions
        self._misses = Audit(self._claim.eps_E, BOTH if directions == "both" else (directions,))
        self._steps: dict[str, dict[int, _Step]] = {}
        self._told: deque[HeldBlock] = deque(maxlen=KEPT_BLOCKS)
        self._blocks = self._broken = self._bits = self._unplaced = 0
        self._j = -1  # number of the last transition; -1 where she did not hear a session's first
        self._last_k = -1
        self._session = ""  # of the last transition
        self._open: list[tuple[int, bytes | None, bytes | None]] = []
        self._open_steps = 0
        self._digits = knowledge.digits
        self._keys: dict[tuple[str, int], tuple[bytes, ...]] = {}
        self._symbols: list[tuple[int, int]] = []
        self._frame = Deframer(self.size)
        self._whole: deque[bytes] = deque(maxlen=KEPT_BLOCKS)
        self._whole_count, self._solved_k = 0, -1

    # --- what she hears ---------------------------------------------------------------------------

    def hear(self, message: FieldMessage) -> None:
        """Note nonces and copies; their transitions come when they are settled."""
        step = self._step(message.session, message.k)
        if isinstance(message, Offer):
            if not message.copy_number and message.nonce:
                step.offer = as_bytes(message.nonce)
            step.measurement_taken = message.heard
            step.position = message.position
        else:
            if not message.copy_number and message.nonce:
                step.measurement = as_bytes(message.nonce)
            if message.applied_k >= 0:
                self._step(message.session, message.applied_k).offer_taken = message.applied_copy

    def _step(self, session: str, k: int) -> _Step:
        steps = self._steps[session] = self._steps.pop(session, {})  # in the order of last use
        if len(self._steps) > KEPT_SESSIONS:
            del self._steps[next(name for name in self._steps if name != self._session)]
        step = steps.setdefault(k, _Step())
        if len(steps) > KEPT_STEPS:
            del steps[next(iter(steps))]
        return step

    def observe(self, transition: Transition) -> Guess:
        """Count a transition towards its block, and solve the block that it closes."""
        t = transition
        steps = self._steps.get(t.session, {})
        if t.start:
            self._j, self._open, self._open_steps = 0, [], 0
        elif t.gap:
            self._j = -1  # which blocks the next ones belong to is lost, until a session begins
        elif self._j >= 0:
            self._j += 1
        for k in range(self._last_k + 1 if self._j > 0 else t.k, t.k):
            self._count(steps.get(k, _Step()), measurement_only=True)
            self._open_steps += 1
        step = steps.get(t.k, _Step())
        self._count(step)
        self._unplaced += self._j < 0
        if self._j > 0:
            self._append(t.session, step)
        if self.scheme.from_stream and step.position != NOWHERE:
            self._read(t, step.position)
        self._last_k, self._session = t.k, t.session
        for k in [k for k in steps if k <= t.k]:
            del steps[k]
        return Guess(t.k, self._even, 0.5)

    def _count(self, step: _Step, *, measurement_only: bool = False) -> None:
        """Note which copies 0 of a step she missed; a step without a transition had no offer."""
        if self._claim.counting(2):
            self._misses.add("measurements", missed=step.measurement is None)
        if self._claim.counting(1) and not measurement_only:
            self._misses.add("offers", missed=step.offer is None)

    def _append(self, session: str, step: _Step) -> None:
        counts = self._claim.counting((not step.offer_taken) + 2 * (not step.measurement_taken))
        self._open.append((counts, step.offer, step.measurement))
        self._open_steps += 1
        number = self._schedule.block_of(self._j)
        if self._j + 1 == self._schedule.begins(number + 1):
            self._close(session, number)
            self._open, self._open_steps = [], 0

    def _close(self, session: str, number: int) -> None:
        nonces: list[bytes | None] = []
        for counts, offer, measurement in self._open:
            nonces += [offer] * (counts & 1) + [measurement] * (counts >> 1)
        rows = self._claim.rows(len(self._open), self._open_steps, len(nonces))
        if rows < 2:
            return  # it makes no key
        heard = [nonce for nonce in nonces if nonce is not None]
        missed = len(nonces) - len(heard)
        bits = bits_held(rows, missed)
        if not missed:
            _tag, *keys = extract(heard, rows, by_words=self._claim.by_words)
            self._keys[session, number] = tuple(keys)
            if len(self._keys) > KEPT_BLOCKS:
                del self._keys[next(iter(self._keys))]
        block = HeldBlock(
            session=session, number=number, counted=len(nonces), rows=rows, missed=missed, bits=bits
        )
        self._told.append(block)
        self._blocks += 1
        self._broken += bits > 0
        self._bits += bits

    def _read(self, t: Transition, position: Position) -> None:
        """Decrypt the symbol that a transition carried under the key stream, if she can."""
        found = self.digits(t.session, position, self._digits)
        if found is None or t.cipher is None:
            self._frame.reset()
            return
        symbol = decrypt(t.cipher, found[-1], self.size)
        self._symbols.append((t.k, symbol))
        whole = self._frame.push(symbol)
        if whole is not None:
            self._whole.append(whole)
            self._whole_count += 1
            self._solved_k = t.k if self._solved_k < 0 else self._solved_k

    # --- what she has -----------------------------------------------------------------------------

    def belief(self) -> Belief:
        """What she holds of the keys."""
        rates = self._misses.judge()
        direction, rate = worst(rates)
        classes = [one for name, one in rates.items() if name != ALL]
        return Belief(
            message=self._frame.partial or (self._whole[-1] if self._whole else b""),
            whole=tuple(self._whole),
            whole_count=self._whole_count,
            confidence=float(self._solved_k >= 0),
            solved_k=self._solved_k,
            keys=KeysHeld(
                blocks=self._blocks,
                broken=self._broken,
                bits=self._bits,
                copies=sum(one.copies for one in classes),
                missed=sum(one.missed for one in classes),
                absent=sum(one.absent for one in classes),
                unplaced=self._unplaced,
                at_most=rate.high,
                direction=direction,
                refuted=rate.refuted,
                bursts=any(one.bursts for one in rates.values()),
                newest=tuple(self._told),
            ),
        )

    def message_symbols(self) -> MessageSymbols:
        """The message symbols that she has decrypted."""
        return self._symbols

    def digits(self, session: str, position: Position, count: int) -> tuple[int, ...] | None:
        """Digits of the key stream, where she can compute the keys that they come from."""
        at = position.at
        for key in self.keys_of(session, position.block):
            found = digits(key, self.size)
            if at < len(found):
                return found[at : at + count] if at + count <= len(found) else None
            at -= len(found)
        return None

    def keys_of(self, session: str, number: int) -> tuple[bytes, ...]:
        """The keys of a block, where she can compute them."""
        return self._keys.get((session, number), ())
