"""Beginnings that go on alike are taken together, the impossible ones among them."""

import tracemalloc

import numpy as np
import pytest

from protocol.schemes.base import encrypt
from protocol.schemes.framing import encode_frame
from protocol.schemes.registry import make_scheme
from protocol.schemes.table import StateTable
from tap_service.inference.lattice import Lattice
from tap_service.inference.message_beam import Beam
from tap_service.inference.message_graph import Graph
from tap_service.inference.message_search import MessageSearch
from tests.support.any_bytes import any_bytes


def test_a_beginning_that_nothing_heard_allows_leaves_the_others_finite() -> None:
    beam = Beam(3, 2, 8, np.uint64, any_bytes().start(3))
    beam.length[:] = (1, 1, 2)  # the first two go on alike, the third by itself
    beam.alpha[:2] = ((0.5, 1.0), (1.0, 0.25))
    beam.alpha[2] = 0.0
    graph = Graph()
    graph.begin(beam)
    graph.merge(beam)
    assert beam.length.tolist() == [1, 2]
    assert np.isfinite(beam.alpha).all()
    assert np.isfinite(beam.level).all()
    assert beam.alpha[0].max() == 1.0
    assert beam.alpha[1].max() == 0.0


def test_drawing_holds_little_more_than_what_it_gives() -> None:
    """The last thoughts of a long run held three numbers of 8 bytes for each place of each draw."""
    places, count = 60, 30_000
    graph = Graph()
    beam = Beam(2, 2, places + 1, np.uint64, any_bytes().start(2))
    graph.begin(beam)
    for place in range(places):
        beam.text[:, place] = np.arange(len(beam.level))
        beam.count[:] = place + 1
        graph.merge(beam)
    tracemalloc.start()
    drawn = graph.draw(np.arange(1), np.zeros(1), np.random.default_rng(0), count)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert drawn.scores.shape == drawn.nodes.shape == (count, places + 1)
    assert peak < 1.2 * (8 + 4 + 1) * count * places


@pytest.mark.parametrize("steps", [13, 14, 15, 16, 20, 29, 30])
def test_a_message_whose_check_was_not_sent_yet_is_searched_for(steps: int) -> None:
    """Its 16 symbols may be more than all steps so far."""
    size, frame = 4, encode_frame(b"a", 4)
    rng = np.random.default_rng(steps)
    keys = rng.integers(0, size, steps)
    verdicts = np.full((steps, size + 1), 0.01)
    verdicts[np.arange(steps), keys + 1] = 1.0
    verdicts /= verdicts.sum(axis=1, keepdims=True)
    symbols = [frame[i] if i < len(frame) else 0 for i in range(steps)]
    ciphers = [encrypt(symbols[k - 1], int(keys[k - 1]), size) for k in range(steps)]
    states = size + 1
    entry = np.eye(states)[0]
    spread = np.repeat(verdicts[:, None], states, axis=1)
    table = StateTable(make_scheme("pipelined", size))
    lattice = Lattice(table, spread, np.array(ciphers), entry, np.ones(len(ciphers)))
    begin = np.full((steps + 1, states), -np.inf)
    begin[0, 0] = 0.0
    found = MessageSearch(lattice, any_bytes(), 32).find(begin)
    assert found is not None
    assert {len(text) for text in found.payloads} <= {1}
    assert np.isfinite(max(found.plain, found.open))
