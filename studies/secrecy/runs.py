"""Seeded runs of the closed loop for the secrecy study.

A run is the public transcript, message by message, and beside it the truth that only the scoring
sees. The loop is the system's own: the law's candidates, the agreement rule, the scheme and the
frames, all from their modules; random draws come from one seeded generator a run.
"""

import random
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import Final

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL, predict
from protocol.link.session import rules_of
from protocol.messages import Measurement, Offer
from protocol.scenario import Scenario
from protocol.schemes.base import encrypt
from protocol.schemes.framing import IDLE, encode_frame, frame_length
from protocol.vectors import Vector
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from wyner.runs.score.score import Truth
from wyner.simulate.single import closed_loop

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


def raw_symbols(text: bytes) -> bytes:
    """Text as bits without a frame, most significant first."""
    return bytes(byte >> place & 1 for byte in text for place in range(7, -1, -1))


def simulate(
    steps: int,
    seed: int,
    *,
    name: str = "sustained",
    alpha: float = 8.0,
    payloads: Sequence[bytes] | None = None,
    raw: bool = False,
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
    raw : bool
        Send the text's bits without frames, and idle symbols after it.
    corrupt : int, optional
        Encrypt the message symbol of this index under a wrong key: a negative control.
    """
    rng = random.Random(f"secrecy study {name} {seed}")
    scenario = scenario_at(name, alpha)
    law = law_of(name)
    if payloads is None:
        payloads = (text_of(rng),)
    size = scenario.secrecy.candidates
    if raw:
        stream = raw_symbols(b" ".join(payloads))
    else:
        stream = b"".join(encode_frame(p, size) for p in payloads)
    ends = list(accumulate(frame_length(len(payload), size) for payload in payloads))
    widths = scenario.plant.disturbance.half_widths
    session = f"{rng.getrandbits(64):016x}"
    rules = rules_of(scenario)
    scheme, judge = rules.scheme, rules.judge
    state = scheme.initial
    messages: list[Measurement | Offer] = []
    keys: dict[tuple[str, int], int] = {}
    symbols: dict[tuple[str, int], int] = {}
    whole: list[tuple[int, bytes]] = []
    sent = bytearray()
    cover = 0

    def toss(_k: int) -> int:
        nonlocal cover
        if scheme.pad(state) == NO_SYMBOL:
            cover = rng.randrange(size)
        return rng.randrange(size)

    def move(_k: int, x: Vector, u: Vector) -> Vector:
        centre = predict(scenario.A, scenario.B, x, u)
        return tuple(c + rng.uniform(-w, w) for c, w in zip(centre, widths, strict=True))

    def measured(k: int, x: Vector, after: Vector) -> Measurement:
        return Measurement.model_construct(
            session=session, k=k, x=x, applied_k=k - 1, x_after=after
        )

    for t in closed_loop(law.candidates, judge, toss, move, scenario.initial_state, steps):
        messages.append(measured(t.k, t.x, t.x if t.k else ()))
        pad, cipher = scheme.pad(state), cover
        if pad != NO_SYMBOL:
            p = len(sent)
            symbol = stream[p] if p < len(stream) else IDLE
            cipher = encrypt(symbol, pad, size)
            if corrupt == p:
                cipher = (cipher + 1) % size
            sent.append(symbol)
            symbols[session, t.k] = symbol
            if not raw and corrupt is None and len(sent) in ends:
                whole.append((t.k, payloads[ends.index(len(sent))]))
        messages.append(
            Offer.model_construct(session=session, k=t.k, candidates=t.candidates, cipher=cipher)
        )
        state, carry = scheme.advance(state, t.verdict.symbol)
        if carry.agreed != NO_SYMBOL:
            keys[session, t.k] = carry.agreed
    messages.append(measured(steps, t.x_next, t.x_next))
    truth = Truth(size, keys, symbols, tuple(whole), steps)
    return Run(scenario, tuple(messages), truth, bytes(sent), tuple(payloads))
