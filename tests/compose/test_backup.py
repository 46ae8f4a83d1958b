"""A journal copied while its service is paused: whole, and safe to go back to."""

import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.compose.composition import PACE, RUN, Composition, all_healthy, arrives, wait_for
from tests.compose.conftest import running

SERVICES = ("controller", "plant", "tap")


@pytest.fixture(scope="module")
def system(image: str) -> Iterator[Composition]:
    variables = {"WYNER_MESSAGE": "at noon", "WYNER_PACE": PACE}
    yield from running("wyner-test-backup", "direct", **variables)


def test_a_restored_backup_ends_the_session_and_uses_no_key_again(
    system: Composition, tmp_path: Path
) -> None:
    """As docs/deployment.md says: pause, copy, unpause; later stop, put back, start."""
    all_healthy(system, SERVICES)
    arrives(system, "plant", "at noon")
    system.compose("pause", "controller")
    try:
        system.compose("cp", f"controller:{RUN}/controller", str(tmp_path / "backup"))
    finally:
        system.compose("unpause", "controller")
    before = system.status("plant", "plant")

    # Life goes on, so that the backup grows old.
    system.send("grown old")
    arrives(system, "plant", "grown old")

    system.compose("stop", "controller")
    for path in (tmp_path, tmp_path.parent, tmp_path.parent.parent):
        path.chmod(0o711)  # pytest's own folders are its user's alone
    subprocess.run(["chown", "-R", "10001", str(tmp_path / "backup")], check=True)
    system.compose(
        "run", "--rm", "--no-deps", "--volume", f"{tmp_path / 'backup'}:/backup:ro",
        "--entrypoint", "sh", "controller", "-c",
        f"rm -f {RUN}/controller/journal.sqlite3*"
        f" && cp /backup/journal.sqlite3* {RUN}/controller/",
    )  # fmt: skip
    system.compose("start", "controller")

    wait_for(
        lambda: system.status("plant", "plant")["sessions"] == before["sessions"] + 1,
        "a new session, for the journals do not fit together",
    )
    system.send("restored")
    arrives(system, "plant", "restored")
    assert system.status("plant", "plant")["session"] != before["session"]


def test_a_copy_made_while_paused_is_a_whole_database(system: Composition, tmp_path: Path) -> None:
    all_healthy(system, SERVICES)
    for service in ("controller", "plant"):
        system.compose("pause", service)
        try:
            system.compose("cp", f"{service}:{RUN}/{service}", str(tmp_path / service))
        finally:
            system.compose("unpause", service)
        with closing(sqlite3.connect(tmp_path / service / "journal.sqlite3")) as journal, journal:
            assert journal.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert journal.execute("SELECT count(*) FROM step").fetchall() == [(1,)]
        journal.close()
