"""How much processor time a guest and all that it started may use."""

import mmap
import os
import resource
import struct
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

PROCESSOR_S: Final = 5.0
"""Seconds of processor time that a guest, with all that it started, has beside its answers. For an
answer it has as much as the answer may take, for one core."""

PROCESSOR_SHARE: Final = 0.05
"""Share of one core that a guest has besides, for as long as it lives."""

LOADING_S: Final = 20.0
"""Seconds of processor time that loading a guest may take."""

_METER: Final = struct.Struct("ddd")


class Meter:
    """What processor time a guest may have used; the guest and its supervisor share it.

    Parameters
    ----------
    now : float, optional
        Monotonic seconds.
    """

    def __init__(self, now: float | None = None) -> None:
        self._began = time.monotonic() if now is None else now
        self._kept = mmap.mmap(-1, _METER.size)
        self._put(-1.0, 0.0, 0.0)  # nothing asked so far: it is being loaded

    def _put(self, earned_s: float, asked: float, within_s: float) -> None:
        _METER.pack_into(self._kept, 0, earned_s, asked, within_s)

    def ask(self, within_s: float, now: float, loading_s: float) -> None:
        """It is asked something; ``loading_s`` is what it took to be loaded, the first time."""
        earned = _METER.unpack_from(self._kept)[0]
        self._put(loading_s if earned < 0 else earned, now, within_s)

    def answer(self, now: float) -> None:
        """It has answered."""
        earned, asked, within_s = _METER.unpack_from(self._kept)
        self._put(earned + min(now - asked, within_s), 0.0, 0.0)

    def overspent(self, used_s: float, now: float) -> bool:
        """Whether ``used_s`` seconds of processor time up to ``now`` are too many."""
        earned, asked, within_s = _METER.unpack_from(self._kept)
        if earned < 0:
            earned = LOADING_S
        if asked:
            earned += min(now - asked, within_s)
        return bool(used_s > earned + PROCESSOR_S + PROCESSOR_SHARE * (now - self._began))


def used_s() -> float:
    """Seconds of processor time of this process's descendants, without its own."""
    _, *running = _family(os.getpid())
    gone = resource.getrusage(resource.RUSAGE_CHILDREN)
    return _seconds(running) + gone.ru_utime + gone.ru_stime


def used_by_s(child: int) -> float:
    """Seconds of processor time of one process and of all that comes from it."""
    return _seconds(_family(child))


def children_of(parent: int) -> list[int]:
    """Processes whose parent this one is, also those that are dead and not waited for."""
    return _children()(parent)


def _children() -> Callable[[int], list[int]]:
    """What tells a process's children: the kernel, or a look at every process."""
    if CHILDREN_TOLD:
        return _told
    seen: defaultdict[int, list[int]] = defaultdict(list)
    for process in processes():
        if stat := _stat(process):
            seen[int(stat[1])].append(int(process.name))
    return lambda parent: seen[parent]


def _told(parent: int) -> list[int]:
    found: list[int] = []
    with suppress(OSError):  # it has ended
        for thread in Path(f"/proc/{parent}/task").iterdir():
            with suppress(OSError):  # this thread alone has
                found += map(int, (thread / "children").read_text().split())
    return found


CHILDREN_TOLD: Final = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").exists()
"""Whether this kernel tells a process's children."""


def _stat(process: Path) -> list[str]:
    """What the kernel tells of a process, from its state on; nothing of one that has ended."""
    try:
        told = (process / "stat").read_bytes().decode(errors="replace")
    except OSError:
        return []
    return told.rpartition(")")[2].split()


def _family(ancestor: int) -> list[int]:
    """A process, and after it all that come from it."""
    family, children = [ancestor], _children()
    for member in family:
        family += children(member)
    return family


def _seconds(family: Iterable[int]) -> float:
    """Processor time of processes, and of their children that have ended and were waited for."""
    ticks = sum(sum(map(int, _stat(Path(f"/proc/{pid}"))[11:15])) for pid in family)
    return ticks / os.sysconf("SC_CLK_TCK")


def processes() -> list[Path]:
    """The folder of each process there is."""
    return [path for path in Path("/proc").iterdir() if path.name.isdigit()]
