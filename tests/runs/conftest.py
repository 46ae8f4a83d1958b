"""What the tests of runs share."""

from collections.abc import Iterator
from functools import cache

import pytest

from controller_service.laws import registry


@pytest.fixture(scope="package", autouse=True)
def _one_law() -> Iterator[None]:
    """A scenario's law is made once meanwhile: that takes longer than a small run's check."""
    make, design = registry.make_law, registry.cached_design
    designs = cache(design)
    laws = cache(lambda scenario: make(scenario, designs(scenario)))
    with pytest.MonkeyPatch().context() as patch:
        patch.setattr(registry, "cached_design", designs)
        patch.setattr(registry, "make_law", lambda scenario, _design: laws(scenario))
        yield
