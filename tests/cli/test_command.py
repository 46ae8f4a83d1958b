"""The command: help everywhere, errors in one line, exit codes, never a traceback."""

import json
import os
import re
import signal
import socket
import termios
from pathlib import Path

import pytest

from runtime.addresses import free_endpoints
from runtime.errors import UsageError
from runtime.scenario_file import keep_scenario
from runtime.services import BUSES, SERVICES
from tests.support.patience import wait_for
from tests.support.programs import ROOT, python, wyner
from tests.support.screens import Terminal
from wyner.cli.main import commands, main, overview

PRESENT = list(commands())


def usage_error(capsys: pytest.CaptureFixture[str], *argv: str) -> list[str]:
    """The lines that a wrong use prints; nothing goes to standard output."""
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert lines
    assert all(line.startswith("wyner: ") for line in lines), err
    assert "Traceback" not in err
    return lines


@pytest.mark.parametrize("name", sorted(PRESENT))
def test_every_command_has_help(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says what the command does, in 80 columns, and shows no markup."""
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    usage, about, *_ = out.split("\n\n")
    assert f"wyner {name}" in usage
    assert about[0].isupper()
    assert about.endswith(".")
    assert max(map(len, out.splitlines())) <= 80
    assert not re.search("%%|``", out)


def test_the_help_lists_every_command_that_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    for name in PRESENT:
        assert re.search(rf"^.{{7}}[\w, ]*\b{name}\b", out, re.MULTILINE)
    lines = out.splitlines()
    assert len(lines) < 24
    assert max(map(len, lines)) <= 80


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert re.fullmatch(r"wyner \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


# --- wrong use ------------------------------------------------------------------------------------


def test_without_a_command_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    out, err = capsys.readouterr()
    assert (out, err) == ("", overview())


@pytest.mark.parametrize("options", [(), ("--fleet", "2")])
@pytest.mark.parametrize("service", ["plant", "controller", "tap"])
def test_what_was_only_looked_at_is_said_to_be_fine(
    service: str, options: tuple[str, ...], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    light = ("--eavesdropper", "nearest-centre")
    where = ("--run-dir", str(tmp_path / "run"), *light) if service == "tap" else ()
    assert main([service, "--scenario", "paper", "--check", *options, *where]) == 0
    out = capsys.readouterr().out
    told = "eavesdroppers nearest-centre" if service == "tap" else "scenario paper"
    assert out == f"{'2 loops' if options else told}: fine\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("service", ["plant", "controller", "tap"])
def test_an_endpoint_in_use_is_wrong_use_and_starts_nothing(
    service: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    bus = "adversary" if service == "tap" else "management"
    (field,) = free_endpoints(1)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        args = ["--listen", f"field={field}", "--listen", f"{bus}={endpoint}"]
        assert main([service, "--scenario", "paper", "--run-dir", str(tmp_path), *args]) == 2
    out, err = capfd.readouterr()
    assert (out, err) == ("", f"wyner: {endpoint}: cannot be opened: address already in use\n")
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "lock"]


@pytest.mark.parametrize("service", ["plant", "controller"])
def test_a_run_of_another_scenario_is_left_alone(
    service: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Their fingerprints are the same; a check would take one scenario's run for the other's."""
    keep_scenario(tmp_path, "paper")
    field, management = free_endpoints(2)
    args = (f"--listen=field={field}", f"--listen=management={management}", f"--run-dir={tmp_path}")
    (line,) = usage_error(capsys, service, "--scenario", "sustained", *args)
    assert line == (
        f"wyner: --run-dir: {tmp_path}: holds a run of another scenario (paper), "
        f"expected a new folder, or --scenario {tmp_path / 'scenario.toml'}"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["scenario.toml"]


def test_a_scenario_is_the_same_where_the_loop_is(tmp_path: Path) -> None:
    text = (ROOT / "runtime" / "scenarios" / "paper.toml").read_text()
    mine = tmp_path / "mine.toml"
    keep_scenario(tmp_path, "paper")
    mine.write_text(f"# a note\n{text}\n[tap]\nloss = 0.5\n")
    keep_scenario(tmp_path, str(mine))
    mine.write_text(f'{text}\n[link]\nfallback = "zero"\n')
    with pytest.raises(UsageError, match="another scenario"):
        keep_scenario(tmp_path, str(mine))
    assert (tmp_path / "scenario.toml").read_text() == text


@pytest.mark.parametrize("command", ["up", "plant", "controller", "design"])
def test_a_wrong_scenario_is_a_line_a_field(
    command: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "runtime" / "scenarios" / "paper.toml").read_text()
    text = text.replace("period_s = 0.1", 'period_s = "short"').replace("alpha = 8.0", "alpha = 0")
    (tmp_path / "mine.toml").write_text(text)
    before = [] if command == "design" else ["--scenario"]
    lines = usage_error(capsys, command, *before, "mine.toml")
    assert [line.split(":")[2].strip() for line in lines] == ["plant.period_s", "secrecy.alpha"]


def test_an_unexpected_error_is_one_line_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import wyner.cli.design

    def fail(_args: object) -> int:
        raise RuntimeError("something\n  nobody thought of")

    monkeypatch.setattr(wyner.cli.design, "run", fail)
    assert main(["design", "paper", "--knowledge"]) == 1
    assert capsys.readouterr().err == (
        "wyner: unexpected RuntimeError: something nobody thought of\n"
    )
    monkeypatch.setenv("WYNER_TRACEBACK", "1")
    with pytest.raises(RuntimeError):
        main(["design", "paper", "--knowledge"])


def test_ctrl_c_is_130(monkeypatch: pytest.MonkeyPatch) -> None:
    import wyner.cli.design

    def interrupt(_args: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(wyner.cli.design, "run", interrupt)
    assert main(["design", "paper", "--knowledge"]) == 130


def test_ctrl_c_while_the_command_is_loaded_is_quiet() -> None:
    code = (
        "import sys\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'wyner.cli.main': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "from wyner.__main__ import main\n"
        "sys.exit(main())\n"
    )
    done = python("-c", code)
    assert (done.returncode, done.stderr) == (130, "")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_told_to_end_the_command_gives_the_terminal_back(number: signal.Signals) -> None:
    screen = Terminal("-m", "wyner", "dashboard", "--loop", "nobody")
    screen.wait_for("\x1b[?1049h")
    wait_for(lambda: termios.tcgetattr(screen.leader) != screen.before)
    screen.process.send_signal(number)
    screen.end()
    assert screen.process.returncode == 130


def test_what_the_terminal_cannot_write_is_spelled_out() -> None:
    code = (
        "import sys, wyner.cli.main\n"
        "wyner.cli.main.main = lambda argv: print('Gr\u00fc\u00dfe \u2713') or 0\n"
        "from wyner.__main__ import main\n"
        "sys.exit(main())\n"
    )
    done = python("-c", code, env={**os.environ, "PYTHONIOENCODING": "latin-1"}, text=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout == b"Gr\xfc\xdfe \\u2713\n"


@pytest.mark.slow
def test_what_is_json_stays_json_on_every_standard_output(tmp_path: Path) -> None:
    """Also where the run's folder has a name that is no text."""
    text = "Gr\u00fc\u00dfe \u2713"
    run = tmp_path / os.fsdecode(b"run \xff")
    quick = ("--pace", "fast", "--steps", "20", "--message", text, "--run-dir", str(run))
    alone = ("--eavesdropper", "nearest-centre")
    commands = (
        ("latin-1", "up", *quick, *alone),
        ("latin-1", "check", run),
        ("ascii", "check", run),
    )
    for encoding, *command in commands:
        env = {**os.environ, "PYTHONIOENCODING": encoding}
        done = wyner(*command, "--json", env=env, text=False)
        assert json.loads(done.stdout)["run_dir"] == str(run), done.stderr
        assert done.returncode == 0
        assert b"Traceback" not in done.stderr
    done = wyner("report", run, env=env, text=False)
    assert done.returncode == 0, done.stderr


def test_a_folder_of_a_shipped_name_does_not_hide_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "paper").mkdir()
    assert main(["design", "paper", "--knowledge"]) == 0
    assert json.loads(capsys.readouterr().out)["scenario"] == "paper"


KNOWLEDGE = ("design", "paper", "--knowledge")


@pytest.mark.slow
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_is_one_line(unbuffered: str) -> None:
    with Path("/dev/full").open("w") as full:
        done = wyner(*KNOWLEDGE, stdout=full, env={**os.environ, "PYTHONUNBUFFERED": unbuffered})
    assert (done.returncode, done.stderr) == (1, "wyner: No space left on device\n")


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_goes_away_is_no_traceback(unbuffered: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = wyner(*KNOWLEDGE, stdout=writer, env={**os.environ, "PYTHONUNBUFFERED": unbuffered})
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


# --- small things that are right ------------------------------------------------------------------


def test_defaults_listen_once_and_connect_to_what_is_listened_at() -> None:
    rows = [SERVICES[name] for name in SERVICES]
    listened = [e for row in rows for ends in row.ends.values() for e in ends.listen]
    assert len(set(listened)) == len(listened)
    for row in rows:
        assert set(row.ends) <= set(BUSES)
        for ends in row.ends.values():
            assert set(ends.connect) <= set(listened), row.name
    assert "management" not in SERVICES["tap"].ends
