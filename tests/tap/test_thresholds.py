"""The threshold that all steps have in common: what silence tells of it, and reading under each."""

import random
from itertools import pairwise

import numpy as np
import pytest

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.schemes.base import encrypt
from protocol.schemes.framing import encode_frame
from protocol.schemes.registry import make_scheme
from protocol.schemes.table import StateTable
from tap_service.capture.transcript import Transition
from tap_service.inference.expectation import expected
from tap_service.inference.message_reader import MessageReader
from tap_service.inference.verdicts import MOST, InferredStep, Run, likely_thresholds

TRUE = 0.2
"""The threshold by which both ends agree."""

AMONG = (0.15, 0.6)
"""Those that she takes for possible."""


def carried(payload: bytes, seed: int, silence: int = 12) -> list[InferredStep]:
    """A message of bits between silence; the candidate not applied has any gauge up to 0.6."""
    rng = random.Random(seed)
    machine = make_scheme("switched", 2)
    state, sent = machine.initial, 0
    steps: list[InferredStep] = []
    stream = [0] * silence + list(encode_frame(payload, 2)) + [0] * silence
    while sent < len(stream):
        pad, cipher = machine.pad(state), rng.randrange(2)
        if pad != NO_SYMBOL:
            cipher = encrypt(stream[sent], pad, 2)
            sent += 1
        key, other = rng.randrange(2), rng.uniform(0.0, 0.6)
        gauges = np.full(2, other)
        gauges[key] = rng.uniform(0.0, min(0.15, other))
        state, _ = machine.advance(state, key if other > TRUE else NO_SYMBOL)
        t = Transition("s", len(steps), (0.0,), None, cipher, (0.0,), start=not steps)
        steps.append(InferredStep(t, gauges[None]))
    return steps


def closed() -> tuple[StateTable, Array]:
    """The scheme's table, and the initial state's probability."""
    table = StateTable(make_scheme("switched", 2))
    return table, np.eye(len(table.all_following()))[0]


def made(steps: list[InferredStep], entry: Array) -> Run:
    """Steps that were all made."""
    return Run(steps, entry, np.ones(len(steps)))


def room(intervals: list[tuple[float, float, float]]) -> float:
    return sum(high - low for low, high, _ in intervals)


@pytest.mark.parametrize("seed", range(4))
def test_silence_leaves_the_true_threshold_and_few_others(seed: int) -> None:
    table, entry = closed()
    steps = carried(b"Go", seed, silence=40)
    found = likely_thresholds(table, [made(steps, entry)], AMONG)
    assert 1 <= len(found) <= MOST
    assert any(low <= TRUE <= high for low, high, _ in found)
    assert room(found) < 0.1 * (AMONG[1] - AMONG[0])
    assert all(a[1] <= b[0] for a, b in pairwise(found))


def test_a_step_that_may_not_have_been_made_hides_the_threshold_no_more_than_it_must() -> None:
    """Each eighth is none, and carries another one's ciphertext: taken for made, all look alike."""
    table, entry = closed()
    steps, unsure = list[InferredStep](), list[float]()
    for k, step in enumerate(carried(b"Go", 2, silence=40)):
        if k % 8 == 4:
            steps.append(InferredStep(step.transition, None))
            unsure.append(0.1)
        steps.append(step)
        unsure.append(1.0)
    found = likely_thresholds(table, [Run(steps, entry, np.array(unsure))], AMONG)
    assert any(low <= TRUE <= high for low, high, _ in found)
    assert room(found) < 0.5 * room(likely_thresholds(table, [made(steps, entry)], AMONG))


def test_what_all_runs_say_of_the_threshold_counts_together() -> None:
    table, entry = closed()
    runs = [made(carried(b"Go", seed), entry) for seed in (5, 6)]
    alone = [room(likely_thresholds(table, [run], AMONG)) for run in runs]
    assert room(likely_thresholds(table, runs, AMONG)) < min(alone)


def test_thresholds_that_make_no_difference_are_one() -> None:
    """No gauge lies among them, or they hardly differ, where the law tells the threshold."""
    table, entry = closed()
    steps = [
        InferredStep(s.transition, np.where(s.samples == s.samples.max(), 0.9, 0.1))
        for s in carried(b"Go", 1)
        if s.samples is not None
    ]
    assert len(likely_thresholds(table, [made(steps, entry)], AMONG)) == 1
    near = (0.195, 0.205)
    assert likely_thresholds(table, [made(carried(b"Go", 1), entry)], near) == [(*near, 1.0)]


def test_nothing_is_known_of_the_threshold_where_no_ciphertext_is_heard() -> None:
    table, entry = closed()
    deaf = [
        InferredStep(Transition("s", k, (0.0,), None, None, (0.0,), start=k == 0), s.samples)
        for k, s in enumerate(carried(b"Go", 1))
    ]
    found = likely_thresholds(table, [made(deaf, entry)], AMONG)
    assert room(found) == pytest.approx(AMONG[1] - AMONG[0])


@pytest.mark.parametrize("seed", [1, 2])
def test_a_message_is_read_by_the_threshold_that_all_its_steps_have_in_common(seed: int) -> None:
    """A third of the steps would agree or not by a threshold of their own: no beam follows that."""
    payload = b"Sail"
    steps = carried(payload, seed)
    reader = MessageReader(make_scheme("switched", 2), expected(), certain=False, beam=100)
    (message,) = reader.read(steps, AMONG, {})
    assert (message.payload, message.whole) == (payload, True)
    assert message.probability > 0.99
    assert message.bits_left < 0.1
