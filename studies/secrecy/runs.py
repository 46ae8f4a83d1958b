"""Seeded runs of the closed loop for the secrecy study.

A run is the public transcript, message by message, and beside it the truth that only the scoring
sees. The loop is the engine's; random draws come from one seeded generator a run.
"""

import random
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import Final

import numpy as np

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array, Symbols
from protocol.messages import Measurement, Offer
from protocol.scenario import Scenario
from protocol.schemes.framing import encode_frame, frame_length
from protocol.schemes.registry import make_scheme
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from wyner.runs.score.score import Truth
from wyner.simulate.engine import Between, simulate_runs, transfer
from wyner.simulate.engine.taps import public_messages

SENTENCES: Final = (
    "We sail at dawn.",
    "Lower the bridge now",
    "Ration the fuel",
    "Nothing to report",
    "Tank five leaks",
    "Trust the night crew",
    "Close every hatch",
    "Cool the furnace",
    "Swap the two seals",
    "Use the north road",
    "Wait for my signal",
    "Bypass relay nine",
    "Guests arrive late",
    "Fog on the runway",
    "Paint it blue",
    "Quota is one tonne",
    "Move the cranes",
    "Ship the spare parts",
    "Hold the elevator",
    "Vent the boiler",
)
"""Messages of the study; none is in the text from which English plausibility was counted."""


@cache
def scenario_at(name: str, alpha: float) -> Scenario:
    """A shipped scenario with another alpha."""
    s = load_scenario(SCENARIOS / f"{name}.toml")
    return s.model_copy(update={"secrecy": s.secrecy.model_copy(update={"alpha": alpha})})


@cache
def law_of(name: str) -> CandidateLaw:
    """Its law; alpha does not matter to it."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    return make_law(scenario, cached_design(scenario))


@dataclass(frozen=True, slots=True)
class Run:
    """One seeded run.

    Parameters
    ----------
    messages : tuple
        The public transcript, in the order in which it was sent.
    truth : Truth
    stream : bytes
        The message symbols that the plant recovered, in order.
    payloads : tuple of bytes
        What was queued.
    """

    scenario: Scenario
    messages: tuple[Measurement | Offer, ...]
    truth: Truth
    stream: bytes
    payloads: tuple[bytes, ...]


def text_of(rng: random.Random) -> bytes:
    """A message of the study, drawn."""
    return rng.choice(SENTENCES).encode("ascii")


class _Chance(Between):
    """All that a run draws, from one generator: a cover where nothing is carried, the coin, d.

    Whether it carries is known from the verdicts before, so that a step is drawn at a time.
    """

    at_once = 1

    def __init__(self, scenario: Scenario, draw: random.Random) -> None:
        secrecy = scenario.secrecy
        self._draw, self._size, self._alpha = draw, secrecy.candidates, secrecy.alpha
        self._widths = scenario.plant.disturbance.half_widths
        self._scheme = make_scheme(secrecy.scheme, secrecy.candidates)
        self._state = self._scheme.initial
        self.covers: list[int] = []

    def block(self, k: int, steps: int) -> tuple[Array, Symbols]:  # noqa: ARG002
        """See :meth:`wyner.simulate.engine.draws.Draws.block`."""
        carries = self._scheme.pad(self._state) != NO_SYMBOL
        self.covers.append(0 if carries else self._draw.randrange(self._size))
        coin = self._draw.randrange(self._size)
        d = [self._draw.uniform(-w, w) for w in self._widths]
        return np.array(d)[None, :, None], np.array([[coin]])

    def settled(self, k: int, symbol: Symbols, largest: Array) -> None:  # noqa: ARG002
        """The automaton moves on."""
        agreed = int(symbol[0]) if largest[0] <= self._alpha else NO_SYMBOL
        self._state, _ = self._scheme.advance(self._state, agreed)


def simulate(
    steps: int,
    seed: int,
    *,
    name: str = "sustained",
    alpha: float = 8.0,
    payloads: Sequence[bytes] | None = None,
    corrupt: int | None = None,
) -> Run:
    """One run of the loop.

    Parameters
    ----------
    steps : int
        Transitions.
    seed : int
    payloads : sequence of bytes, optional
        Messages, one after the other; one drawn from :data:`SENTENCES` by default.
    corrupt : int, optional
        Encrypt the message symbol of this index under a wrong key: a negative control.
    """
    rng = random.Random(f"secrecy study {name} {seed}")
    scenario = scenario_at(name, alpha)
    if payloads is None:
        payloads = (text_of(rng),)
    size = scenario.secrecy.candidates
    stream = b"".join(encode_frame(p, size) for p in payloads)
    session = f"{rng.getrandbits(64):016x}"
    chance = _Chance(scenario, rng)
    runs = simulate_runs(
        scenario,
        law_of(name),
        seed=seed,
        runs=range(1),
        steps=steps,
        record=True,
        draws=chance,
        between=chance,
    )
    link = transfer(runs, symbols=stream, covers=np.array(chance.covers)[:, None])
    if corrupt is not None:
        wrong = (link.message_symbol != NO_SYMBOL) & (link.p == corrupt + 1)
        link.cipher[wrong] = (link.cipher[wrong] + 1) % size
    keys = {(session, k): key for k, key in enumerate(link.agreed[:, 0].tolist()) if key >= 0}
    sent = {(session, k): v for k, v in enumerate(link.message_symbol[:, 0].tolist()) if v >= 0}
    whole: list[tuple[int, bytes]] = []
    if corrupt is None:
        at = [k for _, k in sent]
        ends = accumulate(frame_length(len(payload), size) for payload in payloads)
        whole = [(at[end - 1], p) for end, p in zip(ends, payloads, strict=True) if end <= len(at)]
    truth = Truth(size, keys, sent, tuple(whole), steps)
    messages = tuple(public_messages(runs, link, 0, session))
    return Run(scenario, messages, truth, bytes(sent.values()), tuple(payloads))
