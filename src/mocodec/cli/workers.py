"""Worker processes for many files: each works on one file at a time and reports its progress over a pipe.

A worker that dies (out of memory, killed) fails its file only, and another takes its place. When the command ends or is
stopped, workers are terminated; they remove what they have not finished.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any

from .. import progress
from . import BAD_INPUT, interrupts, message_and_code
from .display import Display

if TYPE_CHECKING:
    from .journal import Journal

PATIENCE_S = 5.0
"""How long a worker that is told to stop may take before it is killed."""


@dataclass(frozen=True)
class Task:
    """name: for people. source, where: paths, `where` None if nothing is written. output: `where` within its folder."""

    name: str
    source: str
    where: str | None
    output: str | None
    options: dict[str, Any]


class Worker:
    """A process that works on one task at a time; `task` is None while it waits."""

    def __init__(self, command: str) -> None:
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(command, theirs), daemon=True)
        self.process.start()
        theirs.close()
        self.task: Task | None = None
        self.begun = 0.0

    def give(self, task: Task) -> None:
        self.task, self.begun = task, time.monotonic()
        self.connection.send(task)

    def stop(self) -> None:
        """Terminate the process if it still runs."""
        self.connection.close()
        self.process.terminate()
        self.process.join(PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def run_tasks(
    command: str, tasks: Sequence[Task], jobs: int, display: Display, journal: Journal | None
) -> Iterator[tuple[Task, dict[str, Any]]]:
    """Each task with its record, as they finish, in at most `jobs` processes."""
    waiting = list(reversed(tasks))
    workers: list[Worker] = []
    try:
        while waiting or any(worker.task for worker in workers):
            while waiting and len(workers) < jobs:
                workers.append(Worker(command))
            for worker in workers:
                if worker.task is None and waiting:
                    task = waiting.pop()
                    if journal and task.output:
                        journal.begin(task.output)
                    display.start(task.name)
                    with suppress(OSError):  # if the worker died between two files, the loop below notes it
                        worker.give(task)
            for ready in wait([worker.connection for worker in workers]):
                worker = next(w for w in workers if w.connection is ready)
                yield from _take_message(worker, workers, display)
    finally:
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.stop()


def _take_message(worker: Worker, workers: list[Worker], display: Display) -> Iterator[tuple[Task, dict[str, Any]]]:
    """Take a message of a worker: progress, a record, or its end."""
    task = worker.task
    try:
        message = worker.connection.recv()
    except (EOFError, OSError):
        workers.remove(worker)
        worker.stop()
        if task is not None:
            reason = f"its process ended unexpectedly (exit code {worker.process.exitcode}); memory may not suffice"
            yield task, {"status": "failed", "code": BAD_INPUT, "reason": reason}
        return
    if isinstance(message, float):
        if task is not None:
            display.advance(task.name, message)
    elif task is not None:
        worker.task = None
        yield task, {**message, "seconds": round(time.monotonic() - worker.begun, 3)}


def serve(command: str, connection: Connection) -> None:
    """The main function of a worker: works on tasks until the pipe closes."""
    interrupts.install(ignore_keyboard=True)
    warnings.simplefilter("ignore")
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (until the process ends): nothing but the parent prints
    one = import_module(f"mocodec.cli.{command}").one
    try:
        while True:
            task: Task = connection.recv()
            connection.send(_record(one, task, connection))
    except (EOFError, OSError, KeyboardInterrupt):
        interrupts.leave_quietly()


def _record(one: Any, task: Task, connection: Connection) -> dict[str, Any]:
    try:
        with progress.listening(connection.send):
            return {"status": "done", **one(task.source, task.where, **task.options)}
    except BrokenPipeError:
        raise
    except Exception as error:
        reason, code = message_and_code(error)
        reason = " ".join(reason.split()).removeprefix(f"{task.source}: ")  # the summary names the file
        return {"status": "failed", "code": code, "reason": reason}
