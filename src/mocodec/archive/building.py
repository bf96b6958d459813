# pyright: strict
"""Sources to an archive: new and changed ones are coded, appended to a shard, and committed to the catalogue.

    sources ─names─► tasks (those not done) ─pool─► .mocz ─► shard ─flush─► catalogue (one transaction)

A builder that is killed at any moment loses what it has not committed, a few seconds of work; the next one leaves the
uncommitted bytes where they are and goes on in another shard. Only one builder works on an archive at a time; readers
are not disturbed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

from ..errors import BadInput, MocodecError
from . import encoding, pool, remote, shards, sources
from .catalogue import Catalogue
from .encoding import Options, Outcome, Task
from .lock import only_builder
from .rows import Row
from .shards import Place
from .sources import Source

COMMIT_SECONDS = 2.0
"""How long results wait for their transaction at most: the work that a power cut may cost."""
COMMIT_BYTES = 64 << 20


@dataclass
class Report:
    """Names of the recordings that were added, replaced, or unchanged since an earlier run, and (path, reason) of the
    sources that failed. frames, seconds: how many frames were coded, and for how long."""

    added: list[str] = field(default_factory=list[str])
    replaced: list[str] = field(default_factory=list[str])
    unchanged: list[str] = field(default_factory=list[str])
    failed: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    frames: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class Planned:
    """A task with the name of its recording and the row of that name, if there is one."""

    task: Task
    name: str
    before: Row | None


def build(
    arguments: str | PathLike[str] | Sequence[str | PathLike[str]],
    where: str | PathLike[str],
    options: Options | None = None,
    *,
    workers: int = 1,
    executor: Executor | None = None,
    prefix: str = "",
    prior: str | PathLike[str] | None = None,
    shard_bytes: int = shards.SHARD_BYTES,
    report_to: Callable[[int, int, str], None] | None = None,
) -> Report:
    """Put recordings into an archive, which is made if there is none; recordings that it has already stay as they are.

    arguments: files, folders, globs, .zip and .tar files, URLs. where: the folder of the archive. options: by default
    those of the archive's last build. workers: processes to work in; or any executor, such as that of a Dask client.
    prefix: before the names, such as "lab/". prior: file of a prior of your own (`mocodec prior train`), of which the
    archive keeps a copy. shard_bytes: when to begin another shard. report_to: is called after each
    source with the number done, the number of all, and a path.
    A source that fails is listed in the report and in the catalogue, and tried again by the next build.
    Raises BadInput if the archive cannot be written or another process is building it; TooNew, Corrupt.
    """
    started, folder = time.monotonic(), remote.local_folder(where, "a change")
    many = [arguments] if isinstance(arguments, str | PathLike) else arguments
    if options is not None:
        encoding.require_options(options)
    found = sources.find([str(argument) for argument in many])
    make_folder(folder)
    with only_builder(folder):
        catalogue = Catalogue(folder, create=True)
        try:
            chosen = options if options is not None else last_options(catalogue)
            if prior is not None:
                chosen = replace(chosen, prior=encoding.keep_prior(folder, read_prior(prior)))
            writer = Builder(folder, catalogue, chosen, shard_bytes)
            tasks = list(writer.planned(found, prefix))
            by_task = {id(planned.task): planned for planned in tasks}
            done = len(found) - len(tasks)
            with writer:
                for task, outcome in pool.results(
                    encoding.encode, [p.task for p in tasks], lambda why: Outcome(reason=why), workers, executor
                ):
                    writer.take(by_task[id(task)], outcome)
                    done += 1
                    if report_to is not None:
                        report_to(done, len(found), task.source.path)
        finally:
            catalogue.close()
    writer.report.seconds = time.monotonic() - started
    return writer.report


def read_prior(path: str | PathLike[str]) -> bytes:
    """The bytes of a prior's file. Raises BadInput."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from error


def make_folder(folder: Path) -> None:
    """Raises BadInput if the folder of an archive cannot be made, or holds other things."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / "catalogue.sqlite").exists() or (folder / "building.lock").exists():
            return
        if any(folder.iterdir()):
            raise BadInput(f"{folder}: this folder holds other things; name a new folder for the archive")
    except OSError as error:
        raise BadInput(f"{folder}: cannot write here ({error.strerror})") from error


def last_options(catalogue: Catalogue) -> Options:
    """The options of the last build; the defaults in an archive without one. Raises Corrupt."""
    (number,) = catalogue.values("max(options)")
    try:
        return Options(**(catalogue.options(number) if number else {}))
    except TypeError as error:
        raise catalogue.damaged(f"its options {number}") from error


class Builder:
    """Writes an archive whose lock this process holds. A context: leaving it commits the complete recordings."""

    def __init__(self, folder: Path, catalogue: Catalogue, options: Options, shard_bytes: int) -> None:
        self.folder, self.catalogue, self.options = folder, catalogue, options
        self.report = Report()
        catalogue.require_counted()
        with self._disk():
            sizes = catalogue.shards()
            blocks = {number: list(catalogue.blocks(number)) for number in [max(sizes, default=0)] if number}
            self.appender = shards.Appender(folder, sizes, blocks, shard_bytes)
        self.waiting: list[Row] = []
        self.failures: list[tuple[str, str, str]] = []
        self.places: dict[str, Place] = {}
        """Where the recordings of `waiting` are, by the hash of their content."""
        self.waiting_bytes = 0
        self.committed_at = time.monotonic()
        with catalogue.transaction():
            self.option_number = catalogue.option_number(options.stored())

    def planned(self, found: Sequence[Source], prefix: str) -> Iterator[Planned]:
        """Tasks: sources that are new, have changed, or were coded with other options."""
        taken: dict[str, str] = {}
        for source in found:
            name, before, problem = self._name(source, prefix, taken)
            if problem:
                self._fail(source, name, problem)
                continue
            taken[name] = source.where
            is_same_coding = before is not None and before.options == self.option_number
            if before is not None and is_same_coding and source.stamp == (before.source_bytes, before.source_time_ns):
                self.report.unchanged.append(name)
                if before.origin != source.where:
                    self.waiting.append(replace(before, origin=source.where))
                continue
            known = before.source_hash if before is not None and is_same_coding else ""
            own = self.options.prior
            prior = str(encoding.prior_path(self.folder.absolute(), own)) if own else None
            yield Planned(Task(source, self.options, known, prior), name, before)

    def _name(self, source: Source, prefix: str, taken: dict[str, str]) -> tuple[str, Row | None, str]:
        """The name of a source's recording, its row if there is one, and a problem: without the suffix of the path if
        that name is free or its own already, otherwise with it."""
        whole = prefix + source.path
        short = whole.removesuffix(Path(source.path).suffix) if source.stamp != sources.FOLDER else whole
        for name in (short, whole):
            row = self.catalogue.row(name)
            if taken.get(name, source.where) == source.where and (row is None or self._is_of(row, source)):
                return name, row, ""
        return whole, None, f"there is a recording named {whole} from elsewhere; remove it, or choose a prefix"

    def _is_of(self, row: Row, source: Source) -> bool:
        """Whether a row is that of a source, which may have moved with its folder: then it is the same, to the byte.

        A repaired catalogue knows no origins; there the name decides."""
        if not row.origin:
            return True
        if row.origin == source.where or row.path != source.path:
            return row.origin == source.where
        try:
            with sources.local(source) as path:
                return encoding.hash_of(path) == row.source_hash
        except (MocodecError, OSError):
            return False

    def take(self, planned: Planned, outcome: Outcome) -> None:
        """Add the outcome of a task; commits if the last commit is some time ago."""
        source, before = planned.task.source, planned.before
        if outcome.reason:
            self._fail(source, planned.name, outcome.reason)
        elif not outcome.blob:
            assert before is not None
            self.report.unchanged.append(planned.name)
            self.waiting.append(
                replace(before, origin=source.where, source_bytes=source.stamp[0], source_time_ns=source.stamp[1])
            )
        else:
            self.add(planned.name, source, outcome)
            (self.report.added if before is None else self.report.replaced).append(planned.name)
        self._commit_in_time()

    def _commit_in_time(self) -> None:
        if self.waiting_bytes > COMMIT_BYTES or time.monotonic() - self.committed_at > COMMIT_SECONDS:
            self.commit()

    def add(self, name: str, source: Source, outcome: Outcome) -> None:
        """Append a `.mocz` to the shard and prepare its row. Bytes that the archive has are not stored again."""
        content = encoding.content_hash(outcome.blob)
        facts: dict[str, Any] = {**encoding.facts_of_name(name), **outcome.facts, "source_hash": outcome.source_hash}
        facts |= {"path": source.path, "origin": source.where, "content": content, "options": self.option_number}
        facts |= {"source_bytes": source.stamp[0], "source_time_ns": source.stamp[1]}
        self.waiting.append(Row(**facts, **asdict(self.place(name, content, outcome.blob))))
        self.report.frames += outcome.facts.get("frames", 0)

    def copy(self, row: Row, blob: bytes, options: Mapping[str, Any]) -> None:
        """Append the `.mocz` of another archive, with its row there and the options that it was coded with."""
        place = self.place(row.name, row.content, blob)
        with self.catalogue.transaction():
            number = self.catalogue.option_number(options)
        self.waiting.append(replace(row, options=number, **asdict(place)))
        self._commit_in_time()

    def place(self, name: str, content: str, blob: bytes) -> Place:
        """Where the archive has a `.mocz` with this hash, which is appended if it does not have it."""
        if content in self.places:
            return self.places[content]
        same = next(self.catalogue.rows("content = ?", [content]), None)
        if same is not None:
            return Place(same.shard, same.start, same.stored_bytes, same.block)
        with self._disk():
            self.places[content] = self.appender.append(name, blob)
        self.waiting_bytes += len(blob)
        return self.places[content]

    def _fail(self, source: Source, name: str, reason: str) -> None:
        self.report.failed.append((source.path, reason))
        self.failures.append((source.path, name, reason))

    def commit(self) -> None:
        """Put complete recordings into the catalogue: first their bytes on the disk, then one transaction."""
        if self.waiting or self.failures:
            with self._disk():
                self.appender.flush()
            with self.catalogue.transaction():
                for row in self.waiting:
                    self.catalogue.put(row)
                for failure in self.failures:
                    self.catalogue.put_failure(*failure)
                self.catalogue.put_blocks(self.appender.blocks)
                self.catalogue.put_shards(self.appender.sizes)
        self.waiting, self.failures, self.waiting_bytes = [], [], 0
        self.places.clear()
        self.committed_at = time.monotonic()

    def _disk(self) -> _Disk:
        return _Disk(self.folder)

    def __enter__(self) -> Builder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Commit complete recordings, also after an interruption; not after an error of the disk."""
        try:
            if kind is None or not issubclass(kind, BadInput):
                self.commit()
        finally:
            with self._disk():
                self.appender.close()


class _Disk:
    """Turns errors of the disk into one line that says which recordings are safe."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if isinstance(error, OSError):
            raise BadInput(
                f"{self.folder}: cannot write ({error.strerror}); what was committed is safe, and the same command "
                "goes on from there"
            ) from error
