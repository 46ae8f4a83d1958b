"""``wyner up``: when a run is over."""

from types import SimpleNamespace
from typing import Any

import pytest

from wyner.cli import up


def progress(returned: int | None) -> tuple[Any, SimpleNamespace]:
    plant = SimpleNamespace(returned=returned)
    supervisor: Any = SimpleNamespace(poll=lambda: None, child=lambda _name: plant)
    return up._Progress(until_delivered=True, supervisor=supervisor), plant


def test_a_run_is_over_with_its_plant_whatever_was_still_to_be_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`wyner demo` waited for ever for a sealed message that nobody was left to take."""
    monkeypatch.setattr(up, "GRACE_S", 0.0)
    watching, plant = progress(None)
    asked: list[bool] = []

    def errand() -> bool:
        asked.append(True)
        return False

    watching.errand = errand
    assert not watching.over()
    plant.returned = 0
    assert watching.over()
    assert len(asked) == 2


def test_a_run_goes_on_until_its_errand_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(up, "GRACE_S", 0.0)
    watching, _plant = progress(None)
    watching._delivered = watching._received = 1
    watching._waiting = False
    watching.errand = lambda: False
    assert not watching.over()
    watching.errand = lambda: True
    assert watching.over()
