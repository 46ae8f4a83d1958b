"""Every interleaving, to a depth: ``python -m tests.campaigns.exhaustive --scheme switched``.

Breadth first with states hashed, so that the first counterexample is a shortest one. Every new
state is then left alone with a network that loses nothing, and must go on.
"""

import gc
import sys
from array import array
from collections.abc import Callable
from typing import Final

from tests.campaigns.loop import DIGITS, SCHEMES
from tests.campaigns.progress import Progress, arguments
from tests.campaigns.space import LONGEST, SIDES, Space
from tests.support.short_keys import short_keys

BEFORE_A_MESSAGE: Final = slice(-11, -1)
"""The last ten states before a message is whole: a key block is made on the way.

Where keys choose the coin, the last ten before a watched step.
"""


class Exploration:
    """All states within so many events and faults of a run in which nothing goes wrong.

    Parameters
    ----------
    space : Space
    faults : int
        Deaths, lost journals and freezes at most.
    starts : slice
        Where in that run, from its first hello to a whole message, to begin.
    """

    def __init__(self, space: Space, faults: int, starts: slice) -> None:
        self.space, self.faults = space, faults
        self.seen: dict[int, int] = {}
        """States, and the fewest faults that lead there so far."""
        self.depth = self.events = self.tried = 0
        begun = space.begin()
        self.first = begun[starts]
        self.why = "no message arrives although all is well" if len(begun) > LONGEST else ""
        self.path: list[str] = []
        self._parents, self._labels = array("L"), array("L")
        self._frontier, self._next = array("L"), array("L")
        self._states: list[int] = []
        self._next_states: list[int] = []
        self._place = 0
        for number, start in enumerate(self.first):
            if start not in self.seen:
                self._add(start, faults, number, 0)
        self._turn()

    def _add(self, state: int, left: int, parent: int, label: int) -> None:
        self.seen[state] = left
        self._next.append(len(self._parents))
        self._next_states.append(state)
        self._parents.append(parent)
        self._labels.append(label)

    def _turn(self) -> None:
        """What was found is explored next."""
        self._frontier, self._next = self._next, array("L")
        self._states, self._next_states = self._next_states, []
        self._place = 0

    def deeper(self, goes_on: Callable[[], bool] = lambda: True) -> bool:
        """Explore one event further; False when something broke, or it was not to go on."""
        seen, space, states, nodes = self.seen, self.space, self._states, self._frontier
        while self._place < len(states):
            state, node = states[self._place], nodes[self._place]
            left = seen[state]
            for side, outcome, after, broken in space.next(state, left):
                self.events += 1
                rest = left - outcome.faults
                label = 2 * outcome.label + side
                if broken:
                    return self._breaks(node, label, broken)
                known = seen.get(after, -1)
                if known >= rest:
                    continue
                self._add(after, rest, node, label)
                if known < 0 and (wrong := space.goes_on(after)):
                    return self._breaks(node, label, wrong)
            self._place += 1
            if self._place % 100 == 0 and not goes_on():
                return False
        self.depth += 1
        self._turn()
        return True

    @property
    def share(self) -> float:
        """Of the states at the present depth, how many have been explored."""
        return self._place / max(1, len(self._states))

    @property
    def over(self) -> bool:
        """Whether no state is left to be explored."""
        return not self._states

    def _breaks(self, node: int, label: int, why: str) -> bool:
        labels = [label]
        while node >= len(self.first):
            labels.append(self._labels[node])
            node = self._parents[node]
        self.why, self.path = why, [self._told(label) for label in reversed(labels)]
        return False

    def _told(self, label: int) -> str:
        side, doing = label % 2, self.space.ends[label % 2].doings[label // 2]
        words = f"{SIDES[side]} {doing.what}"
        if doing.message >= 0:
            words += f" {self.space.messages.told(doing.message)}"
        if doing.what == "hears" and side == 0 and "offer" in words:
            words += f", coin {doing.coin}"
        if doing.pace:
            words += {"late": ", after a long time", "soon": ", at once"}[doing.pace]
        if doing.death >= 0:
            words += f", and dies after {doing.death} of what it does then"
        return words


def shortest(
    space: Space, deepest: int, faults: int, starts: slice = BEFORE_A_MESSAGE
) -> Exploration:
    """Explore up to ``deepest`` events, or until something breaks."""
    found = Exploration(space, faults, starts)
    while not found.why and found.depth < deepest and found.deeper():
        pass
    return found


def main(argv: list[str] | None = None) -> int:
    """Explore for as long as is asked; 1 when something broke."""
    parser = arguments(__doc__)
    parser.add_argument("--scheme", choices=SCHEMES, required=True)
    parser.add_argument("--faults", type=int, default=2, help="deaths, lost journals, freezes")
    parser.add_argument("--acts", action="store_true", help="the plant is a device")
    parser.add_argument("--no-keys", action="store_true", help="no key blocks are made")
    parser.add_argument("--coin", action="store_true", help="keys choose the plant's coin")
    parser.add_argument("--from-hello", action="store_true", help="begin before both ends met")
    parser.add_argument("--deepest", type=int, default=100)
    args = parser.parse_args(argv)
    if args.coin and args.no_keys:
        parser.error("--coin: keys choose it, and --no-keys makes none")
    space = Space(args.scheme, keys=not args.no_keys, acts=args.acts, coin=args.coin)

    def told() -> str:
        depth, ends = found.depth + found.share, [len(end) for end in space.ends]
        return f"depth {depth:.3f}, {len(found.seen):,} states, {found.events:,} events, {ends}"

    starts = slice(0, 1) if args.from_hello else BEFORE_A_MESSAGE
    progress = Progress(args.seconds, told)
    with short_keys(DIGITS):
        found = Exploration(space, args.faults, starts)
        going = not found.why
        while going and not found.over and found.depth < args.deepest:
            going = found.deeper(progress.goes_on)
    print(told())
    if found.why:
        print(f"{found.why}, after {len(found.path)} events:")
        for number, words in enumerate(found.path, start=1):
            print(f"{number:4} {words}")
    return int(bool(found.why))


if __name__ == "__main__":
    gc.freeze()
    gc.disable()  # hardly anything here goes round in circles
    sys.exit(main())
