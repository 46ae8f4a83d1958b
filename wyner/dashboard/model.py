"""What the dashboard knows: a frozen state, replaced by a pure reducer, one message at a time.

Nothing here reads a clock, a socket or a terminal. The time of arrival comes with the message, so a
recorded list of arrivals always gives the same state.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

from protocol.messages import (
    ControllerStatus,
    Message,
    PlantModel,
    PlantStatus,
    Status,
    TapStatus,
)
from protocol.messages.adversary import TailGuess
from protocol.messages.management import PicturedStep, TailStep
from protocol.relabelling import Pairs

T = TypeVar("T")

STEPS_KEPT: Final = 4096
"""Steps whose true symbols and guesses are held for scoring, so that a tap that decodes late is
scored too; older ones are forgotten."""

TEXTS_KEPT: Final = 8
"""True messages remembered, so that a tap still on an earlier one is judged against that one."""

PICTURE_NS: Final = 500_000_000
"""How long a pictured step stays: at many steps a second the eye needs time, and an agreement that
came meanwhile is preferred to what came after it."""

TAPS_KEPT: Final = 16
"""Taps by name; more names than this on the adversary bus are counted as malformed."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """A message and the time it came, in nanoseconds of a clock that never goes back.

    None: what came was no message of its key.
    """

    t_ns: int
    message: Message | None


@dataclass(frozen=True, slots=True)
class TapState:
    """One eavesdropper, from its statuses.

    ``exact`` and ``watched`` are set by the dashboard, never by the tap. ``exact``: its message was
    a true one, at least once. ``watched``: its statuses were received before it was sure of any
    message, while the truth was known. ``pairs`` counts the agreed steps that were guessed, by
    guess and truth, over all sessions.
    """

    status: TapStatus
    guesses: Mapping[int, TailGuess] = field(default_factory=dict)
    exact: bool = False
    watched: bool = False
    pairs: Pairs = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LoopState:
    """What is known of one loop: all that the screen and the plain lines are made from.

    ``model`` is what the plant says of itself; ``pictured`` is the step that is drawn; ``truths``
    are the transitions that it has told, by step. ``seen`` is when a plant, controller or tap was
    heard last. ``malformed`` counts payloads that were no message, and statuses of more taps than
    are kept.
    """

    model: PlantModel | None = None
    plant: PlantStatus | None = None
    controller: ControllerStatus | None = None
    pictured: PicturedStep | None = None
    pictured_ns: int = -1
    taps: Mapping[str, TapState] = field(default_factory=dict)
    truths: Mapping[int, TailStep] = field(default_factory=dict)
    texts: tuple[str, ...] = ()
    seen: Mapping[str, int] = field(default_factory=dict)
    received: int = 0
    malformed: int = 0

    @property
    def alarms(self) -> str:
        """The last alarm, in words; empty where there is none."""
        return "" if self.controller is None else self.controller.alarms.sentence()

    @property
    def away(self) -> float:
        """How far an attacked plant's true state is from the one reported, by component at most."""
        k = max(self.truths, default=-1)
        if self.plant is None or k < 0:
            return 0.0
        true, reported = self.truths[k].true_x_next, self.plant.step.x
        if self.plant.step.k != k + 1:  # steps were missed since, of which the truth is not told
            true = self.truths[k - 1].true_x_next if k - 1 in self.truths else ()
            reported = self.truths[k].x
        return max((abs(a - b) for a, b in zip(true, reported, strict=False)), default=0.0)

    @property
    def candidates(self) -> int:
        """M, the number of candidates in an offer; 2 before the first pictured transition."""
        return 2 if self.pictured is None else len(self.pictured.gauges)

    @property
    def recovered(self) -> str:
        """The text the plant has so far: the frame on its way, or the last whole message."""
        if self.plant is None:
            return ""
        said, controller = self.plant.secrets, self.controller
        under_way = controller is not None and (
            controller.frame.symbols < controller.frame.length
            or controller.secrets.message != said.last_message
        )
        return said.message if said.message or under_way else said.last_message

    @property
    def sent(self) -> str:
        """The text on its way, or, without a controller, what the plant has."""
        return self.recovered if self.controller is None else self.controller.secrets.message


def reduce(state: LoopState, arrival: Arrival) -> LoopState:
    """The state after one more arrival; anything else than these only counts."""
    t_ns, message = arrival.t_ns, arrival.message
    if message is None:
        return replace(state, malformed=state.malformed + 1)
    state = replace(state, received=state.received + 1)
    match message:
        case PlantModel():
            return replace(state, model=message)
        case PlantStatus() if not _stale(state.plant, message):
            state = _heard(
                _plant(state, message, t_ns), "plant", t_ns, message.secrets.last_message
            )
        case ControllerStatus() if not _stale(state.controller, message):
            state = _heard(state, "controller", t_ns, message.secrets.message)
            state = replace(state, controller=message)
        case TapStatus():
            state = _tap(state, message, t_ns)
        case _:
            return state
    found = {
        name: replace(tap, exact=True)
        for name, tap in state.taps.items()
        if not tap.exact and tap.status.belief.message in state.texts
    }
    return replace(state, taps={**state.taps, **found}) if found else state


def reduce_all(state: LoopState, arrivals: Iterable[Arrival]) -> LoopState:
    """`reduce` over many arrivals, in order."""
    for arrival in arrivals:
        state = reduce(state, arrival)
    return state


def _heard(state: LoopState, service: str, t_ns: int, text: str = "") -> LoopState:
    """A service was heard; a true message that it told is remembered."""
    texts = state.texts
    if text and text not in texts:
        texts = (*texts, text)[-TEXTS_KEPT:]
    return replace(state, seen={**state.seen, service: t_ns}, texts=texts)


def _plant(state: LoopState, status: PlantStatus, t_ns: int) -> LoopState:
    if state.plant is not None and state.plant.session != status.session:
        # Steps may be counted afresh in a new session: what was known by step is void.
        taps = {name: replace(tap, guesses={}) for name, tap in state.taps.items()}
        state = replace(state, pictured=None, truths={}, taps=taps)
    told = {row.k: row for row in status.secrets.tail}
    agreed = {k: r.symbol for k, r in told.items() if r.symbol >= 0 and k not in state.truths}
    taps = {
        name: _compared(tap, {k: symbol for k, symbol in agreed.items() if k in tap.guesses})
        for name, tap in state.taps.items()
    }
    return replace(
        _picture(state, status, t_ns),
        plant=status,
        taps=taps,
        truths=_newest({**state.truths, **told}),
    )


def _picture(state: LoopState, status: PlantStatus, t_ns: int) -> LoopState:
    """Draw another step when the last one has been seen long enough, an agreement at once."""
    shown, new = state.pictured, status.secrets.pictured
    if new is None:
        return state
    over = t_ns - state.pictured_ns >= PICTURE_NS
    better = shown is None or new.symbol >= 0 > shown.symbol
    return replace(state, pictured=new, pictured_ns=t_ns) if over or better else state


def _tap(state: LoopState, status: TapStatus, t_ns: int) -> LoopState:
    tap = state.taps.get(status.name)
    if tap is None and len(state.taps) >= TAPS_KEPT:
        return replace(state, malformed=state.malformed + 1)
    if tap is None:
        tap = TapState(status)
    elif _stale(tap.status, status):
        return state
    told = {guess.k: guess for guess in status.tail}
    agreed = {k: state.truths[k].symbol for k in told if k in state.truths}
    agreed = {k: symbol for k, symbol in agreed.items() if symbol >= 0}
    tap = _compared(tap, {k: symbol for k, symbol in agreed.items() if k in tap.guesses}, -1)
    tap = replace(
        tap,
        status=status,
        guesses=_newest({**tap.guesses, **told}),
        watched=tap.watched or (status.belief.solved_k < 0 and bool(state.texts)),
    )
    tap = _compared(tap, agreed)
    return _heard(replace(state, taps={**state.taps, status.name: tap}), "tap", t_ns)


def _compared(tap: TapState, agreed: Mapping[int, int], times: int = 1) -> TapState:
    """The tap, of whose guesses those of these steps count, or (-1) do not count any more."""
    if not agreed:
        return tap
    pairs = Counter(tap.pairs)
    for k, symbol in agreed.items():
        pairs[tap.guesses[k].symbol, symbol] += times
    return replace(tap, pairs=pairs)


def _stale(known: Status | TapStatus | None, new: Status | TapStatus) -> bool:
    # A service that was started again counts from zero but its clock is later: not stale.
    return known is not None and new.seq < known.seq and new.t_ns < known.t_ns


def _newest(by_step: dict[int, T]) -> dict[int, T]:
    if len(by_step) <= STEPS_KEPT:
        return by_step
    # An eighth more than needed goes at once, so that sorting is seldom.
    return {k: by_step[k] for k in sorted(by_step)[-(STEPS_KEPT - STEPS_KEPT // 8) :]}
