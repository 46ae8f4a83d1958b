"""The study of the attacks: attack by defence by who has the key, a row each.

Who has the keys is worked out, not stated. Of distilled keys she has what the copies that she heard
give away (:func:`tap_service.eavesdroppers.key_solver.bits_held`); keys of the paper's own channel
she reads with the eavesdropper `nearest-centre`.
"""

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist
from typing import Any, Final, Literal

import numpy as np

from attacker_service.attacks import named
from attacker_service.base import UNKNOWN, Attack, LoopModel
from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.arrays import Array, Flags
from protocol.scenario import Scenario
from protocol.secret.bound import Assumption
from studies.attacks.attacked import KEY_BITS, ONSET, Attacked, Keys, attack_runs
from studies.registry import study
from studies.signalling import changed
from tap_service import eavesdroppers
from tap_service.eavesdroppers.key_solver import bits_held
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.taps import transcript

SEED: Final = 7
RUNS: Final = 8000
FEW: Final = 2000
STEPS: Final = 40
SETTLED: Final = 100
"""Honest steps before a replay, which records the last fifty."""
LONG: Final = 100
"""Attacked steps where she is never seen: 10 s of the paper's plant."""

TRANSITIONS: Final = 256
CLAIM: Final = Assumption(0.3)
"""What is claimed of every distilled key here: she misses three copies of ten at least."""

Who = Literal["nobody", "secret", "false claim", "nearest-centre"]
"""Who has the key besides both ends: ``secret``: the claim is true, nobody else. ``nobody``: there
is none, the coin is private."""

MISSED: Final[dict[Who, float]] = {"secret": 0.3, "false claim": 0.0}
"""Share of copies that she misses in truth."""

COLUMNS: Final = (
    "group attack defence key scenario M runs onset steps seed held unseen false_alarms "
    "honest_steps away away_error away_largest shown_largest theory key_bits"
)


@dataclass(frozen=True, slots=True)
class Task:
    """One row: who attacks, what stands against her, and who has the key.

    Parameters
    ----------
    group : str
        The part of the table that it belongs to.
    attack : str
        A name of :data:`ATTACKERS`, or ``none``.
    defences : tuple of str
        Beside the residual test.
    key : str
    """

    group: str
    attack: str
    defences: tuple[str, ...] = ()
    key: Who = "nobody"
    scenario: str = "packed"
    candidates: int = 4
    runs: int = FEW
    steps: int = STEPS
    onset: int = ONSET
    eye: float | None = None
    gaussian: bool = False
    disturbance: str = ""

    @property
    def id(self) -> str:
        """A hash of what is measured and how."""
        return hashlib.sha256(f"{self!r} seed {SEED}".encode()).hexdigest()[:12]

    @property
    def defence(self) -> str:
        """Its defences in a few words."""
        names = ["Gaussian watermark"] if self.gaussian else list(self.defences)
        return " + ".join(names) or "residual"


EYES: Final = (0.06, 0.12, 0.24)
"""Noise through which a ghost sees the plant."""

ATTACKERS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "ghost": ("ghost", {"push": 1.0, "share": 0.0}),
    "quiet ghost": ("ghost", {"push": 0.0, "share": 0.0}),
    **{f"ghost, sees {noise:g}": ("ghost", {"sees": noise}) for noise in EYES},
    "ghost who sees exactly": ("bias", {"push": 1.0}),
    "covert, 0.3": ("covert", {"input": 0.3}),
    "covert, 0.1": ("covert", {"input": 0.1}),
    "replay": ("replay", {}),
    "stuck": ("stuck", {}),
}
"""The attacker's own classes with their options. The ghost says that D_c did all it may in one
direction, so that the plant is driven in the other; the quiet one that it did nothing."""

DISTURBANCES: Final[dict[str, dict[str, Any]]] = {
    "uniform": {},
    "truncated Gaussian": {"kind": "truncated-gaussian"},
    "sinusoid": {"kind": "sinusoid"},
    "constant": {"kind": "constant"},
    "corners of D": {"kind": "corners"},
    "corners of D_c": {"kind": "corners", "half_widths": [0.12, 0.12]},
    "constant corner of D_c": {"kind": "constant", "half_widths": [0.12, 0.12]},
}
"""Every disturbance of the sweep ``disturbances`` that stays in D_c, and its corner for ever."""


def tasks() -> Iterator[Task]:
    """The whole study."""
    coin = ("keyed-coin",)
    both: tuple[Who, ...] = ("false claim", "secret")
    for who in both:
        yield Task("key", "ghost", coin, who, runs=RUNS, steps=LONG)
    yield Task("key", "ghost", coin, "nearest-centre", steps=LONG)
    yield Task("key", "ghost", (), "nobody", runs=RUNS, steps=LONG)
    yield Task("key", "quiet ghost", coin, "secret", runs=RUNS)
    yield Task("key", "quiet ghost", (), "secret", runs=RUNS, gaussian=True)
    for size in (2, 3):
        yield Task("size", "ghost", coin, "secret", candidates=size, runs=RUNS)
    yield Task(
        "size",
        "ghost",
        coin,
        "secret",
        scenario="packed-quadruple-tank",
        candidates=16,
        runs=4 * FEW,
        steps=5,
        onset=10,
    )
    for eye in EYES:
        yield Task("eye", "ghost", coin, "secret", runs=RUNS, eye=eye)
    yield Task("limit", "ghost who sees exactly", coin, "secret", runs=RUNS, steps=LONG)
    for attack in ("covert, 0.3", "covert, 0.1"):
        yield Task("bus", attack, (), "nobody", steps=60)
        yield Task("bus", attack, coin, "secret", steps=60)
        for who in both:
            yield Task("bus", attack, ("coding", *coin), who, runs=RUNS, steps=60)
        yield Task("bus", attack, ("coding",), "secret", runs=RUNS, steps=60)
        for who in both:
            yield Task("bus", attack, ("mac",), who, steps=60)
    for attack in ("ghost", "ghost who sees exactly", "replay", "stuck", "covert, 0.3"):
        # what is replayed is of the settled loop
        onset = SETTLED if attack == "replay" else ONSET
        yield Task("matrix", attack, onset=onset)
        for defence in ("keyed-coin", "coding", "mac"):
            for who in both:
                yield Task("matrix", attack, (defence,), who, onset=onset)
    for disturbance in DISTURBANCES:
        yield Task("honest", "none", coin, "secret", runs=4000, steps=400, disturbance=disturbance)
    for noise in EYES:
        yield Task("eye", f"ghost, sees {noise:g}", coin, "secret")


@cache
def loop_of(name: str, candidates: int, disturbance: str) -> tuple[Scenario, CandidateLaw]:
    """The scenario of a task, and its law."""
    tables: dict[str, dict[str, Any]] = {"secrecy": {"candidates": candidates}}
    if disturbance:
        tables["plant"] = {"disturbance": {"half_widths": [0.1, 0.1], **DISTURBANCES[disturbance]}}
    scenario = changed(name, **tables)
    return scenario, make_law(scenario, cached_design(scenario))


def distilled(who: Who, runs: int, draw: np.random.Generator) -> Flags:
    """Runs whose distilled key she has any bit of, by the copies that she missed of its block."""
    copies = CLAIM.copies * TRANSITIONS
    rows = CLAIM.rows(TRANSITIONS, TRANSITIONS, copies)
    missed = draw.binomial(copies, MISSED[who], size=runs)
    return np.array([bits_held(rows, int(e)) > 0 for e in missed])


def read_keys(scenario: Scenario, law: CandidateLaw, runs: int, steps: int) -> tuple[Keys, Array]:
    """Keys of the paper's own channel as digits, and what `nearest-centre` takes them for.

    A first run of so many steps, under private coins, agrees on them while she listens; the
    attacked run begins where it ended.
    """
    first = simulate_runs(scenario, law, seed=SEED, runs=range(runs), steps=steps, record=True)
    link = transfer(first)
    believed = np.full(link.agreed.shape, UNKNOWN, dtype=np.int64)
    for place in range(runs):
        tap = eavesdroppers.named("nearest-centre")(scenario.knowledge())
        for t in transcript(first, link, place):
            believed[t.k, place] = tap.observe(t).best
    assert first.x is not None
    digits = link.agreed.astype(np.int64)
    held = (believed == digits).all(axis=0)
    return Keys(held, digits, believed), np.ascontiguousarray(first.x[-1].T)


def theory(task: Task, scenario: Scenario) -> float | None:
    """What a step is passed with, where a theorem or a closed form says it."""
    size = task.candidates
    if task.gaussian:
        return gaussian_passes(packed(size))
    if task.eye is not None:
        return seen_through(task.eye, scenario)
    if task.key == "secret" and task.attack in ("ghost", "quiet ghost"):
        return 1 / size if "keyed-coin" in task.defences else 1.0
    return None


def packed(size: int) -> float:
    """Variance of M points a sigma apart, in sigma^2; each is passed with probability 1/M.

    Points so close may touch, so the project's alphabets stand a millionth farther apart.
    """
    return float(np.arange(size).var())


def gaussian_passes(variance: float) -> float:
    """How often a normal dither of this variance, in sigma^2, is passed.

    Of its windows of length sigma the middle one holds the most, 2 Phi(sigma / 2 s) - 1.
    """
    return 2 * NormalDist().cdf(0.5 / math.sqrt(variance)) - 1


def seen_through(noise: float, scenario: Scenario) -> float:
    """How often the nearest of M pushes B p_i is the true one, through white noise; one input.

    (2 Phi(a) + (M - 2)(2 Phi(a) - 1)) / M with a = abs(B) spacing / (2 noise): the two outer ones
    are mistaken on one side.
    """
    from scipy.special import ndtr

    offsets = cached_design(scenario).offsets
    assert offsets is not None
    size = len(offsets)
    gap = float(np.linalg.norm(np.array(scenario.B) @ (offsets[1] - offsets[0])))
    inner = float(ndtr(gap / (2 * noise)))
    return (2 * inner + (size - 2) * (2 * inner - 1)) / size


def attacked(task: Task) -> tuple[Attacked, Keys]:
    """Simulate a task's runs."""
    scenario, law = loop_of(task.scenario, task.candidates, task.disturbance)
    number = int(task.id, 16)
    start = None
    if task.key == "nearest-centre":
        keys, start = read_keys(scenario, law, task.runs, task.onset + task.steps)
    elif task.key == "nobody":
        keys = Keys(np.zeros(task.runs, bool))
    else:
        draw = np.random.default_rng([SEED, number, 9])
        keys = Keys(distilled(task.key, task.runs, draw))
    found = attack_runs(
        scenario,
        law,
        maker(task.attack, scenario),
        task.defences,
        keys,
        seed=[SEED, number],
        steps=task.steps,
        onset=task.onset,
        watermark=packed_deviation(scenario) if task.gaussian else 0.0,
        eye=task.eye,
        start=start,
    )
    return found, keys


def maker(attack: str, scenario: Scenario) -> Callable[[np.random.Generator], Attack] | None:
    """Makes the attack of this name of :data:`ATTACKERS`; None for ``none``."""
    if attack == "none":
        return None
    kind, options = ATTACKERS[attack]
    found, model = named(kind), LoopModel.of(scenario)
    return lambda draw: found(model, options, draw)


def packed_deviation(scenario: Scenario) -> float:
    """Standard deviation of the scenario's alphabet; one input."""
    offsets = cached_design(scenario).offsets
    assert offsets is not None
    return float(offsets.std())


@study("attacks", COLUMNS, tasks)
def measure(task: Task) -> Iterator[dict[str, object]]:
    """One row."""
    found, keys = attacked(task)
    scenario, _ = loop_of(task.scenario, task.candidates, task.disturbance)
    passed = theory(task, scenario)
    bits = sum(KEY_BITS[name](task.candidates) for name in task.defences)
    honest = task.runs * (task.onset - 1 + (task.steps if task.attack == "none" else 0))
    unseen = [] if task.attack == "none" else found.undetected().tolist()
    yield {
        "group": task.group,
        "attack": task.attack if not task.eye else f"{task.attack}, eye {task.eye:g}",
        "defence": task.defence,
        "key": task.key if not task.disturbance else task.disturbance,
        "scenario": task.scenario,
        "M": task.candidates,
        "runs": task.runs,
        "onset": task.onset,
        "steps": task.steps,
        "seed": SEED,
        "held": int(keys.held.sum()),
        "unseen": " ".join(map(str, unseen)),
        "false_alarms": found.false_alarms,
        "honest_steps": honest,
        "away": f"{found.away.mean():.4f}",
        "away_error": f"{found.away.std(ddof=1) / len(found.away) ** 0.5:.4f}",
        "away_largest": f"{found.away.max():.4f}",
        "shown_largest": f"{found.shown.max():.4f}",
        "theory": "" if passed is None else f"{passed:.6f}",
        "key_bits": f"{bits:g}",
    }
