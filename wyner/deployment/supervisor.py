"""The three services as child processes: started, watched, started again when killed, stopped."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from runtime.errors import Failure
from runtime.files import make_folder, open_private
from runtime.recording import ended
from runtime.services import Service
from runtime.signals import STOP_WITH_STDIN
from wyner.deployment.running import listens

LEFT_S: Final = 1.0
"""Seconds to wait until what a killed service has left is gone."""

RESTART_S: Final = 0.2
"""Seconds before a killed service is started again."""

RESTARTS: Final = 20
"""A service that was killed more often than this in one run stays down."""

START_S: Final = 60.0
"""Seconds that the tap has to come up, as long as it lives: a machine may be busy."""


@dataclass
class Child:
    """One service and its process.

    Parameters
    ----------
    service : Service
    arguments : list of str
        After ``python -m PACKAGE``.
    log : Path
        Where its output goes, appended.
    trace : Path, optional
        What it ends with an end mark where it comes to its end by itself.
    """

    service: Service
    arguments: list[str]
    log: Path
    trace: Path | None = None
    process: subprocess.Popen[bytes] | None = None
    restarts: int = 0
    restart_at: float = 0.0
    returned: int | None = None
    alone: bool = False
    """Whether all that the process had started is gone with it."""

    @property
    def name(self) -> str:
        """The service's."""
        return self.service.name

    def start(self) -> None:
        """Start the process, in a process group of its own: Ctrl-C reaches the parent only.

        Not in a session of its own. Linux divides the processors among sessions first (autogroup)
        and looks at niceness within each: a tap that gives way would get as much as the plant.
        """
        make_folder(self.log.parent)
        self.alone = False
        log = open_private(self.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-m", self.service.package, *self.arguments],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                env={**os.environ, STOP_WITH_STDIN: "1"},
                process_group=0,
            )
        finally:
            os.close(log)

    def poll(self, now_s: float) -> int | None:
        """Look after the process; its exit code once it ended by itself.

        Killed by a signal, it is started again after :data:`RESTART_S`, as a restart policy would.
        """
        if self.returned is not None or self.process is None:
            return self.returned
        code = self.process.poll()
        if code is None:
            return None
        self._end_the_rest()
        if code >= 0 or self.restarts >= RESTARTS:
            self.returned = code
        elif not self.restart_at:
            self.restart_at = now_s + RESTART_S
        elif now_s >= self.restart_at:
            self.restart_at = 0.0
            self.restarts += 1
            self._let_go()
            self.start()
        return self.returned

    def stop(self) -> None:
        """Ask the process to stop, then make it."""
        if self.process is None:
            return
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(self.service.stop_s)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._end_the_rest()
        self._let_go()

    def _end_the_rest(self) -> None:
        """End what a service that was killed has left: processes of its own, at its files still.

        A tap's eavesdroppers went on writing their guesses in a run that was sealed already.
        """
        if self.process is None or self.alone:
            return
        self.alone = True  # the group's number may be another's from here on
        group, until = self.process.pid, time.monotonic() + LEFT_S
        with suppress(ProcessLookupError):
            os.killpg(group, signal.SIGKILL)
            while time.monotonic() < until:  # longer only where nobody takes notice of the dead
                os.killpg(group, 0)
                time.sleep(0.005)

    def _let_go(self) -> None:
        if self.process is not None and self.process.stdin is not None:
            self.process.stdin.close()

    def broke_off(self) -> bool:
        """Whether it returned without an error and without its trace's end.

        A user's file may end its process, with any exit code.
        """
        if self.returned != 0 or self.trace is None:
            return False
        try:
            return not ended(self.trace)
        except OSError:
            return True

    def last_line(self) -> str:
        """The last line of its log: why it ended."""
        try:
            lines = self.log.read_text(errors="replace").strip().splitlines()
        except OSError:
            lines = []
        return lines[-1].removeprefix("wyner: ") if lines else "no reason given"


@dataclass
class Supervisor:
    """The children of one run, in the order in which they are stopped.

    The tap is started before the others and listens at ``tap_field``: it then hears the very first
    message.
    """

    children: list[Child]
    tap_field: str

    def start(self) -> None:
        """Start them all.

        Raises
        ------
        Failure
            When the tap does not come up.
        """
        tap = self.child("tap")
        tap.start()
        until = time.monotonic() + START_S
        while not listens(self.tap_field):
            self.poll()
            if time.monotonic() > until:
                raise Failure(f"tap: not up after {START_S:g} s (log: {tap.log})")
            time.sleep(0.02)
        for child in self.children:
            if child is not tap:
                child.start()

    def child(self, name: str) -> Child:
        """The child of a name."""
        return next(c for c in self.children if c.name == name)

    def poll(self) -> None:
        """Look after them all.

        Raises
        ------
        Failure
            When one ended by itself with an error; the line is the last of its log.
        """
        now = time.monotonic()
        for child in self.children:
            code = child.poll(now)
            if code:
                raise Failure(f"{child.name}: {child.last_line()} (log: {child.log})")
            if child.broke_off():
                raise Failure(
                    f"{child.name}: its process ended in the middle of the run, with exit code 0 "
                    f"(log: {child.log})"
                )

    def stop(self) -> None:
        """Stop them all, in their order."""
        for child in self.children:
            child.stop()
