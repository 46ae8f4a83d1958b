"""A short form of the folders that are put back, and a wrong end that it catches."""

import logging

import pytest

from protocol.secret.stream import NOTHING_HELD, NOWHERE, Held, KeyStream, Position
from tests.campaigns.restored import restored
from tests.support.size import size


@pytest.mark.long
def test_no_digit_is_named_for_two_steps_whoever_is_put_back() -> None:
    loop = restored(size(12, 40), seed=2)
    assert loop.doubled == []
    assert min(loop.counts[f"{side} put back"] for side in ("plant", "controller")) > 2
    assert loop.counts["with digits"] > 200
    assert loop.counts["sessions ended"] > 4


@pytest.mark.long
def test_a_controller_that_forgets_which_digits_it_has_named_is_caught(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    begin = KeyStream.__init__

    def forgetful(
        self: KeyStream, size: int, held: Held = NOTHING_HELD, _: Position = NOWHERE
    ) -> None:
        begin(self, size, held)

    monkeypatch.setattr(KeyStream, "__init__", forgetful)
    assert restored(20, seed=2).doubled
