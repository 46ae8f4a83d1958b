"""Every decoding that the hidden thresholds leave possible, followed at once.

What the scheme hides from an eavesdropper with the right model is two numbers: a key is agreed when
exactly one gauge is at most t_c and all are at most t_e. A hypothesis is a rectangle of (t_c, t_e)
in which every step so far came out the same, with the scheme's state, the frame's state and the
message symbols that follow. A step cuts the rectangles that its gauges run through, and no others:
over N steps there are of the order of N hypotheses for one threshold, so the list stays short.

Each is scored as the log ratio of its symbols as a message (idle symbols, frames with a likely
length, text, a check that holds) over random symbols. Where the list would outgrow its bound the
least plausible go, and are counted.
"""

import zlib
from array import array
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Indices
from protocol.schemes.base import Scheme
from protocol.schemes.framing import (
    CHECK_BYTES,
    LENGTH_BYTES,
    START,
    Deframer,
    block_bytes,
    digits_of,
)
from protocol.schemes.table import StateTable
from tap_service.eavesdroppers.base import KEPT_MESSAGES, KEPT_SYMBOLS
from tap_service.inference.language_model import OTHER, class_of, table

CAP: Final = 3000
"""Hypotheses kept at most."""

BEHIND: Final = 30.0
"""Log ratio behind the best at which a hypothesis is dropped once a frame check has held."""

UNLIKELY: Final = 0.02
"""Outcomes of an uncertain step that are less probable are not followed."""

OUTSIDE: Final = -0.5
"""Score of a step whose every gauge exceeds t_c: the disturbance would have left D_c."""

IDLE_SHARE: Final = 0.97
"""Probability of an idle symbol outside a frame; the rest is the start symbol's."""

SHORT_SHARE: Final = 0.9
"""Probability of a message shorter than 256 bytes."""

SURE: Final = 14.0
"""Log ratio that a frame check itself must have earned. A check heard whole earns 22; with guesses
in it, one of the thousands of payloads on the list may fit by chance, and is not believed."""

REFUSED: Final = -25.0
"""Score of a frame whose check does not hold: no end ever sends one."""

NODES: Final = 1_000_000
"""Message symbols of all hypotheses together at which those of dropped ones are let go; where more
than half of that remain, the less plausible half of the list goes too."""

_ROW: Final = np.dtype(
    [
        ("lo", "f8"), ("hi", "f8"), ("edge_lo", "f8"), ("edge_hi", "f8"), ("score", "f8"),
        ("state", "i4"), ("node", "i4"), ("phase", "i1"), ("count", "i1"), ("value", "i4"),
        ("bytes", "i4"), ("length", "i4"), ("before", "i2"), ("last", "i2"),
        ("crc", "u4"), ("mark", "f8"), ("passed", "i4"),
    ]
)  # fmt: skip

_CRC: Final = np.array(
    # the public table of CRC-32, from the library's own function on single bytes
    [zlib.crc32(bytes([i]), 0xFFFFFFFF) ^ 0xFFFFFFFF for i in range(256)], dtype=np.uint32
)  # fmt: skip


class ListDecoding:
    """The list of hypotheses.

    Parameters
    ----------
    scheme : Scheme
        Over M symbols.
    edge : float, optional
        t_e where she knows it; otherwise it is searched too.
    framed : bool
        Whether messages come in frames; otherwise symbols are raw bytes of text from the start.
    cap : int
        Hypotheses kept at most.
    certain : bool
        Whether it is public that every transition agrees: then no threshold is searched.

    Attributes
    ----------
    dropped : int
        Hypotheses that were dropped because the list was full.
    peak : int
        The longest that the list has been.
    solved_k : int
        The step at which a frame check first held; -1 not yet.
    whole_at : list of ((session, k), bytes)
        The last messages whose check held, with where they ended.
    """

    def __init__(
        self,
        scheme: Scheme[Any],
        edge: float | None = None,
        *,
        framed: bool = True,
        cap: int = CAP,
        certain: bool = False,
    ) -> None:
        self.size = size = scheme.alphabet
        self._table = StateTable(scheme)
        self.framed = framed
        self.certain = certain
        self.dropped = 0
        self.peak = 1
        self.solved_k = -1
        self.session = ""
        self.whole_at: list[tuple[tuple[str, int], bytes]] = []
        self.whole_count = 0
        self._cap = cap
        self._held = False
        self._passed = 0
        self._digits = digits_of(1, size)
        self._powers = size ** np.arange(self._digits)
        # Where the digits of a byte hold nothing else, every digit is judged as it comes; a block
        # of several bytes only when it is whole.
        self._block = block_bytes(size) if framed else 1
        longest = max(self._block, LENGTH_BYTES)
        self._block_digits = np.array([0, *(digits_of(n, size) for n in range(1, longest + 1))])
        self._ratios = table()
        self._rows = np.zeros(2 * cap + 64, dtype=_ROW)
        self._n = 1
        first = self._rows[:1]
        first["hi"] = np.inf if edge is None else edge
        first["edge_lo"] = 0.0 if edge is None else edge
        first["edge_hi"] = np.inf if edge is None else np.nextafter(edge, np.inf)
        self._fresh_frame(first)
        first["node"] = -1
        self._parent, self._k, self._symbol = array("i"), array("q"), bytearray()
        self._settled_k, self._settled = array("q"), bytearray()
        self._frame_from = 0

    def _fresh_frame(self, rows: NDArray[np.void]) -> None:
        for name in ("phase", "count", "value", "bytes"):
            rows[name] = 0
        rows["length"] = -1
        rows["crc"] = 0xFFFFFFFF
        rows["before"] = rows["last"] = OTHER
        if not self.framed:
            rows["phase"] = 1

    def restart(self) -> None:
        """A new session: scheme and frame from the start; what is known of t_c, t_e is kept."""
        self._settle(int(self._rows[: self._n]["score"].argmax()))
        self._settled_k, self._settled, self._frame_from = array("q"), bytearray(), 0
        rows = self._rows[: self._n]
        rows["state"] = 0
        self._fresh_frame(rows)

    # --- one transition ---------------------------------------------------------------------------

    def step(self, k: int, gauges: Sequence[float], cipher: int) -> None:
        """Count one transition that was seen whole.

        Parameters
        ----------
        k : int
        gauges : sequence of float, shape (M,)
            Of x(k+1) about each centre, in the unit in which t_c and t_e are searched.
        cipher : int
        """
        nearest = min(gauges)
        if self.certain:
            symbol = np.full(self._n, gauges.index(nearest))
            self._advance(k, symbol, self._values(cipher))
            return
        ordered = sorted(gauges)
        second, largest = ordered[1], ordered[-1]
        self._cut("lo", "hi", nearest)
        self._cut("lo", "hi", second)
        rows = self._rows[: self._n]
        inside = (rows["lo"] >= nearest) & (rows["hi"] <= second)
        if self._cut("edge_lo", "edge_hi", largest, inside):
            rows = self._rows[: self._n]
            inside = (rows["lo"] >= nearest) & (rows["hi"] <= second)
        agreed = inside & (rows["edge_lo"] >= largest)
        outside = rows["hi"] <= nearest
        if outside.any():
            rows["score"][outside] += OUTSIDE
        values = self._values(cipher)
        self._advance(k, np.where(agreed, gauges.index(nearest), NO_SYMBOL), values)

    def restrict(self, lo: float, hi: float, edge_lo: float, edge_hi: float) -> None:
        """Begin with a smaller rectangle than all: t_c and t_e from and to."""
        first = self._rows[:1]
        first["lo"], first["hi"] = lo, hi
        first["edge_lo"], first["edge_hi"] = edge_lo, edge_hi

    def widen(self, factor: float) -> None:
        """Let every hypothesis hold thresholds that are so much smaller and larger too."""
        rows = self._rows[: self._n]
        for low, high in (("lo", "hi"), ("edge_lo", "edge_hi")):
            rows[low] /= factor
            rows[high] *= factor

    def split_evenly(self, edges: Sequence[float]) -> None:
        """Cut the one hypothesis of the beginning at each t_c of ``edges``."""
        for edge in () if self.certain else edges:
            self._cut("lo", "hi", edge)

    def step_missed(self, k: int, cipher: int | None) -> None:
        """Count one transition without a verdict: taken for one without an agreement.

        Where every transition agrees, each symbol is as likely.
        """
        no = np.full((1, self.size), np.inf)
        self.step_sampled(k, no, cipher)

    def step_sampled(self, k: int, samples: NDArray[np.float64], cipher: int | None) -> None:
        """Count one transition of which something was missed or blurred.

        Each hypothesis whose verdict counts goes on as one for every outcome that is likely enough.

        Parameters
        ----------
        k : int
        samples : array, shape (S, M)
            Equally likely values of the gauges.
        cipher : int, optional
            None where it was missed: then every message symbol is possible.
        """
        ordered = np.sort(samples, axis=1)
        choice = samples.argmin(axis=1)
        values = self._values(0 if cipher is None else cipher)
        if cipher is None:
            carriers = np.flatnonzero(values != NO_SYMBOL)
            values[carriers] = 0
            for value in range(1, self.size):
                values = np.append(values, np.full(len(self._copy(carriers)), value))
            self._rows["score"][: self._n][values != NO_SYMBOL] -= np.log(self.size)
        tested = np.flatnonzero(self._tested())
        chances = self._chances(tested, ordered, choice)
        verdicts = np.full(self._n, NO_SYMBOL)
        best = chances.argmax(axis=1)
        for outcome in range(self.size + 1):
            likely = (best != outcome) & (chances[:, outcome] > UNLIKELY)
            also = tested[likely]
            if len(also):
                copies = self._copy(also)
                self._rows["score"][copies] += np.log(chances[likely, outcome])
                verdicts = np.append(verdicts, np.full(len(copies), outcome - 1))
                values = np.append(values, values[also])
        verdicts[tested] = best - 1
        self._rows["score"][tested] += np.log(chances[np.arange(len(tested)), best])
        self._advance(k, verdicts, values)

    def _tested(self) -> NDArray[np.bool_]:
        """Which hypotheses take this step for one whose verdict counts."""
        tested: NDArray[np.bool_] = self._table.tests[self._rows["state"][: self._n]]
        return tested

    def _values(self, cipher: int) -> Indices:
        """The message symbol that this step carries in each hypothesis, or -1 for none."""
        pads = self._table.pad  # of the states, which are fewer than the hypotheses
        carried = np.where(pads == NO_SYMBOL, NO_SYMBOL, (cipher - pads) % self.size)
        values: Indices = carried[self._rows["state"][: self._n]]
        return values

    def _advance(self, k: int, verdicts: Indices, values: Indices) -> None:
        """Let the scheme go on in every hypothesis, and take the message symbols."""
        rows = self._rows[: self._n]
        rows["state"] = self._table.following(rows["state"], verdicts)
        carriers = np.flatnonzero(values != NO_SYMBOL)
        if len(carriers):
            self._push(k, carriers, values[carriers])
        self._prune(k)

    def _chances(
        self, tested: Indices, ordered: NDArray[np.float64], choice: Indices
    ) -> NDArray[np.float64]:
        """Probability of each outcome (no agreement, symbol 0, 1, ...), shape (rows, 1 + M)."""
        chances = np.zeros((len(tested), 1 + self.size))
        if self.certain:
            blind = not np.isfinite(ordered[:, 0]).any()
            shares = np.bincount(choice, minlength=self.size) / len(choice)
            chances[:, 1:] = 1.0 / self.size if blind else shares
            return chances
        rows = self._rows[tested]
        lo, hi = rows["lo"][:, None], np.minimum(rows["hi"], 1e9)[:, None]
        nearest, second, largest = ordered[:, 0], ordered[:, 1], ordered[:, -1]
        overlap = np.minimum(hi, second) - np.maximum(lo, nearest)
        agree = np.clip(overlap / (hi - lo), 0.0, 1.0)
        agree *= rows["edge_lo"][:, None] >= largest
        for symbol in range(self.size):
            chances[:, 1 + symbol] = agree[:, choice == symbol].sum(axis=1) / len(choice)
        chances[:, 0] = np.maximum(1.0 - chances[:, 1:].sum(axis=1), 0.0)
        return chances

    def _copy(self, which: Indices) -> Indices:
        n, c = self._n, len(which)
        if n + c > len(self._rows):
            grown = np.zeros(2 * (n + c), dtype=_ROW)
            grown[:n] = self._rows[:n]
            self._rows = grown
        self._rows[n : n + c] = self._rows[which]
        self._n += c
        return np.arange(n, n + c)

    def _cut(self, low: str, high: str, at: float, where: NDArray[np.bool_] | None = None) -> bool:
        """Split the hypotheses whose verdict counts and whose interval holds ``at`` inside.

        Says whether there was one.
        """
        rows = self._rows[: self._n]
        crossed = (rows[low] < at) & (rows[high] > at)
        if where is not None:
            crossed &= where
        which = np.flatnonzero(crossed)
        which = which[self._table.tests[rows["state"][which]]]
        if not len(which):
            return False
        copies = self._copy(which)
        self._rows[low][copies] = at
        self._rows[high][which] = at
        return True

    # --- message symbols --------------------------------------------------------------------------

    def _push(self, k: int, which: Indices, values: NDArray[np.integer]) -> None:
        rows = self._rows
        base = len(self._symbol)
        self._parent.extend(rows["node"][which].tolist())
        self._k.extend([k] * len(which))
        self._symbol.extend(values.astype(np.uint8).tobytes())
        rows["node"][which] = np.arange(base, base + len(which))
        idle = rows["phase"][which] == 0
        if idle.any():
            outside, symbols = which[idle], values[idle]
            share = np.full(self.size, 1e-6)
            share[0], share[START] = IDLE_SHARE, 1 - IDLE_SHARE
            rows["score"][outside] += np.log(self.size * share)[symbols]
            rows["phase"][outside[symbols == START]] = 1
            which, values = which[~idle], values[~idle]
            if not len(which):
                return
        if self._block > 1:
            self._push_block(which)
            return
        if self.framed:
            which, values = self._check_digits(which, values)
        rows["value"][which] = rows["value"][which] * self.size + values
        rows["count"][which] += 1
        full = which[rows["count"][which] == self._digits]
        if len(full):
            self._push_bytes(full)

    def _push_bytes(self, which: Indices) -> None:
        rows = self._rows
        values = rows["value"][which]
        rows["value"][which] = 0
        rows["count"][which] = 0
        excess = values > 255
        if excess.any():
            self._refuse(which[excess])
            which, values = which[~excess], values[~excess]
        self._take(which, values)

    def _push_block(self, which: Indices) -> None:
        """Count a digit of a block of bytes; where it was the last, take the bytes in turn."""
        rows = self._rows
        rows["count"][which] += 1
        position = rows["bytes"][which]
        left = LENGTH_BYTES + rows["length"][which] + CHECK_BYTES - position
        size = np.where(position == 0, LENGTH_BYTES, np.minimum(left, self._block))
        digits = self._block_digits[size]
        full = rows["count"][which] == digits
        for count in np.unique(size[full]).tolist():
            group = which[full & (size == count)]
            numbers = [
                self._last_digits(int(node), int(digits_of(count, self.size)))
                for node in rows["node"][group]
            ]
            rows["count"][group] = 0
            fits = np.array([number < 256**count for number in numbers])
            self._refuse(group[~fits])
            group = group[fits]
            whole = [n.to_bytes(count, "big") for n in numbers if n < 256**count]
            table_of_bytes = np.frombuffer(b"".join(whole), dtype=np.uint8).reshape(-1, count)
            for place in range(count):
                going = rows["phase"][group] == 1
                group, table_of_bytes = group[going], table_of_bytes[going]
                if not len(group):
                    break
                right = self._check_bytes(group, table_of_bytes[:, place])
                group, table_of_bytes = group[right], table_of_bytes[right]
                self._take(group, table_of_bytes[:, place].astype(np.int32))

    def _last_digits(self, node: int, count: int) -> int:
        """The number that the last ``count`` symbols of a path write."""
        number, power = 0, 1
        while count and node >= 0:
            number += self._symbol[node] * power
            power, count, node = power * self.size, count - 1, self._parent[node]
        for symbol in reversed(self._settled[len(self._settled) - count :] if count else b""):
            number += symbol * power
            power *= self.size
        return number

    def _check_bytes(self, which: Indices, values: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Compare bytes of a frame's check with what they must be; refuse the wrong ones."""
        rows = self._rows
        place = rows["bytes"][which] - LENGTH_BYTES - rows["length"][which]
        tail = (rows["bytes"][which] >= LENGTH_BYTES) & (place >= 0)
        check = rows["crc"][which] ^ np.uint32(0xFFFFFFFF)
        shift = 8 * np.clip(CHECK_BYTES - 1 - place, 0, CHECK_BYTES - 1)
        byte = check >> shift.astype(np.uint32) & 0xFF
        begun = which[tail & (place == 0)]
        rows["mark"][begun] = rows["score"][begun]
        right: NDArray[np.bool_] = ~tail | (byte == values)
        rows["score"][which[tail & right]] += np.log(256)
        self._refuse(which[~right])
        return right

    def _take(self, which: Indices, values: NDArray[np.integer]) -> None:
        """The next byte of each row."""
        rows = self._rows
        position = rows["bytes"][which]
        rows["bytes"][which] += 1
        if not self.framed:
            self._text(which, values)
            return
        length = rows["length"][which]
        head = position < LENGTH_BYTES
        tail = ~head & (position >= LENGTH_BYTES + length)
        fed = which[~tail]
        crc = rows["crc"][fed]
        rows["crc"][fed] = _CRC[(crc ^ values[~tail]) & 0xFF] ^ (crc >> np.uint32(8))
        if head.any():
            self._head(which[head], position[head], values[head])
        body = ~head & ~tail
        if body.any():
            self._text(which[body], values[body])
        over = tail & (position == LENGTH_BYTES + length + CHECK_BYTES - 1)
        if over.any():
            self._hold(which[over])

    def _check_digits(
        self, which: Indices, values: NDArray[np.integer]
    ) -> tuple[Indices, NDArray[np.integer]]:
        """Compare each digit of a frame's check with what it must be; refuse at the first wrong."""
        rows = self._rows
        place = rows["bytes"][which] - LENGTH_BYTES - rows["length"][which]
        tail = (rows["bytes"][which] >= LENGTH_BYTES) & (place >= 0)
        if not tail.any():
            return which, values
        checked = which[tail]
        check = rows["crc"][checked] ^ np.uint32(0xFFFFFFFF)
        byte = check >> (8 * (CHECK_BYTES - 1 - place[tail])).astype(np.uint32) & 0xFF
        digit = byte // self._powers[self._digits - 1 - rows["count"][checked]] % self.size
        begun = (place[tail] == 0) & (rows["count"][checked] == 0)
        rows["mark"][checked[begun]] = rows["score"][checked[begun]]
        right = digit == values[tail]
        rows["score"][checked[right]] += np.log(self.size)
        self._refuse(checked[~right])
        going = np.ones(len(which), dtype=bool)
        going[np.flatnonzero(tail)[~right]] = False
        return which[going], values[going]

    def _head(
        self, which: Indices, position: NDArray[np.integer], values: NDArray[np.integer]
    ) -> None:
        rows = self._rows
        high = position == 0
        first, rest = which[high], which[~high]
        rows["length"][first] = values[high] << 8
        rows["score"][first] += np.where(
            values[high] == 0, np.log(256 * SHORT_SHARE), np.log(256 * (1 - SHORT_SHARE) / 255)
        )
        rows["length"][rest] |= values[~high]
        empty = rest[rows["length"][rest] == 0]
        self._refuse(empty)

    def _text(self, which: Indices, values: NDArray[np.integer]) -> None:
        rows = self._rows
        rows["score"][which] += self._ratios[rows["before"][which], rows["last"][which], values]
        rows["before"][which] = rows["last"][which]
        rows["last"][which] = class_of(values)

    def _refuse(self, which: Indices) -> None:
        if len(which):
            self._rows["score"][which] += REFUSED
            ended = self._rows[which]
            self._fresh_frame(ended)
            self._rows[which] = ended

    def _hold(self, which: Indices) -> None:
        """A frame check held: that is the message, unless too much of the check was guessed."""
        rows = self._rows
        rows["passed"][which] += rows["score"][which] - rows["mark"][which] >= SURE
        ended = rows[which]
        self._fresh_frame(ended)
        rows[which] = ended
        self._held = True

    def _collapse(self, k: int) -> None:
        """Where the best hypothesis is one whose frame check held, drop those whose did not."""
        rows = self._rows[: self._n]
        best = int(rows["score"].argmax())
        if rows["passed"][best] <= self._passed:
            self._held = bool(rows["passed"].max() > self._passed)
            return
        self._held = False
        self._passed = int(rows["passed"][best])
        if self.solved_k < 0:
            self.solved_k = k
        payload = self._last_frame(best)
        if payload is not None:
            self.whole_at.append(((self.session, k), payload))
            del self.whole_at[:-KEPT_MESSAGES]
            self.whole_count += 1
        passed = rows["passed"][: self._n]
        self._keep(np.flatnonzero(passed == passed[best]))
        best = int(self._rows["score"][: self._n].argmax())
        self._settle(best)
        self._frame_from = len(self._settled)

    def _last_frame(self, row: int) -> bytes | None:
        deframer = Deframer(self.size)
        payload = None
        for symbol in (*self._settled[self._frame_from :], *(s for _, s in self._path(row))):
            frame = deframer.push(symbol)
            if frame is not None and frame.intact:
                payload = frame.payload
        return payload

    # --- the list ---------------------------------------------------------------------------------

    def _keep(self, which: Indices) -> None:
        self._rows[: len(which)] = self._rows[which]
        self._n = len(which)

    def _prune(self, k: int) -> None:
        self.peak = max(self.peak, self._n)
        if self._held:
            self._collapse(k)
        rows = self._rows[: self._n]
        if self._n > self._cap:
            order = np.argpartition(-rows["score"], self._cap * 3 // 4)[: self._cap * 3 // 4]
            self.dropped += self._n - len(order)
            self._keep(np.sort(order))
        elif self.whole_count and self._n > 1:
            behind = rows["score"] < rows["score"].max() - BEHIND
            if behind.any():
                self._keep(np.flatnonzero(~behind))
        if len(self._symbol) > NODES:
            self._compact()
            while len(self._symbol) > NODES // 2 and self._n > 1:
                self._halve()
                self._compact()
            if self._n == 1:
                self._settle(0)

    def _halve(self) -> None:
        order = np.argsort(-self._rows["score"][: self._n], kind="stable")[: (self._n + 1) // 2]
        self.dropped += self._n - len(order)
        self._keep(np.sort(order))

    def _compact(self) -> None:
        """Forget the symbols that lie on no path of a hypothesis on the list."""
        parent = np.array(self._parent, dtype=np.intp)
        used = np.zeros(len(parent), dtype=bool)
        front = np.unique(self._rows["node"][: self._n])
        front = front[front >= 0]
        while len(front):
            used[front] = True
            front = np.unique(parent[front])
            front = front[(front >= 0) & ~used[front]]
        place = np.append(np.cumsum(used) - 1, -1)  # the last one is for -1, which has no place
        self._parent = array("i", place[parent[used]].astype(np.int32).tobytes())
        self._k = array("q", np.array(self._k, dtype=np.int64)[used].tobytes())
        self._symbol = bytearray(np.frombuffer(bytes(self._symbol), dtype=np.uint8)[used].tobytes())
        rows = self._rows[: self._n]
        rows["node"] = place[rows["node"]]

    def _settle(self, best: int) -> None:
        """Take the best hypothesis's symbols for granted and forget all paths."""
        for k, symbol in self._path(best):
            self._settled_k.append(k)
            self._settled.append(symbol)
        if len(self._settled) >= 2 * KEPT_SYMBOLS:
            del self._settled_k[:KEPT_SYMBOLS]
            del self._settled[:KEPT_SYMBOLS]
            self._frame_from = max(self._frame_from - KEPT_SYMBOLS, 0)
        self._parent, self._k, self._symbol = array("i"), array("q"), bytearray()
        self._rows["node"][: self._n] = -1
        rows = self._rows[: self._n]
        rows["score"] -= rows["score"].max()

    def _path(self, row: int) -> list[tuple[int, int]]:
        node = int(self._rows["node"][row])
        path = []
        while node >= 0:
            path.append((self._k[node], self._symbol[node]))
            node = self._parent[node]
        path.reverse()
        return path

    # --- what she thinks --------------------------------------------------------------------------

    @property
    def whole(self) -> list[bytes]:
        """The last messages whose frame check held."""
        return [payload for _, payload in self.whole_at]

    @property
    def hypotheses(self) -> int:
        """Rectangles on the list."""
        return self._n

    def candidates(self) -> int:
        """Distinct message decodings on the list."""
        rows = self._rows[: self._n]
        return len(np.unique(rows["node"])) if self._n > 1 else 1

    def confidence(self) -> float:
        """Share of the best hypothesis's decoding among all, taking the scores at their word."""
        rows = self._rows[: self._n]
        weight = np.exp(rows["score"] - rows["score"].max())
        best = rows["node"][rows["score"].argmax()]
        return float(weight[rows["node"] == best].sum() / weight.sum())

    def symbols(self) -> list[tuple[int, int]]:
        """Step and message symbol along the best hypothesis, the newest that are kept."""
        best = int(self._rows["score"][: self._n].argmax())
        settled = zip(self._settled_k, self._settled, strict=True)
        return [*settled, *self._path(best)][-KEPT_SYMBOLS:]

    def under_way(self) -> bytes:
        """The payload under way along the best hypothesis; without frames, all of the text."""
        best = int(self._rows["score"][: self._n].argmax())
        if not self.framed:
            return bytes_of((s for _, s in self.symbols()), self.size)
        deframer = Deframer(self.size)
        for symbol in (*self._settled[self._frame_from :], *(s for _, s in self._path(best))):
            deframer.push(symbol)
        return deframer.partial

    def thresholds(self) -> tuple[float, float, float, float]:
        """The best hypothesis's rectangle: t_c from, to, and t_e from, to."""
        row = self._rows[int(self._rows["score"][: self._n].argmax())]
        return float(row["lo"]), float(row["hi"]), float(row["edge_lo"]), float(row["edge_hi"])

    def testing(self) -> bool:
        """Whether the best hypothesis takes the next transition for a tested one."""
        best = int(self._rows["score"][: self._n].argmax())
        return bool(self._tested()[best])


def bytes_of(symbols: Iterable[int], size: int) -> bytes:
    """Symbols as bytes, most significant digit first; what exceeds 255 becomes 255."""
    digits = digits_of(1, size)
    out, value, count = bytearray(), 0, 0
    for symbol in symbols:
        value, count = value * size + symbol, count + 1
        if count == digits:
            out.append(min(value, 255))
            value = count = 0
    return bytes(out)
