"""What the tests of checks share: a law that is designed once, and a run that makes keys."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest

from controller_service.laws import registry
from wyner.cli.demo import SealedMessage
from wyner.cli.up import run_session
from wyner.deployment.one_machine import RunOptions


@contextmanager
def one_law() -> Iterator[None]:
    """The design's law is made once meanwhile: it takes longer than a small run's check."""
    patch = pytest.MonkeyPatch()
    make, design = registry.make_law, registry.cached_design
    designs = cache(design)
    laws = cache(lambda scenario: make(scenario, designs(scenario)))
    patch.setattr(registry, "cached_design", designs)
    patch.setattr(registry, "make_law", lambda scenario, _design: laws(scenario))
    try:
        yield
    finally:
        patch.undo()


def run_with_keys(folder: Path, text: bytes, eavesdroppers: str) -> None:
    """All three services with signed keys, until a sealed ``text`` is delivered."""
    options = RunOptions(
        scenario="keys",
        message="hi",
        pace="fast",
        steps=100_000,
        until_delivered=True,
        eavesdropper=eavesdroppers,
        headless=True,
        json=True,
        run_dir=str(folder),
        secret=True,
    )
    outcome = run_session(options, lambda ops: SealedMessage(ops, text), stays=False)
    assert outcome.failure is None
