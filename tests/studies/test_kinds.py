"""The study of kinds of messages, as recorded: what is stated of each comes true."""

from collections.abc import Sequence

import pytest

from studies.registry import Row, recorded
from studies.secrecy.kinds import KEPT_BACK, MESSAGES, messages
from studies.secrecy.tables import tails
from tap_service.inference.expectation import expected

TAIL = 0.025
"""Of an exact test, shared by the tests of all kinds on both sides."""


@pytest.fixture(scope="module")
def rows() -> Sequence[Row]:
    return recorded("secrecy-kinds")


def test_there_are_twelve_kinds_of_which_two_were_kept_back() -> None:
    kinds = [message.kind for message in messages()]
    assert len(set(kinds)) == 12
    assert all(kinds.count(kind) == MESSAGES for kind in kinds)
    assert set(KEPT_BACK) <= set(kinds)
    assert not set(KEPT_BACK) & {kind.name for kind in expected().kinds}


def test_what_is_stated_of_each_kind_comes_true_as_often_as_it_is_stated(
    rows: Sequence[Row],
) -> None:
    kinds = {row["kind"] for row in rows}
    assert len(kinds) == 12
    for kind in kinds:
        mine = [row for row in rows if row["kind"] == kind]
        right = sum(int(row["likeliest_exact"]) for row in mine)
        assert min(tails([float(row["probability"]) for row in mine], right)) > TAIL / 12


def test_capitals_are_read_as_often_as_the_same_sentences(rows: Sequence[Row]) -> None:
    """Version 1.0.0 read none of them. The seeds and the losses are the same."""
    right = {(row["kind"], row["seed"]): int(row["likeliest_exact"]) for row in rows}
    seeds = [seed for kind, seed in right if kind == "capitals" and ("sentences", seed) in right]
    capitals, sentences = (
        sum(right[kind, seed] for seed in seeds) for kind in ("capitals", "sentences")
    )
    assert capitals >= sentences - 1 - len(seeds) // 10
