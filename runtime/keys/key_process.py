"""The process that makes and stores a service's keys, behind the loops of the machine.

:class:`runtime.keys.worker.KeyWorker` starts it and writes tasks to its standard input, so no nonce
stands in a command line or a file. It leaves no core file, and dies with the service, whatever ends
that one: two processes on one store would not keep its blocks in order.
"""

import os
import sys
from contextlib import suppress
from typing import Final

from protocol.secret.galois import tables
from protocol.secret.records import StoreError
from protocol.secret.tasks import Broken, Done, Task
from runtime.child import Line, die_with, ignore_signals, leave_no_image, take_line
from runtime.keys.key_maker import KeyMaker, KeyMakerAt, work

NICENESS: Final = 10
"""On a full machine it then gets a tenth of what a loop gets. With the least that there is, keys
came a minute late there."""


def step_back() -> None:
    """Let the loops go first, and wake up in nobody's place (SCHED_BATCH).

    A service that is nice itself keeps its priority here.
    """
    if os.getpriority(os.PRIO_PROCESS, 0) > 0:
        return
    with suppress(OSError):
        os.nice(NICENESS)
    if sys.platform == "linux":
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def keep_all(line: Line) -> None:
    """Do one task after another until nobody asks any more."""
    key_makers: dict[KeyMakerAt, KeyMaker] = {}
    while True:
        try:
            at, task = line.recv()
        except EOFError:
            break
        if task is not None:
            line.send(_done(key_makers, at, task))
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
    ignore_signals()
    leave_no_image()
    line = take_line()
    die_with(int(sys.argv[1]))
    tables()  # what takes long is done before there is a loop to disturb
    step_back()
    with suppress(BrokenPipeError):
        keep_all(line)


if __name__ == "__main__":
    main()
