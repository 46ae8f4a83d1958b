"""What a guarded router did not let in, read from Zenoh's log.

Zenoh tells its judgements nowhere else. Its log has three kinds of lines for them:

- ``... ZID on ...+CertCommonName(tap)+... is unauthorized to Put (ingress) on KEY``: a message that
  was judged now.
- ``... Using cached result: ZID is unauthorized to Put (ingress) on KEY``: a message judged by what
  had been found before. It names the session only, not the certificate.
- ``... ACL (ingress): caching permissions for `KEY` ...``, then one line of the first kind for each
  kind of message: what would be judged of messages that nobody has sent.
"""

import os
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from runtime.logs import RateLimitedLog

SESSIONS: Final = 4096
"""Of so many sessions the name is kept."""

_LINE: Final = re.compile(r"(?P<thread>ThreadId\(\d+\)) \S*access_control\S* (?P<said>.*)")
_IN_ADVANCE: Final = re.compile(r"ACL \(\w+\): caching permissions for `(?P<key>[^`]*)`")
_JUDGED: Final = re.compile(
    r"(?P<zid>[0-9a-f]+) on .*?CertCommonName\((?P<name>[^)]*)\).* is (?P<verdict>un)?authorized "
    r"to (?P<what>.+ \(\w+\)) on (?P<key>\S+)"
)
_AS_BEFORE: Final = re.compile(
    r"Using cached result: (?P<zid>[0-9a-f]+) is unauthorized to (?P<what>.+ \(\w+\)) "
    r"on (?P<key>\S+)"
)


class Denials:
    """Reads the lines of one router, in order."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}
        # By thread: the key that is judged in advance there, and the kinds of messages done.
        self._in_advance: dict[str, tuple[str, set[str]]] = {}

    def read(self, line: str) -> str:
        """What a line says of a message that was not let in; empty if nothing.

        Parameters
        ----------
        line : str
            One line of Zenoh's log, at level ``trace`` of its access control.
        """
        found = _LINE.search(line)
        if found is None:
            return ""
        thread, said = found["thread"], found["said"]
        if begun := _IN_ADVANCE.match(said):
            self._in_advance[thread] = begun["key"], set()
            return ""
        if judged := _JUDGED.match(said):
            self._names[judged["zid"]] = judged["name"]
            if len(self._names) > SESSIONS:
                del self._names[next(iter(self._names))]
            if self._is_in_advance(thread, judged["key"], judged["what"]) or not judged["verdict"]:
                return ""
            return _denial(judged["name"], judged["what"], judged["key"])
        if again := _AS_BEFORE.match(said):
            who = self._names.get(again["zid"], "who has no name in the rules")
            return _denial(who, again["what"], again["key"])
        return ""

    def _is_in_advance(self, thread: str, key: str, what: str) -> bool:
        judging, done = self._in_advance.get(thread, ("", set[str]()))
        if key != judging or what in done:
            self._in_advance.pop(thread, None)
            return False
        done.add(what)
        return True


def _denial(who: str, what: str, key: str) -> str:
    """The line for one message; empty for what is no message of this router's own judgement."""
    verb, _, flow = what.rpartition(" ")
    if flow != "(ingress)" or verb not in ("Put", "Delete"):
        return ""
    return f"denied: {who} may not {verb.lower()} on {key}"


@contextmanager
def denials_told(complaints: RateLimitedLog) -> Iterator[None]:
    """Read Zenoh's log, which it writes to standard output, and tell what was denied."""
    sys.stdout.flush()
    kept = os.dup(1)
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)

    def read() -> None:
        denials = Denials()
        with open(reading, encoding="utf-8", errors="replace") as lines:  # noqa: PTH123
            for line in lines:
                if told := denials.read(line):
                    complaints.add(told)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    try:
        yield
    finally:
        os.dup2(kept, 1)  # the pipe's last end closes, and the thread ends
        os.close(kept)
        thread.join(1.0)
        complaints.report_held_back(last=True)
