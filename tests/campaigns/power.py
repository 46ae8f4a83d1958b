"""Power failures at chosen instants: ``python -m tests.campaigns.power --images 200``.

A run of both ends is recorded, call by call, by ``strace``: what was written where, and what was
synced. An *image* is what a disk may hold after a power failure at one instant: of each file all
that was synced, and of the writes since then none, all, the first few, or any of them, the last one
torn. Both ends go on from it, as after another boot of the machine, or one end from its image and
the other from all that it wrote. Every message that had been accepted before must arrive; every
message that had been called delivered must be in the plant's trace; and the
rule of messages must hold. What other rules say is counted.
"""

import argparse
import logging
import os
import random
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple
from unittest.mock import patch

from protocol.link.records import Side
from protocol.messages import SendReply
from runtime import journal as journals
from tests.support.mail import Mail
from tests.support.recorded_loop import RecordedLoop
from tests.support.two_ends import SIDES, Name
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

SCENARIO: Final = "sustained"
FIRST: Final = b"0"
MESSAGES: Final = 4
MARKS: Final = "marks"
"""File to which the recorded process writes what it has acknowledged."""

SECTOR: Final = 512
CALLS: Final = "write,pwrite64,fsync,fdatasync,ftruncate,unlink"
JUDGED: Final = ("messages",)
KINDS: Final = ("none", "all", "first", "any", "torn")

_CALL: Final = re.compile(
    r'^(?P<call>\w+)\((?:\d+<|")(?P<path>[^>"]*)[>"](?:, "(?P<data>[^"]*)")?(?:, (?P<one>\d+))?'
    r"(?:, (?P<two>\d+))?\) = \d"
)


class Call(NamedTuple):
    """A write at a place (-1: at the end), a cut to a length, a sync, or the file's end."""

    path: str
    what: str
    place: int = 0
    data: bytes = b""


# --- a run that is recorded -----------------------------------------------------------------------


class _Acknowledging(RecordedLoop):
    """A loop that writes down what its ends acknowledge, once it has."""

    def __init__(self, folder: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        self._marks = os.open(folder / MARKS, flags, 0o600)
        self._told = 0
        super().__init__(folder / "run", FIRST, SCENARIO)

    def said(self, side: Name, message: Mail) -> None:
        super().said(side, message)
        if message.kind is SendReply:
            reply = SendReply.model_validate_json(message.payload)
            assert reply.accepted
            self._mark(f"accepted {reply.id}")

    def step(self, *, extracts: bool = True) -> None:
        super().step(extracts=extracts)
        while self._told < self.delivered:
            self._mark(f"delivered {self._told}")
            self._told += 1

    def _mark(self, what: str) -> None:
        os.write(self._marks, f"{what}\n".encode())


def recorded(folder: Path, seed: int) -> None:
    """The run of a seed: messages are handed over one after the other, or at once."""
    draw = random.Random(seed)
    with patch.object(journals, "CHECKPOINT_PAGES", draw.choice((30, 300, 2000))):
        loop = _Acknowledging(folder)
        for number in range(1, MESSAGES):
            loop.advance(draw.randrange(1, 300))
            loop.queue(f"{number}", f"{number}".encode())
        loop.run(lambda: loop.delivered >= MESSAGES - 1)
        loop.advance(draw.randrange(1, 100))
    os._exit(0)  # nothing is closed


def calls_of(log: Path, folder: Path) -> Iterator[Call]:
    """What the recorded process has written, and synced, below its folder."""
    for line in log.read_text(encoding="ascii").splitlines():
        found = _CALL.match(line)
        path = "" if found is None else _bytes(found["path"]).decode()
        if found is None or not path.startswith(f"{folder}/") or "status" in path:
            continue
        name = path.removeprefix(f"{folder}/")
        if found["call"] == "write":
            yield Call(name, "write", -1, _bytes(found["data"]))
        elif found["call"] == "pwrite64":
            yield Call(name, "write", int(found["two"]), _bytes(found["data"]))
        elif found["call"] == "ftruncate":
            yield Call(name, "cut", int(found["one"]))
        elif found["call"] == "unlink":
            yield Call(name, "gone")
        else:
            yield Call(name, "sync")


def _bytes(shown: str) -> bytes:
    return bytes.fromhex(shown.replace("\\x", ""))


# --- images ---------------------------------------------------------------------------------------


class File:
    """A file as it was synced, and what was done to it since."""

    def __init__(self) -> None:
        self.synced = bytearray()
        self.since: list[Call] = []

    def take(self, call: Call) -> None:
        """Take in the next call."""
        if call.what == "sync":
            self.synced = self.content(self.since)
            self.since = []
        else:
            self.since.append(call)

    def content(self, calls: Sequence[Call]) -> bytearray:
        """What it holds if these calls reached the disk, and no others did."""
        data = bytearray(self.synced)
        end = len(data)  # a write at the end goes where it went, whatever is lost before it
        kept = set(map(id, calls))
        for call in self.since:
            if call.what == "cut":
                end = call.place
                if id(call) in kept:
                    del data[end:]
                continue
            place = end if call.place < 0 else call.place
            end = max(end, place + len(call.data))
            if id(call) in kept:
                data.extend(bytes(max(0, place - len(data))))
                data[place : place + len(call.data)] = call.data
        return data

    def after(self, kind: str, draw: random.Random) -> bytes:
        """What a power failure leaves of it."""
        since = self.since
        if kind in ("none", "all"):
            return bytes(self.content(since if kind == "all" else ()))
        if kind == "any":
            return bytes(self.content([call for call in since if draw.random() < 0.5]))
        first = since[: draw.randrange(len(since) + 1)]
        whole = self.content(first)
        if kind == "torn" and first and first[-1].what == "write":
            before = self.content(first[:-1])
            sectors = {at for at in range(0, len(whole), SECTOR) if draw.random() < 0.5}
            for at in sectors:
                if at < len(before):
                    whole[at : at + SECTOR] = before[at : at + SECTOR]
        return bytes(whole)


class Image(NamedTuple):
    """An image in a folder of its own, and what had been acknowledged before."""

    kind: str
    accepted: list[str]
    delivered: int


def images(
    calls: Sequence[Call], folder: Path, count: int, draw: random.Random
) -> Iterator[tuple[Path, Image]]:
    """Images at instants of which every other one comes soon after an acknowledgement."""
    marks = [i for i, call in enumerate(calls) if call.path == MARKS]
    begun = marks[0] - 1
    instants = [
        min(len(calls), draw.choice(marks) + draw.randrange(1, 6))
        if number % 2
        else draw.randrange(begun, len(calls))
        for number in range(count)
    ]
    files: dict[str, File] = {}
    done = 0
    for number, instant in enumerate(sorted(instants)):
        for call in calls[done:instant]:
            if call.what == "gone":
                files.pop(call.path, None)
            elif call.what != "sync" or call.path in files:  # else a folder's
                files.setdefault(call.path, File()).take(call)
        done = instant
        alone: Side | None = draw.choice((None, None, *SIDES))
        kind = draw.choice(KINDS)
        at = folder / f"{number}"
        for name, file in files.items():
            if name == MARKS:
                continue
            spared = alone is not None and not name.startswith(f"run/{alone}/")
            path = at / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.after("all" if spared else kind, draw))
        told = bytes(files[MARKS].content(files[MARKS].since)).decode().split("\n")[:-1]
        accepted = [line.split()[1] for line in told if line.startswith("accepted")]
        delivered = sum(line.startswith("delivered") for line in told)
        yield at / "run", Image(f"{kind}, {alone or 'both'}", accepted, delivered)


def gone_on(folder: Path, image: Image) -> tuple[Counter[str], list[str]]:
    """Both ends go on from an image; what checks failed, and what was wrong."""
    wrong = []
    loop = RecordedLoop(folder, FIRST, SCENARIO)
    there = {*loop.recovered, *loop.received}
    wrong += [
        f"message {number} was delivered, and is gone"
        for number in range(image.delivered)
        if f"{number}".encode() not in there
    ]
    loop.queue("last", b"last")
    queue = loop.controller.messages
    loop.run(lambda: loop.received == [b"last"] and loop.delivered == queue.queued)
    loop.stop()
    recovered = loop.recovered
    wrong += [
        f"message {name} was accepted, and never arrived"
        for name in image.accepted
        if name.encode() not in recovered
    ]
    found = check(read_evidence(loop.folder))
    wrong += [f"check: {finding}" for finding in found if finding.rule in JUDGED]
    twice = sum(count - 1 for count in Counter(recovered).values())
    counts = Counter(f"check: {name}, {image.kind}" for name in {f.rule for f in found})
    counts[f"images, {image.kind}"] += 1
    counts["messages that came again"] += twice
    return counts, wrong


def one_run(seed: int, folder: Path, count: int) -> tuple[Counter[str], list[str]]:
    """Record a seed's run, and go on from so many images of it."""
    log = folder / "calls"
    recording = folder / "recorded"
    recording.mkdir()
    program = [sys.executable, "-m", __spec__.name, "--record", str(recording), f"--seed={seed}"]
    tracer = ["strace", "-y", "-xx", "-s", "1000000", "-e", f"trace={CALLS}", "-o", str(log)]
    subprocess.run([*tracer, *program], check=True)
    draw = random.Random(seed)
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    boot = folder / "boot"
    boot.write_text("another boot")
    with patch.object(journals, "BOOT_ID", boot):
        calls = list(calls_of(log, recording))
        for number, (path, image) in enumerate(images(calls, folder / "images", count, draw)):
            try:
                more, said = gone_on(path, image)
            except Exception as error:
                more, said = Counter(), [f"{type(error).__name__}: {error}"]
            counts += more
            wrong += [f"image {number} ({image.kind}): {line}" for line in said]
    return counts, wrong


def main(argv: list[str] | None = None) -> int:
    """Images of run after run; 1 when something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--of-a-run", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.record is not None:
        recorded(args.record, args.seed)
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    for seed in range(args.seed, args.seed - (-args.images // args.of_a_run)):
        with tempfile.TemporaryDirectory() as folder:
            more, said = one_run(seed, Path(folder), args.of_a_run)
        counts += more
        wrong += [f"run {seed}, {line}" for line in said]
    for name, number in sorted(counts.items()):
        print(f"{number:>6} {name}")
    print(*wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    logging.disable()
    sys.exit(main())
