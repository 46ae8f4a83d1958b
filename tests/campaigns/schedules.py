"""Seeded schedules of the whole link: ``python -m tests.campaigns.schedules --count 1000000``.

Each seed draws its own faults: loss, repetition, delay, deaths and lost journals. One in eight
makes keys too. An eighth of these key the coin, and half of those that act seal the messages too;
they take ten times as long. In half of all the plant acts: a device with a deadline, or a
simulation in lock-step that nobody can put back. Both endpoints, their journals and the shell are
those of the services. With ``--networks`` messages pass a network of the seed's own besides:
delays, losses alone or in bursts. ``--first`` goes on where another stopped.
"""

import gc
import json
import random
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache, partial
from typing import Any, Final, NamedTuple

from controller_service.laws.base import CandidateLaw
from plant_service.adapters.base import PlantAdapter, Sample, Stepped
from plant_service.core import PlantCore
from protocol.agreement import NO_SYMBOL, predict
from protocol.link.events import Event, Interrupted, Missed
from protocol.link.session import CountedTransition
from protocol.messages import Message, Offer
from protocol.scenario import Network, Scenario, parse_scenario
from protocol.scenario.defence import DefenceTable
from protocol.scenario.keys import Keys
from protocol.vectors import Vector
from runtime.perform import CrashPoint
from tests.campaigns.progress import Progress, arguments
from tests.support.line import disowned
from tests.support.recorded_pair import law_of
from tests.support.safety import differing_key, violations
from tests.support.short_keys import short_keys
from tests.support.watched import Watched
from wyner.simulate.faults import Faults
from wyner.simulate.network import Side

PAYLOADS: Final = (b"", b"x")
STEPS: Final = (6, 12, 24, 48)
"""Steps of a schedule; an eighth of them have the last two."""

MISLED: Final = 0.03
"""Probability, for each offer to a plant that acts, that its session ends about then."""

WATCHED_STEPS: Final = 96
"""Steps of a schedule that spends keys: its first ones come when some blocks are confirmed."""

DIGITS: Final = 5
"""Of a key there."""

SMALL_BLOCKS: Final = Keys(eps_E=0.99, eps_sec=1e-3)
"""Blocks of 2, 4, 8 ... transitions, so that some are confirmed within a schedule."""


@cache
def loop(*, keyed: bool, acts: bool, watched: bool = False) -> tuple[Scenario, CandidateLaw]:
    """The paper's loop, with keys or without, and what they serve; a plant that acts or not."""
    scenario, law = law_of("sustained")
    sealed = watched and acts
    if acts:
        tables = scenario.model_dump(mode="json", exclude_none=True, exclude_unset=True)
        tables["defender"] |= {"A": scenario.A, "B": scenario.B}
        tables["plant"] = {
            "kind": "python",
            "object": "tests.campaigns.schedules:Acting",
            "period_s": scenario.plant.period_s,
            "disturbance": {"enters": "none"},
        }
        scenario = parse_scenario(tables, "acting")
    made: dict[str, Any] = {"keys": SMALL_BLOCKS} if keyed else {}
    if watched:
        made["defence"] = DefenceTable(coin="keys")
    if sealed:
        made["secrecy"] = scenario.secrecy.model_copy(update={"scheme": "sealed"})
    return scenario.model_copy(update=made), law


class Acting:
    """The paper's plant as a device: it stands where it stands, whoever connects to it.

    Attributes
    ----------
    u, x : tuple of float
        The input of the step that was read last, None before the first; and where it led.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self._A, self._B = scenario.A, scenario.B
        self._draw = random.Random(seed)
        self._next: Vector | None = None
        self._t_ns = 1
        self.u: Vector | None = None
        self.x: Vector = (4.0, -2.0)
        self.passes: Callable[[CrashPoint], None]

    def start(self, seed: int | None) -> Sample:
        """Connect: a step has gone by; what it was told before is known to nobody."""
        self._go(self._next or (0.0,))
        self._next = self.u = None
        return self._sample()

    def apply(self, u: Vector) -> None:
        """Take an input."""
        self.passes("acting")
        self._next = u

    def sample(self) -> Sample:
        """A step is over."""
        self.passes("acting")
        self.u = self._next
        self._go(self._next or (0.0,))
        return self._sample()

    def _go(self, u: Vector) -> None:
        moved = predict(self._A, self._B, self.x, u)
        self.x = tuple([v + self._draw.uniform(-0.1, 0.1) for v in moved])

    def _sample(self) -> Sample:
        self._t_ns += 1
        return Sample(self.x, self._t_ns)

    def safe(self) -> None:
        """Nothing here fails."""
        raise AssertionError("it was sent to its safe state")

    def close(self) -> None:
        """Nothing is open."""


class ActingStepped:
    """The same as one that is stepped: a simulation without a state that could be set."""

    def __init__(self, device: Acting) -> None:
        self._device = device

    def reset(self, seed: int | None) -> Vector:
        """It goes on from where it stands."""
        return self._device.start(seed).y

    def step(self, u: Vector, period_s: float) -> Vector:
        """One step."""
        self._device.apply(u)
        return self._device.sample().y


def faults_of(seed: int) -> tuple[Faults, float | None, int, bool]:
    """The faults of a seed, the length of its steps (None for lock-step), how many, and keys."""
    draw = random.Random(seed)
    faults = Faults(
        loss=draw.choice((0.0, 0.05, 0.3)),
        repeat=draw.choice((0.0, 0.1, 0.5)),
        delay_s=draw.choice((0.0, 0.02, 0.2)),
        crash=draw.choice((0.0, 0.02, 0.1)),
        amnesia=draw.choice((0.0, 0.0, 0.3)),
        until_s=8.0,
    )
    (steps,) = draw.choices(STEPS, (6, 8, 1, 1))
    return faults, draw.choice((None, 0.1)), steps, seed % 8 == 0


def network_of(seed: int) -> Network:
    """The network of a seed: each way delays up to three periods, losses alone or in bursts."""
    draw = random.Random(f"network {seed}")
    return Network.model_validate(
        {"to_plant": _one_way(draw), "to_controller": _one_way(draw), "seed": seed}
    )


def _one_way(draw: random.Random) -> dict[str, Any]:
    latest = draw.choice((0.0, 0.03, 0.1, 0.3))
    table: dict[str, Any] = {
        "loss": draw.choice((0.0, 0.05, 0.3)),
        "reordering": draw.random() < 0.7,
    }
    if latest:
        table |= draw.choice(
            (
                {"delay": "constant", "delay_s": latest},
                {"delay": "uniform", "delay_s": latest / 2, "jitter_s": latest / 2},
                {"delay": "gamma", "delay_s": latest / 2, "jitter_s": latest / 4},
            )
        )
    if draw.random() < 0.4:
        table |= {"loss_bad": 0.9, "to_bad": 0.1, "to_good": 0.4}
    return table


class Scheduled(Watched):
    """A simulation whose device is looked at as it is told of."""

    def __init__(self, *args: Any, device: Acting | None = None, **kwargs: Any) -> None:
        self._device = device
        self.cut = 0
        """Steps that a session's end cut short."""
        super().__init__(*args, **kwargs)

    def _new_plant(self, incarnations: int) -> PlantCore:
        if self._device is not None:
            self._device.passes = self.ends["plant"].shell.passes
        return super()._new_plant(incarnations)

    def send(self, to: Side, message: Message) -> None:
        """Send a message; an offer to a plant that acts may be the last of its session."""
        super().send(to, message)
        if isinstance(message, Offer) and self._device is not None and self.chance(MISLED):
            self.after(self.random.random() * 0.2, self._end_the_session)

    def _end_the_session(self) -> None:
        """The controller was misled, or holds other keys: it does not know the session any more."""
        end = self.ends["plant"]
        if end.endpoint is None or self.plant.state.session.controller is None:
            return
        self.history.amnesias += 1
        self.deliver("plant", disowned(self.plant))

    def traced(self, event: Event) -> None:
        """A step of a device counts in the session in force, with what the device had."""
        super().traced(event)
        device = self._device
        if device is None or not isinstance(event, CountedTransition | Missed | Interrupted):
            return
        if isinstance(event, CountedTransition) and event.coin == NO_SYMBOL:
            return  # the controller's
        assert event.session == self.plant.state.record.session.id, "counted in another session"
        if device.u is None:  # of a process before, or before an input was known
            return
        assert event.x_next == device.x, "a step led elsewhere than its trace says"
        assert event.u == device.u, "a step had another input than its trace says"
        self.cut += isinstance(event, Interrupted)


class Outcome(NamedTuple):
    """What came of a schedule.

    ``keys`` that were confirmed, steps that a session's end ``cut`` short, steps that a
    key ``watched``, and what was ``wrong``.
    """

    keys: int = 0
    cut: int = 0
    watched: int = 0
    wrong: tuple[str, ...] = ()


def acts(seed: int) -> bool:
    """Whether the plant of a seed acts: half of them, with keys and without."""
    return seed // 8 % 2 == 1


def watched(seed: int) -> bool:
    """Whether the coin of a seed is keyed: of an eighth of those that make keys, acting or not."""
    return seed % 8 == 0 and seed // 16 % 8 == 1


def outcome_of(seed: int, *, networks: bool = False) -> Outcome:
    """What comes of the schedule of a seed, with a network of its own where asked."""
    faults, step_s, steps, keyed = faults_of(seed)
    spends = watched(seed)
    if spends:
        steps = WATCHED_STEPS
    scenario, law = loop(keyed=keyed, acts=acts(seed), watched=spends)
    if networks:
        scenario = scenario.model_copy(update={"network": network_of(seed)})
    device = Acting(scenario, seed) if acts(seed) else None
    own: Callable[[], Stepped | PlantAdapter] | None = None
    if device is not None:
        placed = device if step_s is not None else ActingStepped(device)
        own = partial(_placed, placed)
    try:
        link = Scheduled(
            scenario,
            law,
            seed=seed,
            payloads=PAYLOADS,
            faults=faults,
            step_s=step_s,
            run=seed,
            device=device,
            own=own,
        )
        with short_keys(DIGITS) if spends else nullcontext():
            history = link.run(steps=steps, seconds=200.0 if networks else 20.0)
            stuck = link.k < steps
    except AssertionError as error:
        return Outcome(wrong=(f"{type(error).__name__}: {error}",))
    lines = list(violations(history, PAYLOADS))
    if stuck and not lines:
        lines.append(f"{link.k} of {steps} steps, then none: the processes have long been well")
    if not keyed:
        return Outcome(0, link.cut, 0, tuple(lines))
    mine, theirs = (link.ends[side].journal.load() for side in ("controller", "plant"))
    if mine.record and theirs.record and mine.record.session.id == theirs.record.session.id:
        lines += filter(None, [differing_key(scenario.secrecy.candidates, mine.held, theirs.held)])
    look = link.onlooker
    return Outcome(sum(look.blocks.values()), link.cut, len(look.digits.watched), tuple(lines))


def _placed(plant: Stepped | PlantAdapter) -> Stepped | PlantAdapter:
    """The same plant in each process."""
    return plant


def main(argv: list[str] | None = None) -> int:
    """Go through the seeds; 1 when one broke something."""
    parser = arguments(__doc__)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--networks", action="store_true", help="a network for each seed")
    args = parser.parse_args(argv)
    done: Counter[str] = Counter()
    progress = Progress(args.seconds, lambda: dict(done))
    for made in (False, True):
        loop(keyed=True, acts=made)
    gc.freeze()  # what is loaded stays: searching it for garbage took an eighth of the time
    for seed in range(args.first, args.first + args.count):
        outcome = outcome_of(seed, networks=args.networks)
        done.update(schedules=1, keys=outcome.keys, cut=outcome.cut, watched=outcome.watched)
        done.update(acting=int(acts(seed)), broken=int(bool(outcome.wrong)))
        if outcome.wrong:
            print(f"seed {seed}: {outcome.wrong}")
        if not progress.goes_on():
            break
    print(json.dumps(done))
    return int(done["broken"] > 0)


if __name__ == "__main__":
    gc.set_threshold(50_000)  # garbage of some schedules at once: another eighth
    sys.exit(main())
