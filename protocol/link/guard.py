"""Messages under keys that both ends share: tagged or coded as they leave, opened as they come.

Each end guards its own direction with keys of its own half, in batches. Message k of a session is
under slot k - first of the batch that covers step k: a message that is sent again finds the same
slot, and says the same (rules 1 and 2), but for its copy number and nonce, which no tag covers. A
step that is missed leaves its slot unused for ever.

On the wire a guarded message is the plain one with fields at its end: the batch and slot
(``guard``), the step up to which its sender goes on so (``until``), and its tag (``mac``), or, where
the measurement is coded, what opens it (``after``, ``rest``). Where no batch covers the step the
message goes out plain. Who hears a plain message of a step that was promised as guarded refuses it.
"""

import re
from typing import Any, Final, NamedTuple

import numpy as np
from pydantic_core import from_json, to_json

from protocol.defence.base import Defence, Wire, Words
from protocol.defence.words import slots
from protocol.secret.tasks import Batch

ANEW: Final = re.compile(rb'"copy_number":[01],"nonce":"[^"]*",')
"""What a message that is sent again has anew: no tag covers it."""

_TAIL: Final = re.compile(rb',"guard":"(\d{1,9})/(\d{1,9})","until":(\d{1,18})(.*)\}$', re.DOTALL)
_MAC: Final = re.compile(rb',"mac":"([0-9a-f]{8})"')


class Opened(NamedTuple):
    """What comes of a message that was heard.

    ``plain`` is what the end is told; None where it is not heard. ``until`` is the step up to which
    its sender goes on to guard them, -1 where it was plain; ``needs`` the oldest batch that is still
    needed. ``lacking``: it names a batch that is not held (yet). ``why`` it is refused as a forgery.
    """

    plain: bytes | None
    until: int = -1
    needs: int = 0
    lacking: int = -1
    why: str = ""


class Promise(NamedTuple):
    """Steps whose messages their sender guards, by its own word: those after ``first`` to ``last``.

    What comes plain of them is a forgery. That of ``first`` itself may have left plain before.
    """

    first: int = -1
    last: int = -1

    def has(self, k: int) -> bool:
        """Whether step ``k`` was promised."""
        return self.first < k <= self.last

    def extended(self, k: int, until: int) -> "Promise":
        """The promise after a guarded message of step ``k``."""
        first = self.first if self.first <= k <= self.last + 1 else k
        if k < self.first:  # an older message
            return self
        return Promise(first, max(until, self.last) if first == self.first else until)


class Guard:
    """One direction's messages, of one session, at one end.

    Parameters
    ----------
    defence : Defence
        That codes or tags.
    topic : str
        The direction's: ``measurement`` or ``offer``.
    """

    def __init__(self, defence: Defence, topic: str) -> None:
        self._defence = defence
        self._topic = topic.encode()
        self.codes = defence.codes and topic == "measurement"
        self.tags = defence.tags
        self._batches: dict[int, tuple[int, int, Words]] = {}
        """First step, end, and words, by number; only the sender knows the steps."""

    @property
    def on(self) -> bool:
        """Whether messages of this direction are guarded at all."""
        return self.codes or self.tags

    @property
    def newest(self) -> int:
        """The newest batch held; -1: none."""
        return max(self._batches, default=-1)

    @property
    def oldest(self) -> int:
        """The oldest batch held, or the one to come."""
        return min(self._batches, default=self.newest + 1)

    def begin(self) -> None:
        """Another session begins: its keys are others."""
        self._batches.clear()

    def add(self, batches: tuple[Batch, ...]) -> None:
        """Hold more batches."""
        for batch in batches:
            words = np.frombuffer(batch.key, ">u4").astype(np.uint32)
            count = slots(len(words), self._defence.session_words, self._defence.step_words)
            self._batches[batch.number] = batch.first, batch.first + count, words

    def drop_below(self, number: int) -> None:
        """Let go of batches that have served."""
        for old in [n for n in self._batches if n < number]:
            del self._batches[old]

    def covers(self, k: int) -> int:
        """The batch that covers step ``k`` of what is sent; -1: none."""
        for number, (first, end, _) in self._batches.items():
            if first <= k < end:
                return number
        return -1

    def until(self, k: int) -> int:
        """The last step from ``k`` on up to which all are covered; k - 1 where it is not."""
        while (number := self.covers(k)) >= 0:
            k = self._batches[number][1]
        return k - 1

    def _key(self, number: int, slot: int) -> tuple[Words, Words] | None:
        """Key of a batch and of one of its messages; None where it is not held."""
        found = self._batches.get(number)
        taken, each = self._defence.session_words, self._defence.step_words
        if found is None or taken + (slot + 1) * each > len(found[2]):
            return None
        words = found[2]
        return words[:taken], words[taken + slot * each : taken + (slot + 1) * each]

    # --- what is sent -----------------------------------------------------------------------------

    def closed(self, k: int, plain: bytes, after_k: int = -1) -> bytes:
        """Message ``k`` as it leaves; as it is where no batch covers the step.

        Parameters
        ----------
        k : int
        plain : bytes
            Its JSON.
        after_k : int
            The step whose state stands in a measurement's ``x_after``; -1: in none.
        """
        number = self.covers(k)
        if number < 0:
            return plain
        slot = k - self._batches[number][0]
        key = self._key(number, slot)
        assert key is not None
        body, more = plain[:-1], b""
        if self.codes:
            body, more = self._coded(k, plain, key, after_k)
        body += b',"guard":"%d/%d","until":%d' % (number, slot, self.until(k)) + more
        if self.tags:
            body += b',"mac":"%08x"' % self._tag(body, key)
        return body + b"}"

    def _coded(
        self, k: int, plain: bytes, key: tuple[Words, Words], after_k: int
    ) -> tuple[bytes, bytes]:
        """A measurement whose states are coded, and the fields that open it.

        ``x_after`` is under the key of its own step, as it was when it left as ``x``: under this
        one's it would give away the other. Decoding rounds; ``rest`` has the bits that it gets wrong.
        """
        said = from_json(plain)
        said["x"], rest = self._turned(k, said["x"], key)
        after, number = "", self.covers(after_k) if after_k != k else -1
        if after_k == k and said["x_after"]:
            said["x_after"] = said["x"]
        elif number >= 0:
            slot = after_k - self._batches[number][0]
            old = self._key(number, slot)
            assert old is not None
            said["x_after"], more = self._turned(after_k, said["x_after"], old)
            after, rest = f"{number}/{slot}", rest + more
        return to_json(said)[:-1], b',"after":"%s","rest":%s' % (after.encode(), to_json(rest))

    def _turned(
        self, k: int, x: list[float], key: tuple[Words, Words]
    ) -> tuple[list[float], list[int]]:
        true = np.asarray(x, float)
        wire = self._defence.encode(k, *key, true)
        rest = _bits(true) ^ _bits(self._defence.decode(k, *key, wire).x)
        return wire.values.tolist(), rest.tolist()

    def _tag(self, body: bytes, key: tuple[Words, Words]) -> int:
        """The tag of a message's bytes and of its direction."""
        said = self._topic + ANEW.sub(b"", body, 1)
        words = np.frombuffer(said + bytes(-len(said) % 4), ">u4").astype(np.uint32)
        # as the padding may hide an end, the length is a word of its own
        words = np.append(words, np.uint32(len(said)))
        tag = self._defence.tag(*key, words)
        assert tag is not None
        return int(tag)

    # --- what is heard ----------------------------------------------------------------------------

    def opened(self, k: int, wire: bytes, promise: Promise) -> Opened:
        """What comes of a message of step ``k`` that was heard, after such a promise."""
        tail = _TAIL.search(wire)
        if tail is None:
            return self._plain(k, wire, promise)
        number, slot, until = int(tail[1]), int(tail[2]), int(tail[3])
        key = self._key(number, slot)
        if key is None:
            # of a batch that has served: it is late, and says nothing new
            return Opened(None, lacking=-1 if number < self.oldest else number)
        more = tail[4]
        if self.tags:
            mac = _MAC.search(more)
            if mac is None or int(mac[1], 16) != self._tag(wire[: tail.start(4) + mac.start()], key):
                return Opened(None, why="its tag is wrong")
            more = more[: mac.start()]
        body = wire[: tail.start()] + b"}"
        if not self.codes:
            return Opened(body, until, number)
        decoded, needs = self._decoded(k, body, more, key)
        if decoded is None:
            return Opened(None, why="it does not open")
        return Opened(decoded, until, number if needs < 0 else needs)

    def without(self, k: int, wire: bytes, promise: Promise) -> Opened:
        """The same of a message whose batch is nowhere to be had: it counts as a plain one."""
        tail = _TAIL.search(wire)
        if self.codes or tail is None:
            return Opened(None, why="it cannot be opened" if promise.has(k) else "")
        return self._plain(k, wire[: tail.start()] + b"}", promise)

    @staticmethod
    def _plain(k: int, wire: bytes, promise: Promise) -> Opened:
        if promise.has(k):
            return Opened(None, why="it is not guarded, and was to be")
        return Opened(wire)

    def _decoded(
        self, k: int, body: bytes, more: bytes, key: tuple[Words, Words]
    ) -> tuple[bytes | None, int]:
        """The measurement with its states, None where its fields do not fit; the older batch."""
        needs = -1
        try:
            fields: dict[str, Any] = from_json(b"{" + more[1:] + b"}")
            said, rest = from_json(body), np.array(fields["rest"], np.uint64)
            x, after = np.asarray(said["x"], float), said["x_after"]
            n = self._defence.states
            if x.shape != (n,) or rest.shape not in ((n,), (2 * n,)):
                return None, -1
            state = self._back(k, x, key, rest[:n])
            if fields["after"]:
                needs, slot = map(int, fields["after"].split("/"))
                old = self._key(needs, slot)
                if old is None:
                    return None, -1
                then = said["applied_k"] + 1
                said["x_after"] = self._back(then, np.asarray(after, float), old, rest[n:])
            elif after and said["applied_k"] == k - 1:
                said["x_after"] = state
            said["x"] = state
            return to_json(said), needs
        except (KeyError, OverflowError, TypeError, ValueError):
            return None, -1

    def _back(self, k: int, x: Any, key: tuple[Words, Words], rest: Any) -> list[float]:
        bits = _bits(self._defence.decode(k, *key, Wire(x)).x) ^ rest
        out: list[float] = bits.view(np.float64).tolist()
        return out


def _bits(x: Any) -> Any:
    """Floating-point numbers as integers of 64 bits."""
    return np.ascontiguousarray(x, np.float64).view(np.uint64)
