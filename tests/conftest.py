"""Fixtures that many tests share."""

import gc
import importlib
import os
import shutil
import signal
import sys
import tempfile
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import settings

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import make_law
from controller_service.sets.design import synthesise
from protocol.scenario import Scenario
from runtime.scenario_file import scenario_of
from tests.support.size import WHOLE

# A busy machine is no failure: examples have no time limit, a test has pytest's.
settings.register_profile("wyner", deadline=None, print_blob=True)
settings.load_profile("wyner")

# Whoever starts the tests in the background may have these ignored, and so would every process
# that a test starts: it could not be interrupted.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Where the environment forbids it, each process would compile the project and rewrite the asserts.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

MEMORY_DISK = Path("/dev/shm")
"""Where the tests' files are, if there is room: on a disk each step of a live loop waits for it."""

ROOM = 4 << 30
"""Bytes that must be free there."""


def pytest_configure() -> None:
    """Put temporary files of the tests, and of what they start, into memory; TMPDIR overrules."""
    if "TMPDIR" in os.environ or not os.access(MEMORY_DISK, os.W_OK):
        return
    if shutil.disk_usage(MEMORY_DISK).free >= ROOM:
        os.environ["TMPDIR"] = str(MEMORY_DISK)
        tempfile.tempdir = None  # asks for it anew


def pytest_xdist_auto_num_workers() -> int:
    """One more than there are cores: tests of live loops wait for most of their time."""
    return (os.cpu_count() or 1) + 1


def pytest_collection(session: pytest.Session) -> None:
    """Import a share of the files first: what one process has compiled, the others read."""
    worker = getattr(session.config, "workerinput", None)
    if worker is None:
        return
    files = sorted(file for path in session.config.args for file in Path(path).rglob("test_*.py"))
    first = int(worker["workerid"].removeprefix("gw"))
    for file in files[first :: worker["workercount"]]:
        with suppress(Exception, pytest.skip.Exception):  # told when the file is collected
            importlib.import_module(".".join(file.with_suffix("").parts))


def pytest_collection_finish() -> None:
    """What is loaded stays: it is not searched for garbage again and again."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What is long is slow. Sort where several processes share the files; the others keep order."""
    for item in items:
        if item.get_closest_marker("long"):
            item.add_marker("slow")
        if WHOLE and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(1800))
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    # At the end no process then waits for another one's file of tests that take long.
    first = ("long", "integration")
    heavy = Counter(item.path for item in items if any(map(item.get_closest_marker, first)))
    items.sort(key=lambda item: -heavy[item.path])


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
