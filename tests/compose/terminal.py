"""A program on a terminal of its own, with somebody who types."""

import contextlib
import fcntl
import os
import pty
import select
import struct
import termios
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Self

from tests.compose.composition import PATIENCE_S, ROOT


class Terminal:
    """Runs a command on a pseudo-terminal of 24 lines of 80 columns, until it ends."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self.output = ""
        self._code: int | None = None
        self._pid, self._master = pty.fork()
        if self._pid == 0:
            os.chdir(ROOT)
            os.execvpe(command[0], list(command), dict(environment) | {"TERM": "xterm"})
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))

    def press(self, text: str) -> None:
        """Press keys."""
        os.write(self._master, text.encode())

    def read(self, for_s: float) -> str:
        """Read for a while what the program shows; returns all it has shown so far."""
        until = time.monotonic() + for_s
        while (left := until - time.monotonic()) > 0:
            ready, _, _ = select.select([self._master], [], [], min(left, 0.1))
            if ready:
                try:
                    shown = os.read(self._master, 65536)
                except OSError:  # the program has hung up
                    break
                self.output += shown.decode(errors="replace")
        return self.output

    def read_until(self, *texts: str) -> None:
        """Read until the program has shown every text; fails when it does not."""
        until = time.monotonic() + PATIENCE_S
        while missing := [text for text in texts if text not in self.output]:
            assert time.monotonic() < until, f"never shown: {missing}:\n{self.output[-2000:]}"
            self.read(0.2)

    def wait(self, within_s: float) -> int:
        """The exit code; fails when the program does not end in time."""
        until = time.monotonic() + within_s
        while self._code is None:
            assert time.monotonic() < until, f"still there:\n{self.output[-2000:]}"
            self.read(0.1)
            pid, status = os.waitpid(self._pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._code is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, 9)
            os.waitpid(self._pid, 0)
        os.close(self._master)
