"""What each loop says of itself in its folder: its status, and a line on whether it keeps up.

They are for whoever looks from outside, and no step waits for them: a thread of their own writes
them. One that takes a slow disk 100 ms would else cost every loop of the host a step.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path

from protocol.messages import PlantStatus, Status
from runtime.files import StatusFile
from runtime.liveness import DiskSpace, Liveness
from runtime.run_folder import HEALTH


class HealthFiles:
    """Status, health line and what of both is worth a line in the log, of one end of one loop.

    Parameters
    ----------
    path : Path
        Of the status; the line stands beside it.
    log : logging.Logger
    """

    def __init__(self, path: Path, log: logging.Logger) -> None:
        self._status = StatusFile(path)
        self._line = StatusFile(path.with_name(HEALTH))
        self._pulse = Liveness()
        self._space = DiskSpace(path.parent)
        self.log = log

    def write(self, status: Status, now_s: float) -> None:
        """Replace both, as of a monotonic time.

        The status holds no text, key or coin: whoever may read it need not be on ops.

        Raises
        ------
        OSError
            Where one cannot be written.
        """
        self._status.write(status.on_file())
        missed = status.missed if isinstance(status, PlantStatus) else 0
        beat = self._pulse.beat(now_s, status.transitions, missed)
        self._line.write(f"{beat.line}\n".encode())
        for line, good in ((beat.notice, beat.good), self._space.look()):
            if line:
                self.log.log(logging.INFO if good else logging.WARNING, "%s", line)


class HealthWriter:
    """Writes the files of any number of loops, of each the newest status.

    Parameters
    ----------
    failed : callable
        Told, in the writer's thread, of a loop whose files cannot be written, and why.
    """

    def __init__(self, failed: Callable[[str, Exception], None]) -> None:
        self._failed = failed
        self._closing = False
        self._newest: dict[str, tuple[HealthFiles, Status, float]] = {}
        self._order: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def put(self, loop: str, files: HealthFiles, status: Status) -> None:
        """Have a status written; returns at once. It takes the place of one that still waits."""
        with self._lock:
            if self._thread is None:
                thread = threading.Thread(target=self._run, name="health", daemon=True)
                thread.start()
                self._thread = thread  # started: close() joins no other
            if loop not in self._newest:
                self._order.put(loop)
            self._newest[loop] = files, status, time.monotonic()

    def close(self, within_s: float) -> None:
        """Write what waits, for so many seconds at most, and end."""
        self._closing = True
        if self._thread is not None:
            self._order.put(None)
            self._thread.join(within_s)

    def _run(self) -> None:
        while (loop := self._order.get()) is not None:
            with self._lock:
                files, status, at_s = self._newest.pop(loop)
            try:
                files.write(status, at_s)
            except Exception as error:
                if self._closing:
                    files.log.warning("the last status is lost: %s", error)
                else:
                    self._failed(loop, error)
