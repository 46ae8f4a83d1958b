"""A thread that makes and keeps keys, so that the loop never waits for a disk or a matrix."""

import queue
import sys
import threading
from collections.abc import Callable
from typing import Final

from protocol.secret.blocks import Closed
from protocol.secret.keeper import Keeper
from protocol.secret.records import StoreError
from protocol.secret.tasks import Broken, Done, Judged, Task


def work(keeper: Keeper, task: Task) -> Done:
    """Do one task; whoever has no thread to spare calls this."""
    try:
        if isinstance(task, Closed):
            return keeper.keep(task)
        keeper.judge(task.session, task.judgement)
        number = task.judgement.number
        row = keeper.store.block_tag(task.session, number)
        return Judged(task.session, number, task.judgement.what, 0 if row is None else row.keys)
    except StoreError as error:
        return Broken(str(error))


SWITCH_S: Final = 2e-4
"""How long the loop's thread may wait for this one to let go of the interpreter; Python's own five
milliseconds would be ten steps in lock-step."""

REST_S: Final = 2.5e-4
"""Pause after each slice of an extraction, of about 0.1 ms: most of the time the loop finds the
interpreter free."""


class KeyWorker:
    """Works off tasks in order in a thread of its own.

    Parameters
    ----------
    keeper : Keeper
    done : callable
        Told of each task's end, from that thread.
    """

    def __init__(self, keeper: Keeper, done: Callable[[Done], None]) -> None:
        self._keeper = keeper
        keeper.rest_s = REST_S
        self._done = done
        self._tasks: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        sys.setswitchinterval(SWITCH_S)
        self._thread = threading.Thread(target=self._run, name="keys", daemon=True)
        self._thread.start()

    def put(self, task: Task) -> None:
        """Hand over a task; returns at once."""
        self._tasks.put(task)

    def close(self) -> None:
        """Finish what was handed over, and close the store."""
        self._tasks.put(None)
        self._thread.join()
        self._keeper.store.close()

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None:
            self._done(work(self._keeper, task))
