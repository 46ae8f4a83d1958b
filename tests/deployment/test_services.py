"""A service of one's own is a row: command, access control, certificates, health, child process."""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from runtime.services import PLANT_FIELD, SERVICES, Ends, Service
from tests.support.patience import PATIENCE_S
from wyner.cli.certs import default_names
from wyner.cli.main import commands, main
from wyner.deployment.supervisor import Child, Supervisor

PACKAGE = "counting_service"

COMMAND = """
import json, sys, threading, time
from pathlib import Path

def add_arguments(parser):
    from runtime.bus_options import add_service_arguments
    parser.add_argument("--run-dir", type=Path, required=True)
    add_service_arguments(parser, "counting")

def run(args):
    from runtime.signals import stop_on_signals
    count = 0
    with stop_on_signals() as stopping:
        while not stopping.wait(0.02):
            count += 1
            path = args.run_dir / "counting" / "status.json"
            told = {"t_ns": time.time_ns(), "count": count}
            path.with_suffix(".new").write_text(json.dumps(told))
            path.with_suffix(".new").replace(path)
    return 0
"""

MAIN = """
import sys
from runtime.services import SERVICES, Ends, Service
row = Service("counting", package="counting_service", ends={"field": Ends()})
SERVICES["counting"] = row
from runtime.command import serve
sys.exit(serve("counting"))
"""


@pytest.fixture
def counting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    package = tmp_path / PACKAGE
    package.mkdir()
    (package / "__init__.py").touch()
    for name, text in (("command", COMMAND), ("__main__", MAIN)):
        (package / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    service = Service(
        name="counting",
        summary="count to no purpose",
        package=PACKAGE,
        ends={"field": Ends((), (PLANT_FIELD,)), "management": Ends()},
        publishes={"management": ("management/counting/status",)},
        reports=True,
        stop_s=3.0,
    )
    monkeypatch.setitem(SERVICES, "counting", service)
    yield service
    for name in [n for n in sys.modules if n.split(".")[0] == PACKAGE]:
        del sys.modules[name]


def test_the_command_lists_it_and_has_its_options(
    counting: Service, capsys: pytest.CaptureFixture[str]
) -> None:
    assert commands()["counting"] == counting.summary
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "count to no purpose" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["counting", "--help"])
    assert "BUS is one of: field, management" in capsys.readouterr().out
    assert main(["counting"]) == 2
    assert capsys.readouterr().err.startswith("wyner: the following arguments are required")
    assert "counting" in default_names(), "it has a certificate"


def test_it_is_supervised_and_its_health_is_told(
    counting: Service, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    child = Child(counting, ["--run-dir", str(tmp_path)], tmp_path / "counting" / "log")
    child.start()
    try:
        until = time.monotonic() + PATIENCE_S
        while not (tmp_path / "counting" / "status.json").exists():
            assert child.poll(time.monotonic()) is None, child.last_line()
            assert time.monotonic() < until
            time.sleep(0.02)
        assert child.process is not None
        # niceness counts within a session: the services share one, and Ctrl-C passes them by
        assert os.getsid(child.process.pid) == os.getsid(0)
        assert os.getpgid(child.process.pid) == child.process.pid
        assert main(["status", str(tmp_path)]) == 0
        assert capsys.readouterr().out.startswith("counting    ")
    finally:
        Supervisor([child], "").stop()
    assert child.process is not None
    assert child.process.returncode == 0
