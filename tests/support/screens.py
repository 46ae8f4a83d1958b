"""A screen as text, and a program that has a terminal for a screen."""

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import time
from contextlib import suppress
from io import StringIO

from rich.console import Console, RenderableType

from tests.support.patience import PATIENCE_S
from tests.support.programs import ROOT


def to_text(shown: RenderableType, size: tuple[int, int]) -> str:
    """What fills a screen, without styles or trailing blanks."""
    console = Console(file=StringIO(), width=size[0], color_system=None, record=True)
    console.print(shown, height=size[1], end="")
    text = console.export_text()
    return "".join(line.rstrip() + "\n" for line in text.splitlines())


class Terminal:
    """Python with these words on a terminal of its own, which must be left as it was."""

    def __init__(self, *words: str) -> None:
        self.leader, follower = pty.openpty()
        fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        self.before = termios.tcgetattr(self.leader)
        self.process = subprocess.Popen(
            [sys.executable, *words],
            stdin=follower,
            stdout=follower,
            stderr=follower,
            start_new_session=True,
            cwd=ROOT,
            env={**os.environ, "TERM": "xterm-256color", "PYTHONUTF8": "1"},
        )
        os.close(follower)
        self.seen = b""

    def wait_for(self, text: str, timeout_s: float = 20) -> None:
        end = time.monotonic() + timeout_s
        while text.encode() not in self.seen:
            assert time.monotonic() < end, f"no {text!r} in {self.seen[-3000:]!r}"
            self._read(0.1)

    def _read(self, timeout_s: float) -> None:
        ready, _, _ = select.select([self.leader], [], [], timeout_s)
        if ready:
            with suppress(OSError):
                self.seen += os.read(self.leader, 65536)

    def type(self, keys: str) -> None:
        os.write(self.leader, keys.encode())

    def resize(self, columns: int, rows: int) -> None:
        fcntl.ioctl(self.leader, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def end(self) -> str:
        """Wait for the end; what was printed after the screen closed."""
        end = time.monotonic() + PATIENCE_S
        while self.process.poll() is None:
            assert time.monotonic() < end
            self._read(0.05)
        for _ in range(5):
            self._read(0.05)
        assert termios.tcgetattr(self.leader) == self.before
        os.close(self.leader)
        shown, _, after = self.seen.rpartition(b"\x1b[?1049l")
        assert b"\x1b[?1049h" in shown
        assert after.count(b"\x1b[?25l") == 0
        assert self.seen.rfind(b"\x1b[?25h") > self.seen.rfind(b"\x1b[?25l")
        return after.decode()
