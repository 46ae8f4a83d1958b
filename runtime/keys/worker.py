"""Makes and keeps keys beside a service, so that the loop never waits for a disk or a matrix."""

import os
import pickle
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final, NamedTuple

from protocol.secret.tasks import Broken, Done, Task
from runtime.keys.key_maker import KeyMakerAt

TRIES: Final = 5
"""Deaths over one task after which it is given up, and with it all keys from here on."""

AGAIN_S: Final = 0.05
"""Before a process is started anew; twice as long after each death."""

FINISH_S: Final = 20.0
"""How long a service that ends waits for what is under way; what is left is asked for again."""


class _Asked(NamedTuple):
    at: KeyMakerAt
    task: Task | None
    done: Callable[[Done], None]


class KeyWorker:
    """Has tasks done in order in a process of its own, :mod:`runtime.keys.key_process`.

    The process is started at once, one for all loops of a host, and has its libraries before there
    is a loop to disturb. Where it dies it is started again and asked again: a key maker does what
    it is given twice to the same rows, ids and tags. A thread waits for it, and does nothing else.
    """

    def __init__(self) -> None:
        self._asked: queue.SimpleQueue[_Asked | None] = queue.SimpleQueue()
        self._process: subprocess.Popen[bytes] | None = None
        self._late = False
        self._thread = threading.Thread(target=self._run, name="keys", daemon=True)
        self._thread.start()

    def put(self, at: KeyMakerAt, done: Callable[[Done], None], task: Task) -> None:
        """Hand over a task for a store; returns at once.

        Parameters
        ----------
        at : KeeperAt
        done : callable
            Told of the task's end, from the worker's thread.
        task : Task
        """
        self._asked.put(_Asked(at, task, done))

    def leave(self, at: KeyMakerAt) -> None:
        """Close a store once all that was handed over for it is done; returns at once."""
        self._asked.put(_Asked(at, None, lambda _done: None))

    def close(self) -> None:
        """Finish what was handed over, and end the process."""
        self._asked.put(None)
        self._thread.join(FINISH_S)
        self._late = self._thread.is_alive()
        process = self._process
        if self._late and process is not None:
            process.kill()
            self._thread.join(FINISH_S)

    def _run(self) -> None:
        with suppress(OSError):  # then it is tried again with the first task
            self._process = _start()
        while (asked := self._asked.get()) is not None:
            if asked.task is not None:
                asked.done(self._do(asked))
            elif self._process is not None:
                with suppress(OSError):
                    self._tell(self._process, asked)
        self._end()

    def _do(self, asked: _Asked) -> Done:
        for deaths in range(TRIES):
            try:
                if self._process is None:
                    self._process = _start()
                self._tell(self._process, asked)
                assert self._process.stdout is not None
                done: Done = pickle.load(self._process.stdout)
                return done
            except (OSError, EOFError, pickle.UnpicklingError):
                self._end()
                if self._late:
                    break
                time.sleep(AGAIN_S * 2**deaths)
        return Broken(f"the process that makes keys ended {TRIES} times over one task")

    @staticmethod
    def _tell(process: "subprocess.Popen[bytes]", asked: _Asked) -> None:
        assert process.stdin is not None
        pickle.dump((asked.at, asked.task), process.stdin)
        process.stdin.flush()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        process.wait()  # without its pipe it ends


def _start() -> "subprocess.Popen[bytes]":
    """Start it beyond Ctrl-C's reach, and in this session.

    Linux divides the processors among sessions first (autogroup) and looks at the policy within
    each. In a session of its own the process came before none, but after none either: an offer
    was half a millisecond late while both ends distilled.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "runtime.keys.key_process", str(os.getpid())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        process_group=0,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
