# pyright: strict
"""A prior of one's own from an archive: workers decode recordings and return small arrays, which are added up in order.

    recordings ─facts─► those that can be used ─passes─► sums of each recording ─in order─► prior

Memory does not grow with the recordings, but for one pose in eight, up to 300,000 poses. Each pass decodes the
recordings again. Workers have one thread each, so their sums do not depend on how many there are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

from .. import api
from ..codecs.tempo import training
from ..codecs.tempo.models import prior
from ..errors import BadInput, MocodecError
from ..motion import Motion
from . import pool
from .database import Entry, Recordings

PASSES = 13
"""Times that each recording is decoded: for its facts, then for poses, moments, magnitudes and symbols of positions, of
bones with their rotations, and of directions. Bones have no symbols; directions have aligned poses besides."""


@dataclass(frozen=True)
class Task:
    """Work on one recording. number: its place among all."""

    number: int
    entry: Entry
    priors: str
    work: Callable[[Motion], Any]


def train_prior(
    recordings: Recordings,
    *,
    frames: int | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    report_to: Callable[[int, int, str], None] | None = None,
) -> tuple[bytes, int, int]:
    """The file of a prior, the number of recordings that it is learned from, and that of their frames.

    recordings: of an archive; used are those with rotations, without gaps and leaps, and with one skeleton. frames:
    number to learn from, about, spread over the recordings; None: all. workers: processes; or any executor. The
    result does not depend on their number. report_to: is called with the number done, the number of all, and a name.
    Raises BadInput if too few recordings can be used, or one cannot be read.
    """
    entries = list(recordings.query("kind == 'motion' and rotations == 1"))
    total = sum(entry.row.frames for entry in entries)
    entries = entries[:: max(1, round(total / frames)) if frames else 1]
    processes = pool.Processes(max(1, workers))
    try:
        runs = Runs(entries, recordings.priors, executor or processes.executor(), max(1, workers), report_to)
        found = list(runs.each(training.facts))
        chosen = training.usable(found)
        runs.entries = [entries[i] for i in chosen]
        data = training.own_file(runs.each, [found[i] for i in chosen])
    finally:
        processes.close()
    return data, len(chosen), sum(found[i].frames for i in chosen)


class Runs:
    """Passes over recordings through an executor; `each` is the `training.Each` of the recordings in `entries`."""

    def __init__(
        self,
        entries: Sequence[Entry],
        priors: str,
        executor: Executor,
        workers: int,
        report_to: Callable[[int, int, str], None] | None,
    ) -> None:
        self.entries, self.priors, self.executor, self.workers = entries, priors, executor, workers
        self.report_to = report_to
        self.done = 0

    def each(self, work: Callable[[Motion], Any]) -> Iterator[Any]:
        """The results of a pass, in order; those that come early wait. Raises BadInput."""
        tasks = [Task(number, entry, self.priors, work) for number, entry in enumerate(self.entries)]
        early: dict[int, Any] = {}
        following = 0
        for task, outcome in pool.results(done, tasks, BadInput, self.workers, self.executor):
            if isinstance(outcome, Exception):
                raise BadInput(f"{task.entry.row.name}: {outcome}")
            self.done += 1
            if self.report_to is not None:
                self.report_to(self.done, max(self.done, PASSES * len(self.entries)), task.entry.row.name)
            early[task.number] = outcome
            while following in early:
                yield early.pop(following)
                following += 1


def done(task: Task) -> Any:
    """The result of a task, or the error that a recording cannot be decoded by."""
    if task.priors:
        prior.search_in(task.priors)
    try:
        return task.work(api.decode(task.entry.place, Motion))
    except MocodecError as error:
        return error
