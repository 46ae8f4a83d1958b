"""What nobody may see is nowhere that anybody looks: process lists, manifests, logs, the tap."""

import base64
import os
import subprocess
import sys
from pathlib import Path

import pytest

from protocol.runtime.private_arguments import without_message
from protocol.runtime.run_folder import CONTROLLER_TRACE, MANIFEST, PLANT_TRACE
from protocol.runtime.trace import read_trace

SECRET = "q9"


def command_lines() -> list[bytes]:
    """Of every process that can be seen."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                found.append((entry / "cmdline").read_bytes())
            except OSError:
                continue
    return found


@pytest.mark.parametrize(
    ("arguments", "kept", "text"),
    [
        (["up", "--message", "hi"], ["up", "--message-file", "F"], "hi"),
        (["up", "--message=a=b", "--json"], ["up", "--message-file", "F", "--json"], "a=b"),
        (["up", "--message"], ["up", "--message"], None),
        (["up", "--message-file", "x"], ["up", "--message-file", "x"], None),
    ],
)
def test_a_message_is_taken_off_the_arguments(
    arguments: list[str], kept: list[str], text: str | None
) -> None:
    assert without_message(arguments, "F") == (kept, text)


@pytest.mark.slow
def test_a_runs_secrets_are_in_its_traces_and_journals_alone(tmp_path: Path) -> None:
    run = tmp_path / "run"
    message = f"{SECRET}-{os.getpid()}-nobody-may-see-this"
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "wyner", "up", "--message", message, "--pace", "fast"),
            *("--headless", "--steps", "250", "--run-dir", str(run)),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    seen: list[bytes] = []
    try:
        while process.poll() is None:
            if (run / MANIFEST).exists():
                seen += [line for line in command_lines() if str(run).encode() in line]
    finally:
        process.kill()
        process.wait()
    assert any(b"plant_service" in line for line in seen)
    plain = message.encode()
    secrets = {plain, base64.b64encode(plain)}
    assert not [line for line in seen if any(s in line for s in secrets)]
    files = [run / MANIFEST, *run.rglob("log"), *(run / "tap").iterdir()]
    assert len(files) > 6
    for path in files:
        content = path.read_bytes()
        assert not [s for s in secrets if s in content], path
    for trace in (PLANT_TRACE, CONTROLLER_TRACE):
        assert len(list(read_trace(run / trace).of("transition"))) >= 249
    names = {b'"coin"', b'"key"', b'"message_symbol"', b'"plaintext"'}
    for path in (run / "tap").glob("capture*"):
        assert not [n for n in names if n in path.read_bytes()]
    modes = {path.stat().st_mode & 0o077 for path in (run, *run.rglob("*"))}
    assert modes == {0}
