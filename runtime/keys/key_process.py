"""The process that makes and stores a service's keys, where a core is idle.

:class:`runtime.keys.worker.KeyWorker` starts it and writes tasks to its standard input, so no nonce
stands in a command line or a file. It leaves no core file, and dies with the service, whatever ends
that one: two processes on one store would not keep its blocks in order.
"""

import ctypes
import os
import pickle
import resource
import signal
import sys
from contextlib import suppress
from typing import BinaryIO, Final

from protocol.secret.galois import tables
from protocol.secret.records import StoreError
from protocol.secret.tasks import Broken, Done, Task
from runtime.keys.key_maker import KeyMaker, KeyMakerAt, work

_PR_SET_PDEATHSIG: Final = 1
_PR_SET_DUMPABLE: Final = 4


def die_with(parent: int) -> None:
    """End this process when ``parent`` ends, and allow no image of its memory."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        libc = ctypes.CDLL(None)
        libc.prctl(_PR_SET_DUMPABLE, 0)
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def step_back() -> None:
    """Run only where a core is idle (SCHED_IDLE).

    A service that is nice itself keeps its priority here: on a full machine its keys would else
    never be made.
    """
    if os.getpriority(os.PRIO_PROCESS, 0) > 0:
        return
    with suppress(OSError):
        os.nice(19)
    if sys.platform == "linux":
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def keep_all(asked: BinaryIO, told: BinaryIO) -> None:
    """Do one task after another until the input ends."""
    key_makers: dict[KeyMakerAt, KeyMaker] = {}
    while True:
        try:
            at, task = pickle.load(asked)
        except (EOFError, pickle.UnpicklingError):
            break
        if task is not None:
            pickle.dump(_done(key_makers, at, task), told)
            told.flush()
        elif at in key_makers:
            key_makers.pop(at).store.close()
    for key_maker in key_makers.values():
        key_maker.store.close()


def _done(key_makers: dict[KeyMakerAt, KeyMaker], at: KeyMakerAt, task: Task) -> Done:
    try:
        if at not in key_makers:
            key_makers[at] = at.open()
        return work(key_makers[at], task)
    except StoreError as error:
        return Broken(str(error))


def main() -> None:
    """Run as the key maker of the process whose id is the first argument."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends with its service, and not before
    die_with(int(sys.argv[1]))
    tables()  # what takes long is done before there is a loop to disturb
    step_back()
    with suppress(BrokenPipeError):
        keep_all(sys.stdin.buffer, sys.stdout.buffer)


if __name__ == "__main__":
    main()
