"""A journal copied while its service is paused: whole, and safe to go back to."""

import sqlite3
import subprocess
from pathlib import Path

from tests.compose.composition import RUN, Composition, all_healthy, arrives, wait_for

SERVICES = ("controller", "plant", "tap")


def test_a_restored_backup_ends_the_session_and_uses_no_key_again(
    direct: Composition, tmp_path: Path
) -> None:
    """As docs/deployment.md says: pause, copy, unpause; later stop, put back, start."""
    all_healthy(direct, SERVICES)
    arrives(direct, "plant", "at noon")
    direct.compose("pause", "controller")
    try:
        direct.compose("cp", f"controller:{RUN}/controller", str(tmp_path / "backup"))
    finally:
        direct.compose("unpause", "controller")
    before = direct.status("plant", "plant")

    # Life goes on, so that the backup grows old.
    direct.send("after the backup")
    arrives(direct, "plant", "after the backup")

    direct.compose("stop", "controller")
    for path in (tmp_path, tmp_path.parent, tmp_path.parent.parent):
        path.chmod(0o711)  # pytest's own folders are its user's alone
    subprocess.run(["chown", "-R", "10001", str(tmp_path / "backup")], check=True)
    direct.compose(
        "run", "--rm", "--no-deps", "--volume", f"{tmp_path / 'backup'}:/backup:ro",
        "--entrypoint", "sh", "controller", "-c",
        f"rm -f {RUN}/controller/journal.sqlite3*"
        f" && cp /backup/journal.sqlite3* {RUN}/controller/",
    )  # fmt: skip
    direct.compose("start", "controller")

    wait_for(
        lambda: direct.status("plant", "plant")["sessions"] == before["sessions"] + 1,
        "a new session, for the journals do not fit together",
    )
    direct.send("after the restore")
    arrives(direct, "plant", "after the restore")
    assert direct.status("plant", "plant")["session"] != before["session"]


def test_a_copy_made_while_paused_is_a_whole_database(direct: Composition, tmp_path: Path) -> None:
    all_healthy(direct, SERVICES)
    for service in ("controller", "plant"):
        direct.compose("pause", service)
        try:
            direct.compose("cp", f"{service}:{RUN}/{service}", str(tmp_path / service))
        finally:
            direct.compose("unpause", service)
        with sqlite3.connect(tmp_path / service / "journal.sqlite3") as journal:
            assert journal.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert journal.execute("SELECT count(*) FROM record").fetchall() == [(1,)]
        journal.close()
