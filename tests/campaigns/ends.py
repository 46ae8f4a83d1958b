"""All states of one end that were met, and what comes of each: each step is made once."""

import hashlib
import zlib
from collections.abc import Hashable, Iterator
from typing import NamedTuple, TypeVar

from protocol.link.session import CountedTransition, Rules
from protocol.messages import ControllerHello, Measurement, Offer, PlantHello
from tests.campaigns.end import Doing, End, Side, View
from tests.campaigns.packing import pack, unpack
from tests.support.mail import Mail

T = TypeVar("T", bound=Hashable)


class Outcome(NamedTuple):
    """What came of something that happened to one end.

    ``label`` is the number of what happened, ``after`` its state, ``said`` the messages that it
    sent, ``counted`` the transitions that it counted. ``again``: a message arrived that had
    arrived; ``ended``: a session ended in which something was counted; ``carried``: a message
    symbol came through; ``confirmed``: a key block was; ``watched``: a key told which candidate
    must explain a transition; ``kept``: its journal holds other keys than before; ``answered``:
    the plant heard its controller. ``broken`` says which property does not hold.
    """

    label: int
    after: int
    said: tuple[int, ...] = ()
    counted: tuple[CountedTransition, ...] = ()
    again: bool = False
    ended: bool = False
    carried: bool = False
    confirmed: bool = False
    watched: bool = False
    kept: bool = False
    answered: bool = False
    faults: int = 0
    broken: str = ""


class Ends:
    """All states of one end that were met, and what comes of each.

    Parameters
    ----------
    side : {"plant", "controller"}
    rules : Rules
    messages : dict of Mail to int
        The numbers of messages, shared by both ends.
    acts : bool
        The plant is a device.
    """

    def __init__(
        self, side: Side, rules: Rules, *, messages: "Messages", acts: bool = False
    ) -> None:
        self.side: Side = side
        self.views: list[View] = []
        self.busy: list[bool] = []
        """Whether a block waits to be extracted."""
        self.doings: list[Doing] = []
        self._labels: dict[Doing, int] = {}
        self._kept: dict[Hashable, Hashable] = {}
        self._messages = messages
        self._numbers: dict[bytes, int] = {}
        self._images: list[bytes] = []
        self._made: dict[tuple[int, Doing], tuple[Outcome, int]] = {}
        self._hears: dict[tuple[int, int], tuple[Outcome, ...]] = {}
        self._alone: dict[int, tuple[Outcome, ...]] = {}
        end = End(side, rules, acts=acts)
        self.first = self._number(end)
        self.greeting = tuple([messages.number(message) for message in end.out])

    def __len__(self) -> int:
        return len(self._images)

    def find(self, end: End) -> int | None:
        """The number of a state, if it was met."""
        return self._numbers.get(hashlib.blake2b(pack(end), digest_size=16).digest())

    def _number(self, end: End) -> int:
        image = pack(end)
        digest = hashlib.blake2b(image, digest_size=16).digest()
        number = self._numbers.setdefault(digest, len(self._images))
        if number == len(self._images):
            self._images.append(zlib.compress(image, 1))
            counted = tuple(map(self._same, end.view.counted))
            self.views.append(self._same(end.view._replace(counted=counted)))
            self.busy.append(bool(end.tasks))
        return number

    def _same(self, value: T) -> T:
        """The first one of its equals: each is kept once."""
        return self._kept.setdefault(value, value)  # type: ignore[return-value]

    def _make(self, state: int, doing: Doing) -> tuple[Outcome, int]:
        """Let it happen, once; what comes of it, and how many things the end did over it."""
        known = self._made.get((state, doing))
        if known is not None:
            return known
        label = self._labels.setdefault(doing, len(self.doings))
        if label == len(self.doings):
            self.doings.append(doing)
        end = unpack(zlib.decompress(self._images[state]))
        view, before = end.view, end.view.counted
        kind, payload = self._messages[doing.message] if doing.message >= 0 else (None, b"")
        try:
            end.do(doing, kind, payload)
        except Exception as error:  # whatever the real code raises is a fault of it
            why = f"{type(error).__name__}: {error}"
            made = Outcome(label, state, faults=doing.faults, broken=why), 0
        else:
            carried = any(t.role == "message" and t not in before for t in end.news)
            made = (
                Outcome(
                    label,
                    self._number(end),
                    tuple([self._messages.number(message) for message in end.out]),
                    tuple(map(self._same, end.news)),
                    end.again,
                    end.ended,
                    carried,
                    end.confirmed,
                    end.watched,
                    _keys(end.view) != _keys(view),
                    end.answered,
                    doing.faults,
                ),
                end.things,
            )
        vars(end).clear()  # it goes round in circles
        self._made[state, doing] = made
        return made

    def step(self, state: int, doing: Doing) -> Outcome:
        """What comes of one thing that happens."""
        return self._make(state, doing)[0]

    def hears(self, state: int, message: int) -> tuple[Outcome, ...]:
        """All that may come of a message."""
        known = self._hears.get((state, message))
        if known is None:
            kind = self._messages[message].kind
            doings = [Doing("hears", message, coin) for coin in ((0, 1) if kind is Offer else (0,))]
            if kind is PlantHello:
                doings.append(Doing("hears", message, pace="late"))
            elif kind is Measurement:
                doings.append(Doing("hears", message, pace="soon"))
            known = self._hears[state, message] = tuple(self._distinct(state, doings))
        return known

    def alone(self, state: int) -> tuple[Outcome, ...]:
        """All that may happen without a message."""
        known = self._alone.get(state)
        if known is None:
            doings = [Doing("dies"), Doing("forgets")]
            if self.busy[state]:
                doings.append(Doing("extracts"))
            if self.side == "plant":
                doings += (Doing("wakes"), Doing("wakes", pace="late"), Doing("freezes"))
            known = self._alone[state] = tuple(self._distinct(state, doings))
        return known

    def _distinct(self, state: int, doings: list[Doing]) -> Iterator[Outcome]:
        """What comes of each, and of each with a death before every thing that the end does.

        What changes nothing, or comes to the same with no more faults, is left out.
        """
        met: set[tuple[object, ...]] = {(state, (), (), False, False)}
        outcomes = []
        for doing in doings:
            outcome, things = self._make(state, doing)
            if doing.pace == "late" and doing.message >= 0 and self._idle(state, doing, outcome):
                continue
            outcomes.append(outcome)
            if doing.pace != "soon":
                outcomes += [self._make(state, doing._replace(death=n))[0] for n in range(things)]
        for outcome in sorted(outcomes, key=lambda outcome: outcome.faults):
            what = (outcome.after, outcome.said, outcome.counted, outcome.again, outcome.ended)
            if outcome.broken or what not in met:
                met.add(what)
                yield outcome

    def _idle(self, state: int, doing: Doing, outcome: Outcome) -> bool:
        """Whether the time that passed before makes no difference yet: then it can pass later."""
        soon = self.step(state, doing._replace(pace=""))
        aged = soon if soon.broken else self.step(soon.after, Doing("freezes"))
        return (aged.after, soon.said, soon.counted) == (
            outcome.after,
            outcome.said,
            outcome.counted,
        )


def _keys(view: View) -> View:
    """What of it is about keys."""
    return view._replace(counted=(), received=0, forgot=False)


class Messages:
    """All messages that were sent, each with its number."""

    def __init__(self) -> None:
        self._all: list[Mail] = []
        self._numbers: dict[Mail, int] = {}

    def __len__(self) -> int:
        return len(self._all)

    def __getitem__(self, number: int) -> Mail:
        return self._all[number]

    def number(self, message: Mail) -> int:
        """The number of a message."""
        number = self._numbers.setdefault(message, len(self._all))
        if number == len(self._all):
            self._all.append(message)
        return number

    def told(self, number: int) -> str:
        """A message in a few words."""
        kind, payload = self._all[number]
        message = kind.model_validate_json(payload)
        if isinstance(message, Measurement | Offer):
            copy = f", copy {message.copy_number}" if message.nonce else ""
            return f"{message.topic} {message.k} of session {message.session[:8]}{copy}"
        assert isinstance(message, PlantHello | ControllerHello)
        if isinstance(message, PlantHello):
            asks = "anyone" if message.controller is None else message.controller[:8]
            return f"hello of plant {message.instance[:8]} to {asks}, at {message.applied_k}"
        return f"{message.verdict} of controller {message.instance[:8]}"
