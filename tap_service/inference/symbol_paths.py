"""The message symbols of many hypotheses as one tree: those that branched off late share most."""

from array import array
from collections.abc import Iterator

import numpy as np

from protocol.arrays import Indices
from tap_service.inference.kept import KEPT_SYMBOLS


class SymbolPaths:
    """A tree of symbols above a trunk that all hypotheses have in common.

    A path is named by its last node, and ends in the trunk at -1.

    Parameters
    ----------
    size : int
        M, the symbols there are.

    Attributes
    ----------
    frame_from : int
        Where in the trunk the frame under way begins.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._trunk_k, self._trunk = array("q"), bytearray()
        self.frame_from = 0
        self._clear()

    def _clear(self) -> None:
        self._parent, self._k, self._symbol = array("i"), array("q"), bytearray()

    def __len__(self) -> int:
        """Symbols in the tree, the trunk apart."""
        return len(self._symbol)

    def extend(self, k: int, nodes: Indices, symbols: Indices) -> Indices:
        """Put a symbol at the end of each path; the new ends."""
        base = len(self._symbol)
        self._parent.frombytes(nodes.astype(np.intc).tobytes())
        self._k.frombytes(np.full(len(nodes), k, dtype=np.int64).tobytes())
        self._symbol.extend(symbols.astype(np.uint8).tobytes())
        return np.arange(base, base + len(nodes))

    def path(self, node: int) -> list[tuple[int, int]]:
        """Steps and symbols from the trunk to a node."""
        path = []
        while node >= 0:
            path.append((self._k[node], self._symbol[node]))
            node = self._parent[node]
        path.reverse()
        return path

    def commit(self, node: int) -> None:
        """Let a path join the trunk, and forget all others; of the trunk the newest are kept."""
        for k, symbol in self.path(node):
            self._trunk_k.append(k)
            self._trunk.append(symbol)
        if len(self._trunk) >= 2 * KEPT_SYMBOLS:
            del self._trunk_k[:KEPT_SYMBOLS]
            del self._trunk[:KEPT_SYMBOLS]
            self.frame_from = max(self.frame_from - KEPT_SYMBOLS, 0)
        self._clear()

    def forget_trunk(self) -> None:
        """Begin with no symbol at all."""
        self._trunk_k, self._trunk, self.frame_from = array("q"), bytearray(), 0

    def end_frame(self) -> None:
        """The frame under way begins where the trunk ends."""
        self.frame_from = len(self._trunk)

    def steps_and_symbols(self, node: int) -> list[tuple[int, int]]:
        """The newest of the trunk and the path, as many as a belief keeps."""
        return [*zip(self._trunk_k, self._trunk, strict=True), *self.path(node)][-KEPT_SYMBOLS:]

    def frame(self, node: int) -> Iterator[int]:
        """The symbols since the last frame ended, along a path."""
        yield from self._trunk[self.frame_from :]
        yield from (symbol for _, symbol in self.path(node))

    def number(self, node: int, digits: int) -> int:
        """What the last ``digits`` symbols of a path write."""
        number, power = 0, 1
        while digits and node >= 0:
            number += self._symbol[node] * power
            power, digits, node = power * self._size, digits - 1, self._parent[node]
        for symbol in reversed(self._trunk[len(self._trunk) - digits :] if digits else b""):
            number += symbol * power
            power *= self._size
        return number

    def compact(self, nodes: Indices) -> Indices:
        """Forget the symbols that lie on none of these paths; the ends, as they are now."""
        parent = np.array(self._parent, dtype=np.intp)
        used = np.zeros(len(parent), dtype=bool)
        front = np.unique(nodes)
        front = front[front >= 0]
        while len(front):
            used[front] = True
            front = np.unique(parent[front])
            front = front[(front >= 0) & ~used[front]]
        place = np.append(np.cumsum(used) - 1, -1)  # the last one is for -1, which has no place
        self._parent = array("i", place[parent[used]].astype(np.intc).tobytes())
        self._k = array("q", np.array(self._k, dtype=np.int64)[used].tobytes())
        self._symbol = bytearray(np.frombuffer(bytes(self._symbol), dtype=np.uint8)[used].tobytes())
        ends: Indices = place[nodes]
        return ends
