# pyright: strict
"""Tasks through an executor: few at a time in memory, and a worker that dies costs at most the task that kills it.

Any `concurrent.futures.Executor` does: processes of this machine (`processes`), a Dask cluster (`dask_cluster`).
"""

from __future__ import annotations

import os
import signal
import threading
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context, parent_process
from typing import Any, TypeVar

from ..errors import BadInput, MissingExtra

Task = TypeVar("Task")
Result = TypeVar("Result")
THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "MOCODEC_THREADS")
"""Environment variables that keep each worker process to one thread."""
AHEAD = 4
"""Tasks in flight for each worker: enough that none waits."""


class Processes:
    """A pool of processes, made when it is first used, and again after a process has died."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self.pool: ProcessPoolExecutor | None = None

    def executor(self, workers: int | None = None) -> ProcessPoolExecutor:
        if self.pool is None:
            before = {name: os.environ.get(name) for name in THREAD_LIMITS}
            os.environ.update(dict.fromkeys(THREAD_LIMITS, "1"))
            try:
                self.pool = ProcessPoolExecutor(
                    workers or self.workers, mp_context=get_context("spawn"), initializer=_quiet
                )
                for _ in range(workers or self.workers):
                    self.pool.submit(os.getpid)  # a process starts with a task: now, in this environment
            finally:
                for name, value in before.items():
                    if value is None:
                        os.environ.pop(name, None)
                    else:
                        os.environ[name] = value
        return self.pool

    def close(self) -> None:
        if self.pool is not None:
            pool, self.pool = self.pool, None
            pool.shutdown(wait=True, cancel_futures=True)


def _quiet() -> None:
    """Set up a worker: it ignores interrupts, hides readers' warnings, and ends with the main process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def results(
    work: Callable[[Task], Result],
    tasks: Iterable[Task],
    failed: Callable[[str], Result],
    workers: int = 1,
    executor: Executor | None = None,
) -> Iterator[tuple[Task, Result]]:
    """Each task with the result of its work, as they finish.

    executor: where to work; by default in this process, or in `workers` processes. failed: the result of a task whose
    worker died, from the reason. Where tasks share processes that are this function's own, the tasks that were in
    flight are tried again one by one, so that only those fail that end a process by themselves.
    """
    if executor is None and workers <= 1:
        for task in tasks:
            yield task, work(task)
        return
    if executor is not None:
        yield from _through(lambda: executor, work, iter(tasks), failed, AHEAD * max(workers, 8), None)
        return
    processes = Processes(workers)
    try:
        yield from _through(processes.executor, work, iter(tasks), failed, AHEAD * workers, processes)
    finally:
        processes.close()


def _through(
    executor: Callable[[], Executor],
    work: Callable[[Task], Result],
    tasks: Iterator[Task],
    failed: Callable[[str], Result],
    most: int,
    processes: Processes | None,
) -> Iterator[tuple[Task, Result]]:
    running: dict[Future[Result], Task] = {}
    suspects: list[Task] = []
    is_more = True
    while is_more or running:
        while is_more and len(running) < most and not suspects:
            task = next(tasks, None)
            if task is None:
                is_more = False
            else:
                try:
                    running[executor().submit(work, task)] = task
                except BrokenExecutor:
                    suspects.append(task)
        for future in wait(running, return_when=FIRST_COMPLETED).done if running else ():
            task = running.pop(future)
            try:
                yield task, future.result()
            except BrokenExecutor as error:
                if processes is None:
                    raise BadInput(f"the executor ended: {error}") from error
                suspects.append(task)
            except (BadInput, KeyboardInterrupt):
                raise
            except Exception as error:
                yield task, failed(f"{type(error).__name__}: {error}")
        if suspects and not running and processes is not None:
            processes.close()
            yield from _one_by_one(work, suspects, failed, processes)
            suspects.clear()


def _one_by_one(
    work: Callable[[Task], Result], tasks: list[Task], failed: Callable[[str], Result], processes: Processes
) -> Iterator[tuple[Task, Result]]:
    """Tasks that were in flight when a process died, each alone in a process."""
    for task in tasks:
        try:
            yield task, processes.executor(1).submit(work, task).result()
        except BrokenExecutor:
            processes.close()
            yield task, failed("its process ended unexpectedly; memory may not suffice")
        except Exception as error:
            yield task, failed(f"{type(error).__name__}: {error}")
    processes.close()


@contextmanager
def dask_cluster(address: str) -> Generator[Executor, None, None]:
    """An executor on the Dask cluster whose scheduler has this address. Raises MissingExtra, BadInput."""
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise MissingExtra(f"{address}: working on a Dask cluster", "dask") from None
    try:
        client: Any = distributed.Client(address, timeout="5s")
    except (OSError, ValueError, TimeoutError) as error:
        raise BadInput(f"{address}: there is no Dask scheduler ({error})") from error
    with client:
        yield client.get_executor(pure=False)
