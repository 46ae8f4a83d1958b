"""Both ends and the network between them as one state, and what may happen next.

What an end does depends on that end alone, so each of its steps is made once, by the real code, and
looked up afterwards: a state of the whole is three numbers. The network remembers the last messages
of each direction, and the last hellos before them, and delivers any of them, in any order, again
and again, or never: that is loss, repetition, delay and reordering at once.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from protocol.messages import ControllerHello, Message, Offer, PlantHello
from tests.campaigns.end import Doing, Side, View
from tests.campaigns.ends import Ends, Messages, Outcome
from tests.campaigns.loop import rules_of
from tests.support.safety import differing_key

BITS: Final = 28
"""Of each of a state's numbers."""

PATIENT: Final = 5
"""A plant that was not answered so often has waited for long."""

LONGEST: Final = 400
"""Events within which all must go on once all is well."""

WATCHED: Final = 16
"""Watched steps after which the stream has dropped blocks that were too old."""

HELLO: Final[tuple[type[Message], ...]] = (PlantHello, ControllerHello)

REMEMBERED: Final = 2
"""Last messages of each direction that the network may still deliver."""

HELLOS: Final = 2
"""Hellos of each direction that the network remembers beyond the last messages: those of lives that
are over are among them."""

SIDES: Final[tuple[Side, Side]] = ("plant", "controller")


class Moved(NamedTuple):
    """A state of the whole that comes next, what happened to which side, and what broke if any."""

    side: int
    outcome: Outcome
    state: int
    broken: str


Waiting = tuple[tuple[int, ...], tuple[int, ...]]
"""Messages that may still be delivered to one side: the last ones, and older hellos."""

Network = tuple[Waiting, Waiting]


class Space:
    """All states of the whole.

    A state is an integer: the network's number, the plant's and the controller's.

    Parameters
    ----------
    scheme : str
        A name in :data:`tests.campaigns.loop.SCHEMES`.
    keys : bool
        Keys are made.
    acts : bool
        The plant is a device.
    coin : bool
        Keys choose the coin. There, and with a scheme of the key stream,
        :func:`tests.support.short_keys.short_keys` while anything happens.
    """

    def __init__(self, scheme: str, *, keys: bool, acts: bool = False, coin: bool = False) -> None:
        self.messages = Messages()
        rules = rules_of(scheme, keys=keys, coin=coin)
        self.keys, self.coin, self.size = keys, coin, rules.size
        self.ends = tuple([Ends(side, rules, messages=self.messages, acts=acts) for side in SIDES])
        self._networks: list[Network] = []
        self._network_numbers: dict[Network, int] = {}
        self._pushed: dict[tuple[int, int, tuple[int, ...]], int] = {}
        self._well: set[_Well] = set()

    # --- states -----------------------------------------------------------------------------------

    def state(self, network: int, plant: int, controller: int) -> int:
        """The three numbers as one."""
        return (((network << BITS) | plant) << BITS) | controller

    def _network(self, network: Network) -> int:
        number = self._network_numbers.setdefault(network, len(self._networks))
        if number == len(self._networks):
            self._networks.append(network)
        return number

    def _push(self, network: int, side: int, said: tuple[int, ...]) -> int:
        """The network once ``side`` has sent something."""
        known = self._pushed.get((network, side, said))
        if known is None:
            both = list(self._networks[network])
            last, hellos = both[1 - side]
            for message in said:
                last = (*[other for other in last if other != message], message)
                gone, last = last[:-REMEMBERED], last[-REMEMBERED:]
                late = [other for other in gone if self.messages[other].kind in HELLO]
                hellos = tuple([other for other in hellos if other not in (message, *late)] + late)
                hellos = hellos[-HELLOS:]
            both[1 - side] = last, hellos
            known = self._pushed[network, side, said] = self._network((both[0], both[1]))
        return known

    # --- what may happen --------------------------------------------------------------------------

    def next(self, state: int, faults: int) -> Iterator[Moved]:
        """All that may happen next with so many faults at most."""
        mask = (1 << BITS) - 1
        controller, plant, network = state & mask, (state >> BITS) & mask, state >> 2 * BITS
        now = (plant, controller)
        waiting = self._networks[network]
        for side, end in enumerate(self.ends):
            mine = now[side]
            for outcomes in (
                end.alone(mine),
                *[end.hears(mine, message) for kept in waiting[side] for message in kept],
            ):
                for outcome in outcomes:
                    if outcome.faults > faults:
                        continue
                    after, said = outcome.after, outcome.said
                    broken = outcome.broken
                    theirs = now[1 - side]
                    if not broken and (
                        outcome.counted or outcome.again or outcome.kept or outcome.ended
                    ):
                        broken = self._differs(side, outcome, theirs)
                    net = self._push(network, side, said) if said else network
                    ends = (after, theirs) if side == 0 else (theirs, after)
                    yield Moved(side, outcome, self.state(net, *ends), broken)

    def _differs(self, side: int, outcome: Outcome, theirs: int) -> str:
        """Where what one end has done does not go with the other; empty where it does."""
        mine, other = self.ends[side].views[outcome.after], self.ends[1 - side].views[theirs]
        for t in outcome.counted:
            same = [c for c in other.counted if (c.session, c.j) == (t.session, t.j)]
            if same and same[0] != t:
                return f"transition {t.j}: the two ends counted it differently"
            if not same and SIDES[side] == "controller":
                return f"transition {t.j} was counted by the controller and not by the plant"
        if not (mine.forgot or other.forgot):
            if outcome.again:
                return "a message arrived again"
            if outcome.ended:
                return "a session ended, and no journal was lost"
        return _keys_differ(self.size, mine, other) or _keys_differ(self.size, other, mine)

    # --- when all is well -------------------------------------------------------------------------

    def goes_on(self, state: int) -> str:
        """What does not come once nothing is lost and nobody dies; empty where all comes.

        What was under way is lost. From there on what happens is determined, so a state that comes
        to one that is known to go on goes on, too. What must come is a message symbol, where keys
        are made a block that both ends confirm, and where they choose the coin a step that one
        watches.
        """
        mask = (1 << BITS) - 1
        at = _Well((state >> BITS) & mask, state & mask)
        goals = ("a message symbol", "a key block", "a watched step")[: 1 + self.keys + self.coin]
        path: list[_Well] = []
        met: set[_Well] = set()
        last = dict.fromkeys(goals, -1)
        confirmed = [-1, -1]
        while at not in self._well:
            if at in met or len(path) > LONGEST:
                missing = [goal for goal in goals if last[goal] < 0]
                if missing:
                    return f"{' and '.join(missing)} does not come through once all is well"
                raise AssertionError("a loop of which each round carries a symbol")
            met.add(at)
            path.append(at)
            at, side, outcome = self._well_step(at)
            if wrong := outcome.broken or self._differs(
                side, outcome, (at.controller, at.plant)[side]
            ):
                return f"once all is well: {wrong}"
            if outcome.carried and side == 0:
                last[goals[0]] = len(path)
            if outcome.confirmed and self.keys:
                confirmed[side] = len(path)
                last[goals[1]] = min(confirmed)
            if outcome.watched:
                last[goals[2]] = len(path)
            if min(last.values()) > 0:
                break
        else:
            self._well.update(path)
            return ""
        self._well.update(path[: min(last.values())])
        return ""

    def _well_step(self, at: "_Well") -> "tuple[_Well, int, Outcome]":
        plant, controller, to_plant, to_controller, coin, idle = at
        side, message = 0, -1
        if to_plant:
            message, to_plant = to_plant[0], to_plant[1:]
            doing = Doing("hears", message, coin if self.messages[message].kind is Offer else 0)
            coin ^= self.messages[message].kind is Offer
        elif to_controller:
            side, message, to_controller = 1, to_controller[0], to_controller[1:]
            # the plant asks again and again: in the end the one before it has been away for long
            asks = self.messages[message].kind is PlantHello
            doing = Doing("hears", message, pace="late" if asks else "")
        elif self.ends[0].busy[plant]:
            doing = Doing("extracts")
        elif self.ends[1].busy[controller]:
            side, doing = 1, Doing("extracts")
        else:
            idle = (idle + 1) % PATIENT
            doing = Doing("wakes", pace="" if idle else "late")
        outcome = self.ends[side].step((plant, controller)[side], doing)
        if outcome.answered:
            idle = 0
        if side == 0:
            plant, to_controller = outcome.after, to_controller + outcome.said
        else:
            controller, to_plant = outcome.after, to_plant + outcome.said
        return _Well(plant, controller, to_plant, to_controller, coin, idle), side, outcome

    def begin(self) -> list[int]:
        """The states of a run in which nothing goes wrong, from the first hello on.

        To a message, or, where keys choose the coin, to :data:`WATCHED` watched steps; and no
        further than to what breaks, or than :data:`LONGEST` events.
        """
        plant, controller = self.ends
        at = _Well(plant.first, controller.first, controller.greeting, plant.greeting)
        network = self._network((((), ()), ((), ())))
        for side, end in enumerate(self.ends):
            network = self._push(network, side, end.greeting)
        watched = 0
        starts = [self.state(network, at.plant, at.controller)]
        while len(starts) <= LONGEST:
            at, side, outcome = self._well_step(at)
            if outcome.broken:
                break
            network = self._push(network, side, outcome.said)
            starts.append(self.state(network, at.plant, at.controller))
            watched += outcome.watched
            if watched == WATCHED or (not self.coin and self.ends[0].views[at.plant].received):
                break
        return starts


def _keys_differ(size: int, mine: View, other: View) -> str:
    """Where the keys of one end do not go with those of the other; empty where they do."""
    if mine.session is None or mine.session != other.session:
        return ""
    if mine.confirmed > other.announced:
        return f"block {mine.confirmed} was confirmed, and the other end has not announced it"
    of_blocks = (mine.held.part.block, *[keys.block for keys in mine.held.keys])
    early = [block for block in of_blocks if block > mine.confirmed]
    if early:
        return f"digits of block {early[0]} are held before it is confirmed"
    return differing_key(size, mine.held, other.held)


class _Well(NamedTuple):
    """A state of such a run: both ends, what is under way to each, and the next coin."""

    plant: int
    controller: int
    to_plant: tuple[int, ...] = ()
    to_controller: tuple[int, ...] = ()
    coin: int = 0
    idle: int = 0
