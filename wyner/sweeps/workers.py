"""Who works off the tasks of sweeps and studies: this process, some processes, or Dask's."""

import importlib
import logging
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from multiprocessing.process import BaseProcess
from typing import Any, Final, TypeVar

from runtime.command import end_if_told
from runtime.errors import FAILED, Failure, UsageError, needs

AHEAD: Final = 256
"""Tasks that the workers are given beyond the one that is waited for."""

Task = TypeVar("Task")
Answer = TypeVar("Answer")


class SerialExecutor(Executor):
    """Runs each call at once, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run ``fn`` now."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def in_order(
    executor: Executor,
    work: Callable[..., Answer],
    tasks: Iterable[Task],
    arguments: Callable[[Task], tuple[Any, ...]],
) -> Iterator[tuple[Task, Answer]]:
    """Each task with what ``work`` makes of its arguments, in the order of the tasks.

    A task is asked for when there is room for it among those under way.
    """
    ahead = 1 if isinstance(executor, SerialExecutor) else AHEAD
    under_way: deque[tuple[Task, Future[Answer]]] = deque()
    for task in tasks:
        under_way.append((task, executor.submit(work, *arguments(task))))
        end_if_told()
        if len(under_way) >= ahead:
            oldest, future = under_way.popleft()
            yield oldest, future.result()
    for task, future in under_way:
        yield task, future.result()


def _begin_worker() -> None:
    """A worker leaves Ctrl-C to the process that started it, and ends when that one does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(FAILED)


@contextmanager
def workers(jobs: int, dask: str | None = None) -> Iterator[Executor]:
    """An executor of the tasks; tasks not yet running are dropped when it closes early.

    Parameters
    ----------
    jobs : int
        Processes; with one, it is this process.
    dask : str, optional
        The address of a running Dask scheduler; empty for a local cluster of ``jobs`` workers.

    Raises
    ------
    UsageError
        When Dask is not installed.
    Failure
        When there is no such scheduler.
    """
    executor: Executor
    if dask is not None:
        with _dask_executor(jobs, dask) as executor:
            yield executor
        return
    if jobs == 1:
        yield SerialExecutor()
        return
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker)
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    executor.shutdown()


@contextmanager
def _dask_executor(jobs: int, scheduler: str) -> Iterator[Executor]:
    """Workers of a running scheduler, or ``jobs`` processes of a local cluster."""

    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise UsageError(needs("--dask", "distributed")) from None
    with ExitStack() as stack:
        if not scheduler:
            # Worker processes take over that Ctrl-C is ignored, and leave it to this one.
            before = signal.signal(signal.SIGINT, signal.SIG_IGN)
            try:
                cluster = distributed.LocalCluster(
                    n_workers=jobs,
                    threads_per_worker=1,
                    dashboard_address=None,
                    host="127.0.0.1",
                    # A worker whose scheduler ends first writes a traceback as an error.
                    silence_logs=logging.CRITICAL,
                )
                client = distributed.Client(stack.enter_context(cluster))
            finally:
                signal.signal(signal.SIGINT, before)
        else:
            try:
                client = distributed.Client(scheduler, timeout="10s")
            except (OSError, ValueError) as error:
                reason = str(error).splitlines()[0]
                raise Failure(f"--dask: {scheduler}: {reason}") from None
        stack.enter_context(client)
        executor = client.get_executor()
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)  # cancels what is left, nothing after a whole sweep
