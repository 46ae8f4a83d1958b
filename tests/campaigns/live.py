"""A whole loop of live processes that can be killed, frozen and started again within a blink.

Services are forked from this process, which has their modules in memory already: each life is a
process of its own that opens its own journal and sockets, without the second that Python needs.
"""

import ctypes
import json
import os
import random
import signal
import sys
import time
import tomllib
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from runtime.addresses import free_endpoints
from runtime.run_folder import CONTROLLER_STATUS
from runtime.scenario_file import scenario_of
from runtime.shipped import scenario_file_of
from tests.campaigns.relay import relay_until_stopped
from wyner.cli.main import main
from wyner.deployment.certificates import ensure_certificates
from wyner.deployment.one_machine import RunOptions, lay_out
from wyner.fit.toml import as_toml

PRELOADED: Final = (
    "controller_service.command",
    "controller_service.service",
    "plant_service.command",
    "plant_service.service",
    "tap_service.command",
    "tap_service.service",
    "wyner.cli.router",
    "wyner.cli.send",
)

PR_SET_PDEATHSIG: Final = 1
"""Of prctl(2): a service dies with the campaign."""

AT_LAST_S: Final = 120.0
"""Seconds that a loop has to deliver what is queued, once all is well."""

EAVESDROPPERS: Final = ("nearest-centre",)
"""The capture is what counts here."""

Command = Callable[[Sequence[str]], int]


def fork(argv: Sequence[str], log: Path, command: Command = main) -> int:
    """Run ``command``, which is ``wyner``, in a process and a session of its own; its id.

    Raises
    ------
    RuntimeError
        When Zenoh was ever opened in this process: its threads hold what no child gets.
    """
    if "zenoh" in sys.modules:  # which is imported where a bus is opened
        raise RuntimeError("Zenoh runs in this process, and its forks could not: start another")
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        os.setsid()
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(out, 1)
        os.dup2(out, 2)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        code = command(argv)
    except BaseException:
        traceback.print_exc()
    finally:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


@dataclass
class Process:
    """A command that is started again and again; ``ended`` has the codes of its lives."""

    name: str
    argv: list[str]
    log: Path
    command: Command = main
    pid: int = 0
    ended: list[int] = field(default_factory=list)

    def start(self) -> None:
        """Begin a life."""
        self.pid = fork(self.argv, self.log, self.command)

    def signal(self, number: int) -> None:
        """Send it a signal, if it lives."""
        if self.alive():
            os.kill(self.pid, number)

    def alive(self) -> bool:
        """Whether it lives; notes how it ended."""
        if self.pid:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.pid = 0
                self.ended.append(os.waitstatus_to_exitcode(status))
        return bool(self.pid)

    def wait(self, seconds: float) -> bool:
        """Wait for its end; False where it does not come."""
        return wait_for(lambda: not self.alive(), seconds)

    def kill(self) -> None:
        """SIGKILL, and gone."""
        self.signal(signal.SIGKILL)
        self.wait(10)


def all_done(commands: list[Process]) -> bool:
    """Whether each has ended well; one that has not is started again."""
    waiting = [c for c in commands if c.alive() or c.ended[-1] != 0]
    for command in waiting:
        if not command.alive():
            print(f"{command.name}: code {command.ended[-1]}, asked again", file=sys.stderr)
            command.start()
            time.sleep(0.1)
    return not waiting


def wait_for(holds: Callable[[], bool], seconds: float) -> bool:
    """Whether it came to hold in time."""
    until = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > until:
            return False
        time.sleep(0.01)
    return True


class LiveLoop:
    """The processes of ``wyner up`` and, where asked, a router or a relay between the two ends.

    Parameters
    ----------
    folder : Path
        The run is kept in ``run`` below it.
    message : bytes
        The controller's first.
    pace : str
    router : bool
        All buses go through one router instead of from peer to peer.
    tls : bool
        The router is guarded: everybody shows a certificate, which says what it may publish.
    relay : tuple of float, optional
        The field bus between the two ends goes through a relay with these odds: loss, repeat, and
        the longest delay in seconds.
    scenario : str
        A shipped one that makes keys.
    """

    def __init__(
        self,
        folder: Path,
        message: bytes,
        pace: str = "fast",
        *,
        router: bool = False,
        tls: bool = False,
        relay: tuple[float, float, float] | None = None,
        scenario: str = "keys",
    ) -> None:
        for module in PRELOADED:
            __import__(module)
        self.folder, self.run_dir = folder, folder / "run"
        self.processes: dict[str, Process] = {}
        self.run_dir.mkdir(mode=0o700)
        file = folder / "scenario.toml"
        tables = tomllib.loads(scenario_file_of(scenario).read_text())
        tables["keys"]["eps_E"] = 0.5  # short blocks, so that some close between two deaths
        file.write_text(as_toml(tables))
        options = RunOptions(scenario=str(file), pace=pace)
        laid_out, running = lay_out(
            options, scenario_of(str(file)), EAVESDROPPERS, self.run_dir, message
        )
        services = {child.name: child.arguments for child in laid_out.children}
        self.management = [f"--connect=management={running.controller_management}"]
        if router:
            self._route(services, tls=tls)
        elif relay is not None:
            self._relay(services, relay)
        for name, arguments in services.items():
            self._add(name, arguments)

    def _add(self, name: str, arguments: list[str]) -> None:
        self.processes[name] = Process(name, [name, *arguments], self.folder / f"{name}.log")

    def _relay(self, services: dict[str, list[str]], odds: tuple[float, float, float]) -> None:
        """The controller does not connect to the plant; the relay connects to both."""
        at = "--listen=field="
        plant, controller = (
            next(word.removeprefix(at) for word in services[side] if word.startswith(at))
            for side in ("plant", "controller")
        )
        services["controller"].remove(f"--connect=field={plant}")
        pass_on = partial(relay_until_stopped, plant, controller, odds, 1)
        self.processes["relay"] = Process("relay", [], self.folder / "relay.log", pass_on)

    def _route(self, services: dict[str, list[str]], *, tls: bool) -> None:
        """Each service is a client of one router, and has no listener of its own."""
        buses = dict(zip(("field", "management", "adversary"), free_endpoints(3), strict=True))
        certificates = self.folder / "certs"
        if tls:
            buses = {bus: at.replace("tcp/", "tls/") for bus, at in buses.items()}
            names = ("router", "operator", *services)
            hosts = ["localhost", "127.0.0.1"]
            ensure_certificates(certificates, dict.fromkeys(names, hosts), 2)

        def shown(name: str, *of: str) -> list[str]:
            return [f"--tls={bus}={certificates / name}" for bus in of if tls]

        def client(name: str, *of: str) -> list[str]:
            clients = [f"--client={bus}" for bus in of]
            return [*clients, *[f"--connect={bus}={buses[bus]}" for bus in of], *shown(name, *of)]

        listens = [f"--listen={bus}={at}" for bus, at in buses.items()]
        self._add("router", [*listens, *shown("router", *buses)])
        self.management = client("operator", "management")
        for name, arguments in services.items():
            other = "adversary" if name == "tap" else "management"
            own = [word for word in arguments if not word.startswith(("--listen=", "--connect="))]
            services[name] = [*own, *client(name, "field", other)]

    def start(self) -> None:
        """Start whatever does not run."""
        for process in self.processes.values():
            if not process.alive():
                process.start()

    def send(self, name: str, text: str) -> Process:
        """An operator who asks until a message has been queued."""
        argv = ["send", text, "--id", name, "--timeout=600", *self.management]
        operator = Process(name, argv, self.folder / "send.log")
        operator.start()
        return operator

    def deliver_all(self, operators: list[Process], messages: int) -> list[str]:
        """All is well now: wait until every message has arrived; what did not come."""
        wrong = []
        if not wait_for(lambda: all_done(operators), AT_LAST_S):
            wrong.append("an operator has no answer")
        marker = self.folder / "now"
        marker.write_bytes(b"")
        since_s = marker.stat().st_mtime  # now, as the time stamps of files have it
        if not wait_for(lambda: self._delivered(since_s) == messages, AT_LAST_S):
            wrong.append(f"{self._delivered(since_s)} messages arrive although all is well")
        self.start()
        time.sleep(0.5)
        return wrong

    def _delivered(self, since_s: float) -> int:
        """Messages that have arrived, as the controller said after a time; else -1."""
        path = self.run_dir / CONTROLLER_STATUS
        with suppress(OSError, ValueError, KeyError):
            if path.stat().st_mtime > since_s:
                return int(json.loads(path.read_bytes())["frame"]["delivered"])
        return -1

    def stop(self) -> list[str]:
        """Ask every service to end; what was wrong with that."""
        wrong = []
        for process in self.processes.values():
            process.signal(signal.SIGCONT)
            process.signal(signal.SIGTERM)
        for process in self.processes.values():
            if not process.wait(30):
                wrong.append(f"{process.name}: goes on 30 s after SIGTERM")
                process.kill()
            elif process.ended[-1:] not in ([0], []):
                wrong.append(f"{process.name}: exit code {process.ended[-1]}")
        return wrong

    def last_line(self, name: str) -> str:
        """The last line that a service logged."""
        log = self.processes[name].log
        lines = log.read_text(errors="replace").splitlines() if log.exists() else []
        return lines[-1] if lines else ""


def plain_text(draw: random.Random, length: int) -> str:
    """A message of so many bytes."""
    return "".join(draw.choice("abcdefghijklmnop qrstuvwxyz") for _ in range(length)).strip() + "."
