"""Beginnings that go on alike are taken together, the impossible ones among them."""

import numpy as np

from tap_service.inference.message_beam import Beam
from tap_service.inference.message_graph import Graph


def test_a_beginning_that_nothing_heard_allows_leaves_the_others_finite() -> None:
    beam = Beam(3, 2, 8, np.uint64)
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
