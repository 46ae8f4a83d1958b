"""One rule for exit codes: 0 done, 1 a finding or a failure, 2 wrong use, each in one line.

A table of every command. ``RUN`` is a run that has ended, ``mine.toml`` a scenario in the folder.
"""

import re
import shutil
from pathlib import Path
from typing import Final

import pytest

from tests.support.scenarios import text_of
from wyner.cli.main import commands, main

DONE: Final = (
    ("design",),
    ("design", "mine.toml"),
    ("design", "paper", "--knowledge", "k.json"),
    ("new", "other"),
    ("check", "RUN"),
    ("score", "RUN"),
    ("report", "RUN", "--output", "c.csv"),
    ("status", "RUN"),
    ("certs", "certs", "--name", "plant"),
)

FIT: Final = ("-o", "f.toml", "--states", "a", "--inputs", "u", "--period", "1")

GUARDED: Final = ("--listen", "field=tls/127.0.0.1:1")

FOUND: Final[tuple[tuple[tuple[str, ...], str], ...]] = (
    # a finding
    (("design", "far.toml"), ""),
    (("check", "BROKEN"), ""),
    (("status", "BROKEN"), ""),
    (("score", "RUN", "--eavesdropper", "fails.py:Fails"), ""),
    # a failure
    (("status", "--endpoint", "tcp/127.0.0.1:1"), "no answer"),
    (("send", "hello", "--timeout", "0.2"), "no run on this machine within 0.2 s"),
    (("fit", "rows.csv", *FIT), "got 1 steps to identify A and B"),
)

WRONG: Final[tuple[tuple[tuple[str, ...], str], ...]] = (
    (("--json",), "the following arguments are required: COMMAND"),
    (("fly",), "invalid choice: 'fly'"),
    (("up", "--fly"), "unrecognized arguments: --fly"),
    (("up", "--steps", "many"), "--steps: invalid int value: 'many'"),
    (("up", "--steps", "0"), "--steps: got 0, expected"),
    (("up", "--seed", "-1"), "--seed: got -1, expected at least 0"),
    (("up", "--run-dir", ""), "--run-dir: got '', expected a folder"),
    (("up", "--run-dir", "RUN"), "--run-dir: RUN: has a run already, expected a new folder"),
    (("up", "--run-dir", "/proc/x"), "--run-dir: /proc/x: cannot be written"),
    (("up", "--eavesdropper", "eve"), "eavesdropper: got 'eve', expected set-membership"),
    (("up", "--pace", "x0"), "--pace: got 'x0', expected realtime, fast, or xN"),
    (("up", "--message", ""), "message: got 0 bytes, expected 1 to 65535"),
    (("up", "--message", "@none.txt"), "message: none.txt: cannot be read"),
    (("up", "--scenario", "far.toml"), "plant.initial_state: "),
    (("up", "--scenario", "mine"), "mine: no such file; did you mean mine.toml?"),
    (
        ("up", "--scenario", "sealed", "--steps", "48"),
        "--steps: got 48, expected more than 48",
    ),
    (("up", "--demo", "--pace", "fast"), "--pace: cannot be given with --demo"),
    (("plant", "--loop", "a/b"), "--loop: got 'a/b'"),
    (("plant", "--listen", "field"), "--listen: got 'field', expected BUS="),
    (("plant", "--listen", "adversary=tcp/127.0.0.1:1"), "with BUS one of field, management"),
    (("plant", "--folder", "none"), "--folder: got 'none', expected a folder"),
    (("controller", "--connect", "management=tcp/127.0.0.1:x"), "expected tcp/HOST:PORT"),
    (("controller", "--client", "adversary"), "--client: got 'adversary'"),
    (("controller", "--check", "--metrics", "here"), "--metrics: got 'here', expected HOST:"),
    (("tap", "--run-dir", "d"), "--scenario, --knowledge or a file of --fleet: expected one"),
    (("tap", "--run-dir", "d", "--fleet", "3"), "--scenario, --knowledge or a file of --fleet"),
    (("tap", "--run-dir", "d", "--knowledge", "none"), "--knowledge: none: cannot be read"),
    (("tap", "--run-dir", "d", "--scenario", "paper", "--view", "v.json"), "v.json: loss: "),
    (("tap", "--run-dir", "d", "--scenario", "paper", "--total-bytes", "3"), "--total-bytes: got"),
    (("dashboard", "--connect", "intel=tcp/127.0.0.1:1"), "one of management, adversary"),
    (("router", "--listen", "ops=tcp/127.0.0.1:1"), "with BUS one of field, management, adversary"),
    (("router", "--listen", "field=tcp/127.0.0.1:1", "--tls", "management=d"), "expected --listen"),
    (("router", "--listen", "field=127.0.0.1:1"), "got '127.0.0.1:1', expected tcp/HOST:PORT"),
    (("router", *GUARDED, "--tls", "field=a", "--tls", "field=b"), "field: got several folders"),
    (("router", *GUARDED, "--tls", "field=nowhere"), "no such file"),
    (("certs", "c", "--name", "a=b c"), "--name a=b c: host: got 'b c', expected an IP address"),
    (("certs", "c", "--name", "a="), "--name: got 'a=', expected NAME or NAME=HOST,..."),
    (("certs", "c", "--name", "a/b"), "--name a/b: name: got 'a/b', expected 1 to 64"),
    (("send",), "the following arguments are required: TEXT"),
    (("send", "text", "--timeout", "0"), "--timeout: got 0.0"),
    (("send", "text", "--id", "a b"), "--id: got 'a b'"),
    (("check", "none"), "none: no run here"),
    (("status", "empty"), "empty: no service has reported there"),
    (("status", "--endpoint", "tcp/nowhere"), "--endpoint: got 'tcp/nowhere', expected PROTOCOL/"),
    (("score", "none"), "none: no run here"),
    (("score", "empty"), "empty: no run here"),
    (("score", "RUN", "--eavesdropper", "eve"), "--eavesdropper: got 'eve', expected set-membersh"),
    (("score", "RUN", "--plot", "f.doc"), "--plot: got 'f.doc', expected a name that ends in"),
    (("report", "none"), "none: no run here"),
    (("report", "RUN", "--output", "a.xml"), "got 'a.xml', expected a name that ends in .html, .c"),
    (("report", "RUN", "--steps"), "--steps: expected --output FILE.csv or FILE.parquet"),
    (("report", "RUN", "--output", "file/p.html"), "file/p.html: "),
    (("report", "RUN", "--output", "file/c.csv"), "file/c.csv: cannot be written"),
    (("new", "a b"), "NAME: got 'a b'"),
    (("new", "mine"), "mine.toml: is there already, expected another name"),
    (("design", "none"), "none: no such file, and no shipped scenario; shipped are"),
    (("design", "mine"), "mine: no such file; did you mean mine.toml?"),
    (("design", "paper", "--knowledge", "file/k.json"), "--knowledge: file/k.json: cannot be wri"),
    (("design", "unstable.toml"), "unstable.toml: control.gain: K does not stabilise"),
    (("fit", "mine", "-o", "f.toml"), "mine: no such file; did you mean mine.toml?"),
    (("fit", "rows.csv", "-o", "f.toml"), "rows.csv: a recording wants --states"),
    (
        ("fit", "rows.csv", "-o", "f.toml", *["--states", "z", "--inputs", "u", "--period", "1"]),
        "has no colu",
    ),
    (
        ("fit", "mine.toml", "-o", "f.toml", "--violation=0.01", "--sessions=98"),
        "got 98 sessions",
    ),
    (
        ("fit", "mine.toml", "-o", "f.toml", "--violation=0.001"),
        "--sessions: got 100 sessions",
    ),
    (("fit", "mine.toml", "-o", "f.toml", "--steps=0"), "--steps: got 0, expected at least 1"),
    (("fit", "mine.toml", "-o", "f.toml", "--amplitude=2"), "--amplitude: got 2, expected between"),
    (("fit", "sustained", "-o", "none/f.toml"), "--output: got 'none/f.toml', expected"),
    (("sweep", "none"), "none: no such file, and no shipped sweep; shipped are disturbances,"),
    (("sweep", "mine.toml"), "mine.toml: this is a scenario, expected a sweep"),
    (("sweep", "price", "--jobs", "0"), "--jobs: got 0, expected at least 1"),
    (("sweep", "price", "--output", "file/s.csv"), "--output: file/s.csv: cannot be written"),
    (("sweep", "price", "--plot", "p.doc"), "--plot: got 'p.doc', expected a name that ends in"),
)

FAILS: Final = """
from wyner import Belief, Eavesdropper, Guess

class Fails(Eavesdropper):
    name = "fails"
    def observe(self, transition):
        raise ValueError("no idea")
    def belief(self):
        return Belief("", 0)
"""


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    options = ("--scenario", "packed", "--pace", "fast", "--steps", "60")
    assert main(["up", *options, "--run-dir", str(folder / "RUN")]) == 0
    shutil.copytree(folder / "RUN", folder / "BROKEN")
    for file, was, now in (
        ("trace.jsonl", b'"coin":0', b'"coin":1'),
        ("status.json", b'"outside":0', b'"outside":3'),
    ):
        path = folder / "BROKEN" / "plant" / file
        path.write_bytes(path.read_bytes().replace(was, now, 1))
    return folder


@pytest.fixture
def here(runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # where running loops are noted
    for name in ("RUN", "BROKEN"):
        Path(name).symlink_to(runs / name)
    Path("mine.toml").write_text(text_of("sustained"))
    far = ("initial_state = [4.0, -2.0]", "initial_state = [1e6, 0.0]")
    Path("far.toml").write_text(text_of("paper", far))
    unstable = re.sub(r"gain = .*", "gain = [[1.0, 0.0]]", text_of("paper"))
    Path("unstable.toml").write_text(unstable)
    Path("fails.py").write_text(FAILS)
    Path("rows.csv").write_text("a,u\n" + "1,2\n" * 4)
    Path("v.json").write_text('{"loss": 2}')
    Path("file").touch()
    Path("empty").mkdir()
    return tmp_path


@pytest.mark.parametrize("argv", DONE, ids=" ".join)
def test_what_was_done_ends_with_0(
    argv: tuple[str, ...], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(argv) == 0, capsys.readouterr()


@pytest.mark.parametrize(("argv", "line"), FOUND, ids=lambda it: " ".join(it) if it else "")
def test_a_finding_or_a_failure_ends_with_1(
    argv: tuple[str, ...], line: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(argv) == 1, capsys.readouterr()
    err = capsys.readouterr().err
    assert line in err
    assert "Traceback" not in err


@pytest.mark.parametrize(("argv", "line"), WRONG, ids=lambda it: " ".join(it) if it else "")
def test_wrong_use_ends_with_2_in_a_line(
    argv: tuple[str, ...], line: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(argv) == 2, capsys.readouterr()
    out, err = capsys.readouterr()
    assert out == ""
    assert line in err
    assert all(each.startswith("wyner: ") for each in err.splitlines()), err


def test_every_command_is_in_the_table() -> None:
    told = {argv[0] for argv in DONE} | {argv[0] for argv, _ in (*FOUND, *WRONG)}
    assert set(commands()) <= told
