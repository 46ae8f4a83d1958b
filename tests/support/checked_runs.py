"""What the tests of checks share: a run that makes keys."""

import fcntl
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final
from uuid import uuid4

import pytest

from tests.support.scenarios import text_of
from wyner.cli.session import run_session
from wyner.deployment.one_machine import RunOptions
from wyner.runs.check import RuleResult, check, judge
from wyner.runs.check.evidence import read_evidence

STEPS: Final = 400
"""Three blocks begin within them."""

EAVESDROPPERS: Final = ["nearest-centre", "text", "key-solver"]
"""One that guesses at once, one that thinks, and the one that solves for keys."""


def failed(folder: Path) -> set[str]:
    """Names of the rules that a run does not obey."""
    return {finding.rule for finding in check(read_evidence(folder))}


def results_of(folder: Path) -> dict[str, RuleResult]:
    """How a run did by each rule."""
    return {result.rule.name: result for result in judge(read_evidence(folder))}


def keyed_run(factory: pytest.TempPathFactory) -> Path:
    """A run of all three services with keys, made once in a session of tests.

    It has steps for some blocks, so that one is confirmed at both ends.
    """
    return made_once(factory, "keys", _run_with_keys)


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that the first test process to ask for it makes, and all others share."""
    shared = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    folder = shared / name
    with (shared / f"{name}.lock").open("w") as lock:
        fcntl.lockf(lock, fcntl.LOCK_EX)
        if not folder.is_dir():
            making = shared / f"{name}-making-{uuid4().hex}"
            make(making)
            making.rename(folder)
    return folder


def _run_with_keys(folder: Path) -> None:
    """On a machine that is busy no block is extracted in eight seconds; then it gets forty."""
    scenario = folder.with_suffix(".toml")
    listen = ("[tap]\n", f"[tap]\neavesdroppers = {EAVESDROPPERS}\n")
    scenario.write_text(text_of("keys", listen))
    for pace in ("x5", "realtime"):
        shutil.rmtree(folder, ignore_errors=True)
        options = RunOptions(
            scenario=str(scenario),
            message="hi",
            pace=pace,
            steps=STEPS,
            json=True,
            run_dir=str(folder),
        )
        outcome = run_session(options, stays=False)
        assert outcome.failure is None
        if outcome.figures["keys"]["made"]:
            return
