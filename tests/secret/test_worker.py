"""Keys made in a process of their own: the same ones, whatever it dies of, and nothing shown."""

import os
import queue
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from protocol.secret.tasks import Broken, Done
from runtime.keys import worker as worker_module
from runtime.keys.key_maker import KeyMaker, KeyMakerAt
from runtime.keys.key_process import NICENESS
from runtime.keys.store import KeyStore
from runtime.keys.worker import KeyWorker

from protocol.secret.blocks import BlockResult, ClosedBlock, Stored
from tests.support.patience import PATIENCE_S

SESSION = "0123456789abcdef"

"""It works where a core is idle, and beside other tests none may be for long."""


def closed(number: int) -> ClosedBlock:
    draw = random.Random(number)
    nonces = tuple(draw.randbytes(32) for _ in range(88))
    return ClosedBlock(SESSION, number, 44, 44, 88, 9, nonces, 44 * (number + 1))


def verdict(number: int) -> BlockResult:
    return BlockResult(SESSION, number, "confirmed")


def made(folder: Path, name: str = "keys") -> KeyMakerAt:
    path = folder / f"{name}.sqlite3"
    KeyStore(path, "plant", create=True).close()
    return KeyMakerAt(path, "plant")


def expected(numbers: range) -> dict[str, bytes | None]:
    with KeyStore(None, "plant") as store:
        key_maker = KeyMaker(store)
        for number in numbers:
            key_maker.make_keys(closed(number))
        return store.compare()


def process_of_keys() -> int | None:
    """The worker's process, as an operator finds it; None where there is none."""
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            command = (path / "cmdline").read_bytes().split(b"\0")
            parent = (path / "stat").read_text().rpartition(")")[2].split()[1]
            if command[1:3] == [b"-m", b"runtime.keys.key_process"] and parent == str(os.getpid()):
                return int(path.name)
    return None


@contextmanager
def working() -> Iterator[tuple[KeyWorker, "queue.SimpleQueue[Done]"]]:
    worker, told = KeyWorker(), queue.SimpleQueue[Done]()
    try:
        yield worker, told
    finally:
        worker.close()


def test_it_makes_what_a_keeper_makes_and_shows_nothing(tmp_path: Path) -> None:
    at, other = made(tmp_path), made(tmp_path, "other")
    with working() as (worker, told):
        worker.put(at, told.put, closed(0))
        assert isinstance(told.get(timeout=PATIENCE_S), Stored)
        pid = process_of_keys()
        assert pid is not None
        for where in (at, other):
            worker.put(where, told.put, closed(1))
            worker.put(where, told.put, verdict(1))
            assert isinstance(told.get(timeout=PATIENCE_S), Stored)
            assert told.get(timeout=PATIENCE_S) == BlockResult(SESSION, 1, "confirmed", 8)
        worker.leave(other)
        worker.put(other, told.put, closed(2))
        assert isinstance(told.get(timeout=PATIENCE_S), Stored)
        assert process_of_keys() == pid  # one for all stores
        # in this session, within which alone Linux looks at policies, and out of Ctrl-C's reach
        assert os.getsid(pid) == os.getsid(0)
        assert os.getpgid(pid) == pid
        process = Path(f"/proc/{pid}")
        (core,) = (x for x in (process / "limits").read_text().splitlines() if "core" in x)
        assert core.split()[4:6] == ["0", "0"]
        own = os.getpriority(os.PRIO_PROCESS, 0) > 0  # then it stays where its service is
        assert os.sched_getscheduler(pid) == (os.SCHED_OTHER if own else os.SCHED_BATCH)
        assert own or os.getpriority(os.PRIO_PROCESS, pid) == NICENESS
        status = (process / "status").read_text().splitlines()
        (resident,) = (int(x.split()[1]) for x in status if x.startswith("VmRSS:"))
        assert resident < 56 * 1024
    assert not process.exists()
    with KeyStore(at.path, "plant") as store:
        assert store.compare() == expected(range(2))


def another(pids: set[int]) -> int:
    """The worker's process, once it is none of those that were killed."""
    until = time.monotonic() + PATIENCE_S
    while (pid := process_of_keys()) is None or pid in pids:
        assert time.monotonic() < until
        time.sleep(0.0005)
    return pid


@pytest.mark.slow
def test_killed_at_any_instant_it_makes_the_same_keys_once(tmp_path: Path) -> None:
    at, blocks = made(tmp_path), range(24)
    draw = random.Random(3)
    pids: set[int] = set()
    with working() as (worker, told):

        def put(number: int) -> None:
            worker.put(at, told.put, closed(number))
            worker.put(at, told.put, verdict(number))

        put(0)
        put(1)
        crashing = draw.sample(range(2, len(blocks)), 6)
        answers: list[Done] = []
        while len(answers) < 2 * len(blocks):
            answers.append(told.get(timeout=PATIENCE_S))
            if len(answers) % 2:
                continue
            following = len(answers) // 2 + 1
            if following in crashing:
                time.sleep(draw.uniform(0.0, 0.006))  # a block takes as long, with its commit
                pid = another(pids)
                pids.add(pid)
                os.kill(pid, signal.SIGKILL)
            if following < len(blocks):
                put(following)  # so whoever was killed with nothing left to do has a successor
    assert len(pids) == 6
    assert not any(isinstance(answer, Broken) for answer in answers)
    with KeyStore(at.path, "plant") as store:
        assert store.compare() == expected(blocks)
        assert store.counts().confirmed == len(expected(blocks))


def test_it_gives_up_in_a_line_where_nothing_can_be_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_module, "AGAIN_S", 0.001)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with working() as (worker, told):
        worker.put(made(tmp_path), told.put, closed(0))
        done = told.get(timeout=PATIENCE_S)
    assert done == Broken("the process that makes keys ended 5 times over one task")


def test_a_store_that_is_gone_breaks_its_own_loop_alone(tmp_path: Path) -> None:
    at = made(tmp_path)
    with working() as (worker, told):
        worker.put(KeyMakerAt(tmp_path / "none", "plant"), told.put, closed(0))
        worker.put(at, told.put, closed(0))
        gone, kept = told.get(timeout=PATIENCE_S), told.get(timeout=PATIENCE_S)
    assert isinstance(gone, Broken)
    assert "no key store is there" in gone.reason
    assert isinstance(kept, Stored)


ORPHAN = """
import sys, time
from tests.secret.test_worker import KeyWorker, closed, made, process_of_keys
from pathlib import Path
worker, at = KeyWorker(), made(Path(sys.argv[1]))
worker.put(at, lambda done: print(process_of_keys(), flush=True), closed(0))
for number in range(1, 10_000):
    worker.put(at, lambda done: None, closed(number))
time.sleep(60)
"""


def test_it_dies_with_whoever_started_it(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ORPHAN, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as service:
        assert service.stdout is not None
        process = Path("/proc") / service.stdout.readline().strip() / "stat"
        service.kill()
    until = time.monotonic() + PATIENCE_S
    while process.exists() and process.read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < until
        time.sleep(0.01)
    with KeyStore(tmp_path / "keys.sqlite3", "plant") as store:
        blocks = store.blocks()
        assert 0 < len(blocks) < 10_000
        assert store.compare() == expected(range(len(blocks)))
