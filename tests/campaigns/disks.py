"""A full and a read-only disk for each service: ``python -m tests.campaigns.disks``.

Needs root, to mount, and a C compiler. The folder of one service is a disk of its own (tmpfs), too
small for the run, or made read-only in the middle of it while nothing is open there; or what it has
open turns read-only in its hands (hostile.c), as where a kernel finds a disk damaged, in its folder
or in the whole run's. The service must go on, or end with one line that names a file and with exit
code 1 or 2, at once when it is started again. As soon as there is room the run goes on, and
:mod:`tests.campaigns.traffic` says what must have come of it.
"""

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Final

from tests.campaigns.live import (
    LiveLoop,
    Process,
    keep_failed,
    plain_text,
    preloaded,
    wait_for,
)
from tests.campaigns.resumable import Results
from tests.campaigns.traffic import Traffic

SMALL_KB: Final = (0, 40, 100, 200, 400, 1000)
"""What a disk that is found too small has room for, besides what is there."""

SERVICES: Final = ("controller", "plant", "tap")
WHOLE: Final = "run"
"""In place of a service: the folder of the whole run."""

KINDS: Final = ("full", "read-only", "turned")
NOTICED_S: Final = 6.0


def mount(*options: str) -> None:
    """mount(8)."""
    subprocess.run(["mount", *options], check=True)


class Disk:
    """A file system of its own below a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(mode=0o700)
        mount("-t", "tmpfs", "-o", "size=64m,mode=0700", "tmpfs", str(folder))

    def fill(self, left_kb: int) -> None:
        """Leave room for so much."""
        with (self.folder / "ballast").open("wb") as ballast:
            room = os.statvfs(self.folder)
            size = room.f_bavail * room.f_frsize - left_kb * 1024
            while size > 0:
                try:
                    os.posix_fallocate(ballast.fileno(), 0, size)
                except OSError:  # the services wrote meanwhile
                    size -= 1 << 16
                else:
                    return

    def read_only(self) -> None:
        """Let nothing be written any more."""
        mount("-o", "remount,ro", str(self.folder))

    def mend(self) -> None:
        """All is well again."""
        mount("-o", "remount,rw", str(self.folder))
        (self.folder / "ballast").unlink(missing_ok=True)

    def remove(self) -> None:
        """Unmount it."""
        subprocess.run(["umount", "-l", str(self.folder)], check=True)


class Turned:
    """A folder that becomes read-only under files that are open, as hostile.c has it."""

    def __init__(self, folder: Path) -> None:
        self._page = Path(os.environ["WYNER_DISK"])
        self._folder = bytes(folder) + b"/\0"
        self.mend()

    def read_only(self) -> None:
        """Let nothing be written any more."""
        with self._page.open("r+b") as page:
            page.seek(8)
            page.write(self._folder)
            page.seek(0)
            page.write(b"1")

    def mend(self) -> None:
        """All is well again."""
        with self._page.open("r+b") as page:
            page.write(b"\0")

    def remove(self) -> None:
        """There is nothing to remove."""


def said_well(process: Process, before: int, home: Path) -> tuple[str, list[str]]:
    """The line with which a service ended by itself, and what was wrong with how it ended."""
    said = process.log.read_text(errors="replace").splitlines()[before:]
    errors = [line for line in said if line.startswith("wyner: ")]
    last = (errors or said or ["nothing"])[-1].replace(str(home), "")
    if len(errors) == 1 and process.ended[-1] in (1, 2) and "Traceback" not in str(said):
        return last, []
    return last, [f"{process.name}: code {process.ended[-1]}, said {said[-5:]}"]


def lines(process: Process) -> int:
    """How many lines it has logged."""
    return len(process.log.read_text(errors="replace").splitlines())


def one_run(service: str, kind: str, left_kb: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Fill, or make read-only; what came of it, and what was wrong."""
    draw = random.Random(left_kb)
    text = plain_text(draw, 100)
    loop = LiveLoop(folder, text.encode(), pace="x20")
    home = loop.run_dir if service == WHOLE else loop.run_dir / service
    sharing = [p for n, p in loop.processes.items() if service in (WHOLE, n)]
    disk = Turned(home) if kind == "turned" else Disk(home)
    counts: Counter[str] = Counter()
    traffic = Traffic(loop, text, draw)
    try:
        with traffic:
            time.sleep(1.0)
            before = {p.name: lines(p) for p in sharing}
            if isinstance(disk, Disk) and kind == "full":
                disk.fill(left_kb)
            elif isinstance(disk, Turned):
                disk.read_only()
            else:
                for process in sharing:  # with files open for writing none becomes read-only
                    process.kill()
                disk.read_only()
                for process in sharing:
                    process.start()
            watched = [p for p in sharing if kind == "turned" or p.name == service]
            wait_for(lambda: not any(p.alive() for p in watched), NOTICED_S)
            for victim in watched:
                if victim.alive():
                    counts[f"{victim.name}, {kind}: went on"] += 1
                    continue
                told, wrong = said_well(victim, before[victim.name], folder)
                counts[f"{victim.name}, {kind}: {told}"] += 1
                traffic.wrong += wrong
                again = lines(victim)
                victim.start()
                if victim.wait(NOTICED_S):
                    told, wrong = said_well(victim, again, folder)
                    counts[f"{victim.name}, {kind}, started: {told}"] += 1
                    traffic.wrong += wrong
            traffic.send()
            time.sleep(0.5)
            disk.mend()
            loop.start()
            traffic.arrive()
        wrong = traffic.judged(counts)
        if wrong:
            keep_failed(folder, Path("campaign-disks.json"), f"{service}-{kind}-{left_kb}")
    finally:
        disk.remove()
    return counts, wrong


def main(argv: list[str] | None = None) -> int:
    """Service after service; 1 when something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, default=Path("campaign-disks.json"))
    parser.add_argument("--service", choices=(*SERVICES, WHOLE))
    parser.add_argument("--kind", choices=KINDS)
    args = parser.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if os.geteuid() != 0:
        print("disks: needs root, to mount", file=sys.stderr)
        return 2
    page = Path(tempfile.mkdtemp()) / "disk"
    page.write_bytes(bytes(4096))
    preloaded(__spec__.name, sys.argv[1:] if argv is None else argv, WYNER_DISK=str(page))
    every = [
        (service, kind, kb)
        for kind in KINDS
        for service in (*SERVICES, WHOLE)
        for kb in (SMALL_KB if kind == "full" else range(3) if kind == "turned" else (0,))
        if args.service in (None, service)
        and args.kind in (None, kind)
        and (kind == "turned" or service != WHOLE)
    ]
    results = Results(args.results, {"tried": 0})
    for one in every[results.done["tried"] :]:
        with tempfile.TemporaryDirectory() as folder:
            counts, wrong = one_run(*one, Path(folder))
        results.done["tried"] += 1
        results.add(" ".join(map(str, one)), counts, wrong)
        results.save(f"{results.done['tried']} of {len(every)}")
    return results.exit_code


if __name__ == "__main__":
    sys.exit(main())
