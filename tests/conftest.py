"""Fixtures that many tests share."""

import os
import signal

import pytest
from hypothesis import settings

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import make_law
from controller_service.sets.design import synthesise
from protocol.scenario import Scenario
from runtime.scenario_file import scenario_of

# A busy machine is no failure: examples have no time limit, a test has pytest's.
settings.register_profile("wyner", deadline=None, print_blob=True)
settings.load_profile("wyner")

# Whoever starts the tests in the background may have these ignored, and so would every process
# that a test starts: it could not be interrupted.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session", autouse=True)
def own_runtime_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Runs on this machine that are no test's are not joined by a test, nor the other way round."""
    os.environ["XDG_RUNTIME_DIR"] = str(tmp_path_factory.mktemp("runtime"))


@pytest.fixture(scope="session")
def sustained() -> Scenario:
    return scenario_of("sustained")


@pytest.fixture(scope="session")
def sustained_law(sustained: Scenario) -> CandidateLaw:
    return make_law(sustained, synthesise(sustained))
