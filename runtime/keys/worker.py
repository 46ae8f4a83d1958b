"""Makes keys in a process beside the service, so the loop waits for no disk and no matrix."""

import os
import pickle
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final, NamedTuple

from protocol.secret.tasks import Broken, Done, Task
from runtime.child import Child
from runtime.keys.key_maker import KeyMakerAt

TRIES: Final = 5
"""Deaths of the process over one task after which no more keys are made."""

AGAIN_S: Final = 0.05
"""Seconds before the process is started again; twice as long after each death."""

FINISH_S: Final = 20.0
"""Seconds that a service that ends waits for tasks under way. The next start repeats the others."""


class _Asked(NamedTuple):
    at: KeyMakerAt
    task: Task | None
    done: Callable[[Done], None]


class KeyWorker:
    """Has tasks done in order in a process of its own, :mod:`runtime.keys.key_process`.

    One process serves all loops of a host. It starts at once, so its libraries are loaded before
    there is a loop to disturb. If it dies it is started again and its task repeated, which gives
    the same rows, ids and tags. One thread waits for it.
    """

    def __init__(self) -> None:
        self._asked: queue.SimpleQueue[_Asked | None] = queue.SimpleQueue()
        self._process: Child | None = None
        self._late = False
        self._thread = threading.Thread(target=self._run, name="keys", daemon=True)
        self._thread.start()

    def put(self, at: KeyMakerAt, done: Callable[[Done], None], task: Task) -> None:
        """Hand over a task for a store; returns at once.

        Parameters
        ----------
        at : KeyMakerAt
            The store.
        done : callable
            Called with the result, in the worker's thread.
        task : Task
            What to do.
        """
        self._asked.put(_Asked(at, task, done))

    def leave(self, at: KeyMakerAt) -> None:
        """Close a store once its tasks are done; returns at once."""
        self._asked.put(_Asked(at, None, lambda _done: None))

    def close(self) -> None:
        """Finish the tasks and end the process. It is killed where that takes more than 20 s."""
        self._asked.put(None)
        self._thread.join(FINISH_S)
        self._late = self._thread.is_alive()
        process = self._process
        if self._late and process is not None:
            process.end(0.0)
            self._thread.join(FINISH_S)

    def _run(self) -> None:
        with suppress(OSError):  # then it is tried again with the first task
            self._process = _start()
        while (asked := self._asked.get()) is not None:
            if asked.task is not None:
                asked.done(self._do(asked))
            elif self._process is not None:
                with suppress(OSError):
                    self._process.line.send((asked.at, asked.task))
        self._end()

    def _do(self, asked: _Asked) -> Done:
        for deaths in range(TRIES):
            try:
                if self._process is None:
                    self._process = _start()
                self._process.line.send((asked.at, asked.task))
                done: Done = self._process.line.recv()
                return done
            except (OSError, EOFError, pickle.UnpicklingError):
                self._end()
                if self._late:
                    break
                time.sleep(AGAIN_S * 2**deaths)
        return Broken(f"the process that makes keys ended {TRIES} times over one task")

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.end()


def _start() -> Child:
    return Child("runtime.keys.key_process", (str(os.getpid()),))
