"""What nobody may see is nowhere that anybody looks: process lists, manifests, logs, the tap."""

import base64
import json
import os
import pty
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

from protocol.secret.key_digits import KEY_BYTES
from runtime.journal import ControllerJournal, PlantJournal
from runtime.run_folder import (
    CONTROLLER_JOURNAL,
    CONTROLLER_TRACE,
    MANIFEST,
    PLANT_JOURNAL,
    PLANT_TRACE,
    SCENARIO,
)
from runtime.scenario_file import load_scenario
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.programs import python, started
from tests.support.scenarios import text_of
from tests.support.traces import events_of
from tests.system.test_integration import status

SECRET = "q9"


def read_from_stdin(message: str, given: bytes) -> bytes | None:
    program = (
        "import sys; from runtime.options import message_of;"
        "sys.stdout.buffer.write(message_of(sys.argv[1]))"
    )
    done = python("-c", program, message, input=given, text=False)
    return None if done.returncode else done.stdout


@pytest.mark.slow
def test_a_message_can_be_read_from_standard_input() -> None:
    """``echo hi | wyner send -`` sends two bytes."""
    assert read_from_stdin("-", b"h\xffi\n") == b"h\xffi"
    assert read_from_stdin("-", b"\nhi\n\n") == b"\nhi\n"
    assert read_from_stdin("-", b"") is None
    assert read_from_stdin("-", b"\n") is None
    assert read_from_stdin("-", bytes(65_535) + b"\n") == bytes(65_535)
    assert read_from_stdin("-", bytes(65_536)) is None


def test_what_is_typed_ends_without_its_last_enter() -> None:
    leader, follower = pty.openpty()
    try:
        program = "from runtime.options import message_of; print(repr(message_of('-')))"
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with started("-c", program, stdin=follower, **pipes) as child:
            os.write(leader, b"at nine\n\x04")
            out, said = child.communicate(timeout=PATIENCE_S)
    finally:
        os.close(leader)
        os.close(follower)
    assert out == "b'at nine'\n"
    assert said == "type the message; Enter, then Ctrl-D end it\n"


class Seen:
    """What anybody on the machine could look at while a run goes on."""

    def __init__(self, run: Path) -> None:
        self.run = run
        self.pieces: dict[str, bytes] = {}

    def look(self) -> None:
        """Command lines and environments of the run's processes; statuses and health as of now."""
        for entry in Path("/proc").iterdir():
            try:
                line = (entry / "cmdline").read_bytes() if entry.name.isdigit() else b""
                if str(self.run).encode() in line:
                    self.pieces[f"command line of {entry.name}"] = line
                    self.pieces[f"environment of {entry.name}"] = (entry / "environ").read_bytes()
            except OSError:
                continue
        for path in self.run.glob("*/status.json"):
            name = f"{path.relative_to(self.run)} at {len(self.pieces)}"
            self.pieces[name] = path.read_bytes()

    def look_back(self) -> None:
        """What is left of it when it is over; traces, journals and summary are its own."""
        own = (CONTROLLER_TRACE.name, CONTROLLER_JOURNAL.name, "message", "summary.json")
        for path in self.run.rglob("*"):
            if path.is_file() and (path.parent.name == "tap" or not path.name.startswith(own)):
                self.pieces[str(path.relative_to(self.run))] = path.read_bytes()


def forms(value: bytes) -> set[bytes]:
    """A value as it could stand in a text."""
    return {value, base64.b64encode(value), value.hex().encode(), value.hex().upper().encode()}


def in_a_row(symbols: list[int]) -> set[bytes]:
    """Any forty symbols in a row, as a list or as digits."""
    found = set()
    for start in range(0, len(symbols) - 40, 20):
        digits = [str(symbol) for symbol in symbols[start : start + 40]]
        found |= {s.join(digits).encode() for s in ("", ",", ", ", " ")}
    return found


def secrets_of(run: Path) -> dict[str, set[bytes]]:
    """Every secret value of a run, by kind, from where it is kept."""
    keys: set[bytes] = set()
    contributions: set[bytes] = set()
    digits: set[bytes] = set()
    fingerprint = load_scenario(run / SCENARIO).fingerprint()
    for kind, path in ((ControllerJournal, CONTROLLER_JOURNAL), (PlantJournal, PLANT_JOURNAL)):
        with kind(run / path, fingerprint) as journal:
            part, blocks = journal.load().held
            digits |= {part.digits, *in_a_row(list(part.digits))}
            for _, _, block in blocks:
                keys |= {block[at : at + KEY_BYTES] for at in range(0, len(block), KEY_BYTES)}
    for line in (run / "tap/capture.jsonl").read_bytes().splitlines():
        message = json.loads(line).get("message") or {}
        contributions |= {message["nonce"].encode()} if message.get("nonce") else set()
    transitions = list(events_of(run / PLANT_TRACE, "transition"))
    return {
        "plaintext": forms(TEXT.encode()),
        "keys": {form for key in keys for form in forms(key)},
        "digits of the key stream": digits,
        "nonces": contributions,
        "coins": in_a_row([t["coin"] for t in transitions]),
        "key symbols": in_a_row([t["symbol"] for t in transitions if t["symbol"] >= 0]),
    }


TEXT = f"{SECRET}-{os.getpid()}-nobody-may-see-this"


@pytest.mark.long
def test_no_secret_value_is_where_anybody_looks(tmp_path: Path) -> None:
    """The only eavesdropper reads no message: what another one has read stands in her beliefs."""
    run, file, scenario = tmp_path / "run", tmp_path / "message", tmp_path / "keys.toml"
    file.write_text(TEXT)
    blind = ("[tap]\n", '[tap]\neavesdroppers = ["set-membership"]\n')
    scenario.write_text(text_of("keys", blind))
    arguments = ["--scenario", str(scenario), "--message", f"@{file}"]
    arguments += ["--pace", "fast", "--run-dir", str(run)]
    seen = Seen(run)

    def keys_made() -> int:
        if (run / MANIFEST).exists():
            seen.look()
        time.sleep(0.1)
        its = [status(run, end).get("keys", {}) for end in ("controller", "plant")]
        return min(int(keys.get("made", 0)) for keys in its)

    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with started("-m", "wyner", "up", *arguments, **quiet) as process:
        wait_for(lambda: keys_made() > 10)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130
    live = set(seen.pieces)
    seen.look_back()
    secrets = secrets_of(run)
    assert all(secrets.values())
    assert len(secrets["keys"]) > 20
    assert {"manifest.json", "tap/capture.jsonl", "plant/log", "plant/status.json"} <= set(
        seen.pieces
    )
    assert len([name for name in live if name.startswith("environment")]) >= 4
    for kind, values in secrets.items():
        pattern = re.compile(b"|".join(map(re.escape, values)))
        for name, content in seen.pieces.items():
            if kind == "nonces" and name.startswith("tap/capture"):
                continue  # they are public: she may miss them, and not what she heard
            assert not pattern.search(content), (kind, name)
    modes = {path.stat().st_mode & 0o077 for path in (run, *run.rglob("*"))}
    assert modes == {0}
