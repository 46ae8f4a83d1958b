"""What the dashboard knows: a frozen state, replaced by a pure reducer, one message at a time.

Nothing here reads a clock, a socket or a terminal. The time of arrival comes with the message, so a
recorded list of arrivals always gives the same state.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeVar

from protocol.messages import ControllerStatus, Message, PlantModel, PlantStatus, TapStatus
from protocol.relabelling import Pairs

T = TypeVar("T")

STEPS_KEPT: Final = 4096
"""Steps whose true symbols and guesses are held for scoring, so that a tap that decodes late is
scored too; older ones are forgotten."""

STATES_KEPT: Final = 240
"""States held for the history, at least as many as the widest sparkline shows."""

TEXTS_KEPT: Final = 8
"""True messages remembered, so that a tap still on an earlier one is judged against that one."""

PICTURE_NS: Final = 500_000_000
"""How long a pictured step stays: at many steps a second the eye needs time, and an agreement that
came meanwhile is preferred to what came after it."""

TAPS_KEPT: Final = 16
"""Taps by name; more names than this on the adversary bus are counted as malformed."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """A message and the time it came, in nanoseconds of a clock that never goes back."""

    t_ns: int
    message: Message


@dataclass(frozen=True, slots=True)
class ShownTruth:
    """What the plant says about one transition: its role, the key symbol (or -1), the coin b_r."""

    role: Literal["test", "message"]
    symbol: int
    coin: int


@dataclass(frozen=True, slots=True)
class ShownGuess:
    """What a tap says about one step: likeliest symbol, its probability, that of an agreement."""

    symbol: int
    probability: float
    agreed: float


@dataclass(frozen=True, slots=True)
class TapState:
    """One eavesdropper, from its statuses.

    ``exact`` and ``watched`` are set by the dashboard, never by the tap. ``exact``: its message was
    a true one, at least once. ``watched``: its statuses were received before it was sure of any
    message, while the truth was known. ``pairs`` counts the agreed steps whose guess and truth are
    held no more, by both, over all sessions.
    """

    status: TapStatus
    seen_ns: int
    guesses: Mapping[int, ShownGuess] = field(default_factory=dict)
    exact: bool = False
    watched: bool = False
    pairs: Pairs = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class State:
    """All that the screen and the plain lines are made from.

    ``model`` is what the plant says of itself; ``pictured`` is its status whose step is drawn;
    ``states`` are those that the plant reports, ``true_states`` what they are where it is attacked.
    """

    model: PlantModel | None = None
    plant: PlantStatus | None = None
    plant_seen_ns: int = -1
    controller: ControllerStatus | None = None
    controller_seen_ns: int = -1
    pictured: PlantStatus | None = None
    pictured_ns: int = -1
    taps: Mapping[str, TapState] = field(default_factory=dict)
    truths: Mapping[int, ShownTruth] = field(default_factory=dict)
    states: Mapping[int, tuple[float, ...]] = field(default_factory=dict)
    true_states: Mapping[int, tuple[float, ...]] = field(default_factory=dict)
    texts: tuple[str, ...] = ()

    @property
    def alarms(self) -> str:
        """The last alarm, in words; empty where there is none."""
        return "" if self.controller is None else self.controller.alarm_sentence()

    @property
    def away(self) -> float:
        """How far an attacked plant's true state is from the one reported, by component at most."""
        k = max(self.true_states, default=-1)
        reported = self.states.get(k, ())
        true = self.true_states.get(k, ())
        return max((abs(a - b) for a, b in zip(true, reported, strict=False)), default=0.0)

    received: int = 0
    refused: int = 0
    unreadable: int = 0

    @property
    def malformed(self) -> int:
        """Payloads that the source could not read, and statuses of more taps than are kept."""
        return self.unreadable + self.refused

    @property
    def last_seen_ns(self) -> int:
        """When the last status was received."""
        taps = (tap.seen_ns for tap in self.taps.values())
        return max(self.plant_seen_ns, self.controller_seen_ns, *taps)

    @property
    def candidates(self) -> int:
        """M, the number of candidates in an offer; 2 before the first pictured transition."""
        pictured = len(self.plant.pictured_candidates) if self.plant is not None else 0
        return max(2, pictured)

    @property
    def recovered(self) -> str:
        """The text the plant has so far: the frame on its way, or the last whole message."""
        if self.plant is None:
            return ""
        under_way = self.controller is not None and (
            self.controller.frame_symbols < self.controller.frame_length
            or self.controller.sending != self.plant.last_message
        )
        return self.plant.partial if self.plant.partial or under_way else self.plant.last_message

    @property
    def sent(self) -> str:
        """The text on its way, or, without a controller, what the plant has."""
        return self.controller.sending if self.controller is not None else self.recovered


def reduce(state: State, arrival: Arrival) -> State:
    """The state after one more arrival; anything else than these only counts."""
    state = replace(state, received=state.received + 1)
    match arrival.message:
        case PlantModel() as model:
            return replace(state, model=model)
        case PlantStatus() as status:
            return _plant(state, status, arrival.t_ns)
        case ControllerStatus() as status:
            return _controller(state, status, arrival.t_ns)
        case TapStatus() as status:
            return _tap(state, status, arrival.t_ns)
        case _:
            return state


def reduce_all(state: State, arrivals: Iterable[Arrival]) -> State:
    """`reduce` over many arrivals, in order."""
    for arrival in arrivals:
        state = reduce(state, arrival)
    return state


def _plant(state: State, status: PlantStatus, t_ns: int) -> State:
    if state.plant is not None and _stale(state.plant, status):
        return state
    if state.plant is not None and state.plant.session != status.session:
        # Steps may be counted afresh in a new session: what was known by step is void.
        state = replace(
            state,
            pictured=None,
            truths={},
            states={},
            true_states={},
            taps={
                name: replace(tap, guesses={})
                for name, tap in _forgotten(state, state.truths).items()
            },
        )
    truths, states = dict(state.truths), dict(state.states)
    tail = zip(
        status.tail_k,
        status.tail_x,
        status.tail_role,
        status.tail_symbol,
        status.tail_coin,
        strict=False,
    )
    for k, x, role, symbol, coin in tail:
        truths[k] = ShownTruth(role, symbol, coin)
        states[k] = x
    states[status.k] = status.x
    true_states = dict(state.true_states)
    for k, true in zip(status.tail_k, status.tail_true_x, strict=False):
        true_states[k + 1] = true
    state = _picture(state, status, t_ns)
    kept = _newest(truths, STEPS_KEPT)
    if len(kept) < len(truths):
        gone = truths.keys() - kept.keys()
        state = replace(state, taps=_forgotten(replace(state, truths=truths), gone))
    return _judge(
        replace(
            state,
            plant=status,
            plant_seen_ns=t_ns,
            truths=kept,
            states=_newest(states, STATES_KEPT),
            true_states=_newest(true_states, STATES_KEPT),
            texts=_with_text(state.texts, status.last_message),
        )
    )


def _picture(state: State, status: PlantStatus, t_ns: int) -> State:
    """Draw another step when the last one has been seen long enough, an agreement at once."""
    if status.pictured_k < 0:
        return state
    shown = state.pictured
    over = t_ns - state.pictured_ns >= PICTURE_NS
    better = shown is None or (status.pictured_symbol >= 0 > shown.pictured_symbol)
    if not over and not better:
        return state
    return replace(state, pictured=status, pictured_ns=t_ns)


def _controller(state: State, status: ControllerStatus, t_ns: int) -> State:
    if state.controller is not None and _stale(state.controller, status):
        return state
    return _judge(
        replace(
            state,
            controller=status,
            controller_seen_ns=t_ns,
            texts=_with_text(state.texts, status.sending),
        )
    )


def _tap(state: State, status: TapStatus, t_ns: int) -> State:
    before = state.taps.get(status.name)
    if before is not None and _stale(before.status, status):
        return state
    if before is None and len(state.taps) >= TAPS_KEPT:
        return replace(state, refused=state.refused + 1)
    guesses = dict(before.guesses) if before is not None else {}
    tail = zip(
        status.tail_k,
        status.tail_symbol,
        status.tail_probability,
        status.tail_agreed,
        strict=False,
    )
    for k, symbol, probability, agreed in tail:
        guesses[k] = ShownGuess(symbol, probability, agreed)
    kept = _newest(guesses, STEPS_KEPT)
    gone = _compared(
        state, guesses, guesses.keys() - kept.keys() if len(kept) < len(guesses) else ()
    )
    tap = TapState(
        status,
        t_ns,
        kept,
        pairs=gone if before is None else gone + Counter(before.pairs),
        exact=before is not None and before.exact,
        watched=(before is not None and before.watched)
        or (status.solved_k < 0 and bool(state.texts)),
    )
    return _judge(replace(state, taps={**state.taps, status.name: tap}))


def _compared(
    state: State, guesses: Mapping[int, ShownGuess], steps: Iterable[int]
) -> Counter[tuple[int, int]]:
    """Of these steps the agreed ones that a tap has guessed, by its guess and the truth."""
    found: Counter[tuple[int, int]] = Counter()
    for k in steps:
        guess, truth = guesses.get(k), state.truths.get(k)
        if guess is not None and truth is not None and truth.symbol >= 0:
            found[guess.symbol, truth.symbol] += 1
    return found


def compared(state: State, tap: TapState) -> Counter[tuple[int, int]]:
    """The agreed steps that a tap has guessed so far, by its guess and the truth."""
    return _compared(state, tap.guesses, tap.guesses) + Counter(tap.pairs)


def _forgotten(state: State, steps: Collection[int]) -> dict[str, TapState]:
    """The taps without their guesses of these steps, which are counted."""
    taps = {}
    for name, tap in state.taps.items():
        pairs = _compared(state, tap.guesses, steps) + Counter(tap.pairs)
        guesses = {k: guess for k, guess in tap.guesses.items() if k not in steps}
        taps[name] = replace(tap, guesses=guesses, pairs=pairs)
    return taps


def _judge(state: State) -> State:
    """Mark the taps whose message is a true one now."""
    found = {
        name: replace(tap, exact=True)
        for name, tap in state.taps.items()
        if not tap.exact and tap.status.message and tap.status.message in state.texts
    }
    return replace(state, taps={**state.taps, **found}) if found else state


def _stale(
    known: PlantStatus | ControllerStatus | TapStatus,
    new: PlantStatus | ControllerStatus | TapStatus,
) -> bool:
    # A service that was started again counts from zero but its clock is later: not stale.
    return new.seq < known.seq and new.t_ns < known.t_ns


def _newest(by_step: dict[int, T], limit: int) -> dict[int, T]:
    if len(by_step) <= limit:
        return by_step
    # An eighth more than needed goes at once, so that sorting is seldom.
    return {k: by_step[k] for k in sorted(by_step)[-(limit - limit // 8) :]}


def _with_text(texts: tuple[str, ...], text: str) -> tuple[str, ...]:
    if not text or text in texts:
        return texts
    return (*texts, text)[-TEXTS_KEPT:]
