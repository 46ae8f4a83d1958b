"""Messages under keys that both ends share: tagged or coded as they leave, opened as they come.

Each end guards its own direction with keys of its own half, in batches. Message k of a session is
under slot k - first of the batch that covers step k: a message that is sent again finds the same
slot, and says the same (rules 1 and 2), but for its copy number and nonce, which no tag covers. A
step that is missed leaves its slot unused for ever.

On the wire a guarded message is the plain one with fields at its end: the batch and slot
(``guard``), and its tag (``mac``), or, where the measurement is coded, what opens it (``after``,
``rest``). Where no batch covers the step the message goes out plain; where messages are tagged and
one has served, with its batch's *farewell*: a tag under a word kept for that. A bare message after
the first guarded one is refused, so that who strips the tags is seen.
"""

import re
from hmac import compare_digest
from typing import Any, Final, NamedTuple

import numpy as np
from pydantic_core import from_json, to_json

from protocol.defence.base import Defence, Wire, Words
from protocol.defence.words import slots
from protocol.secret.tasks import Batch

ANEW: Final = re.compile(rb'"copy_number":[01],"nonce":"[^"]*",')
"""What a message that is sent again has anew: no tag covers it."""

_TAIL: Final = re.compile(rb',"guard":"(\d{1,16})/(\d{0,9})"(.*)\}$', re.DOTALL)
_MAC: Final = re.compile(rb',"mac":"([0-9a-f]{8})"')


class Opened(NamedTuple):
    """What comes of a message that was heard.

    ``plain`` is what the end is told; None where it is not heard. ``number`` is the batch that it
    is under, -1 where it was bare, and ``slot`` its place there, -1 for a farewell; ``needs`` the
    oldest batch that is still needed. ``lacking``: it names a batch that is not held (yet). ``why``
    it is refused as a forgery.
    """

    plain: bytes | None
    number: int = -1
    slot: int = -1
    needs: int = -1
    lacking: int = -1
    why: str = ""


class Promise(NamedTuple):
    """What the partner's tags have shown: from after step ``first`` on no message is bare.

    ``newest`` is the newest batch that one was under; -1: none yet.
    """

    first: int = -1
    newest: int = -1

    def refuses(self, k: int) -> bool:
        """Whether a bare message of step ``k`` is a forgery."""
        return self.newest >= 0 and k > self.first

    def extended(self, k: int, number: int) -> "Promise":
        """The promise after a message of step ``k`` under a batch."""
        return Promise(k if self.newest < 0 else self.first, max(number, self.newest))


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

    @property
    def end(self) -> int:
        """The first step after those that the batches held cover; 0 where there are none."""
        return max((end for _, end, _ in self._batches.values()), default=0)

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
            return self._farewell(k, plain)
        slot = k - self._batches[number][0]
        key = self._key(number, slot)
        assert key is not None
        body, more = plain[:-1], b""
        if self.codes:
            body, more = self._coded(k, plain, key, after_k)
        body += b',"guard":"%d/%d"' % (number, slot) + more
        if self.tags:
            body += b',"mac":"%08x"' % self._tag(body, key)
        return body + b"}"

    def _farewell(self, k: int, plain: bytes) -> bytes:
        """A message that no batch covers, with the farewell of the last one that did."""
        served = [n for n, (_, end, _) in self._batches.items() if end <= k]
        if not self.tags or not served:
            return plain
        tag = self._last_tag(max(served))
        return plain[:-1] + b',"guard":"%d/","mac":"%08x"}' % (max(served), tag)

    def _last_tag(self, number: int) -> int:
        """The farewell's tag: of the batch's number, under its last word."""
        first, end, _ = self._batches[number]
        key = self._key(number, end - first)
        assert key is not None
        return self._tag(b"farewell %d" % number, key)

    def _coded(
        self, k: int, plain: bytes, key: tuple[Words, Words], after_k: int
    ) -> tuple[bytes, bytes]:
        """A measurement whose states are coded, and the fields that open it.

        ``x_after`` is under the key of its own step, as it was when it left as ``x``: under this
        one's it would give away the other. Decoding rounds; ``rest`` has the bits that it misses.
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
            return self._bare(k, wire, promise)
        number, more = int(tail[1]), tail[3]
        slot = int(tail[2]) if tail[2] else self._last(number)
        key = self._key(number, slot)
        if key is None:
            # of a batch that has served: it is late, and says nothing new
            return Opened(None, lacking=-1 if number < self.oldest else number)
        farewell = slot == self._last(number)
        if self.tags:
            mac = _MAC.search(more)
            said = b"" if mac is None else wire[: tail.start(3) + mac.start()]
            said = b"farewell %d" % number if farewell else said
            if mac is None or not compare_digest(mac[1], b"%08x" % self._tag(said, key)):
                return Opened(None, why="its tag is wrong")
            more = more[: mac.start()]
        elif farewell:
            return Opened(None, why="it does not open")
        body = wire[: tail.start()] + b"}"
        if farewell:  # of an older batch than the newest: late, and says nothing new
            return Opened(body if number >= promise.newest else None, number, needs=number)
        if not self.codes:
            return Opened(body, number, slot, number)
        decoded, needs = self._decoded(k, body, more, key)
        if decoded is None:
            # what it also needs is of a batch that has served: it is late, as above
            late = 0 <= needs < self.oldest
            return Opened(None, why="" if late else "it does not open")
        return Opened(decoded, number, slot, number if needs < 0 else needs)

    def without(self, k: int, wire: bytes, promise: Promise) -> Opened:
        """The same of a message whose batch is nowhere to be had: it counts as a bare one."""
        tail = _TAIL.search(wire)
        if self.codes or tail is None:
            return Opened(None)
        return self._bare(k, wire[: tail.start()] + b"}", promise)

    def _bare(self, k: int, wire: bytes, promise: Promise) -> Opened:
        if self.tags and promise.refuses(k):
            return Opened(None, why="it has no tag")
        return Opened(wire)

    def _last(self, number: int) -> int:
        """The slot that is kept for the farewell."""
        first, end, _ = self._batches.get(number, (0, 0, None))
        return end - first

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
                    return None, needs
                then = said["applied_k"] + 1
                said["x_after"] = self._back(then, np.asarray(after, float), old, rest[n:])
            elif after and said["applied_k"] == k - 1:
                said["x_after"] = state
            said["x"] = state
            return to_json(said), needs
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError):
            return None, -1

    def _back(self, k: int, x: Any, key: tuple[Words, Words], rest: Any) -> list[float]:
        bits = _bits(self._defence.decode(k, *key, Wire(x)).x) ^ rest
        out: list[float] = bits.view(np.float64).tolist()
        return out


def _bits(x: Any) -> Any:
    """Floating-point numbers as integers of 64 bits."""
    return np.ascontiguousarray(x, np.float64).view(np.uint64)
