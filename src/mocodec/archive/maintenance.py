# pyright: strict
"""Maintenance of an archive: check every recording, remove some, merge archives, rebuild a lost catalogue."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

from .. import api
from ..errors import BadInput, Corrupt, MocodecError
from ..file_range import FileRange
from . import catalogue as catalogue_
from . import encoding, remote, shards
from .building import Builder, Report, make_folder
from .catalogue import Catalogue
from .database import Entry, Recordings, open_archive
from .encoding import Options
from .lock import only_builder
from .rows import Row

COMPARED = ("kind", "frames", "rate", "points", "codec", "bytes")
"""Columns that the header of a `.mocz` says too."""
KEPT = (
    "path", "origin", "format", "mean_error", "max_error", "source_hash", "source_bytes", "source_time_ns", "prior"
)  # fmt: skip
"""Columns that a `.mocz` does not say: a repair takes them from the old catalogue."""

Path_ = str | PathLike[str]


def damage(recordings: Recordings, decode: bool = False) -> Iterator[tuple[str, str]]:
    """Name of each recording that is not what was written, and why. decode: also decode all frames.

    The catalogue must agree: a row with values that cannot be, or with others than its `.mocz` has, is damaged too.
    """
    for row in recordings.rows_or_problems():
        if isinstance(row, tuple):
            yield row[0], f"the catalogue is damaged ({row[1]})"
            continue
        try:
            whole_bytes(recordings.entry_of(row), decode)
        except MocodecError as error:
            yield row.name, str(error).removeprefix(f"{recordings.folder}: {row.name}: ")


def whole_bytes(entry: Entry, decode: bool = False) -> bytes:
    """The bytes of a recording's `.mocz`, after all checks of `damage`. Raises MocodecError."""
    blob = entry.read()
    with api.open(blob) as f:
        f.verify()
        if decode:
            for _ in f:
                pass
        facts = encoding.facts_of(f)
    if encoding.content_hash(blob) != entry.row.content:
        raise Corrupt("these are not the bytes that were written")
    for column in COMPARED:
        if facts[column] != getattr(entry.row, column):
            raise Corrupt(f"the catalogue says {column} {getattr(entry.row, column)}, and the file {facts[column]}")
    return blob


def unused_bytes(recordings: Recordings) -> int:
    """Bytes in shards that no recording uses: of those that were removed or replaced. A merge leaves them out."""
    catalogue = open_archive(recordings.folder).catalogue
    sizes, stored = catalogue.shards(), set[tuple[int, int]]()
    unused = sum(sizes.values()) - len(sizes) * len(shards.HEAD)
    for row in catalogue.rows():
        if (row.shard, row.start) not in stored:
            stored.add((row.shard, row.start))
            unused -= row.stored_bytes + len(shards.entry_head(row.name, row.stored_bytes))
    for block in (block for shard in sizes for block in catalogue.blocks(shard)):
        unused -= len(block) + len(shards.entry_head("", len(block)))
    catalogue.close()
    return max(0, unused)


def remove(where: Path_, names: Sequence[str]) -> list[str]:
    """Remove recordings by their names; their bytes stay until the archive is merged. Returns the full names.

    Raises BadInput for an unknown name, and then nothing is removed.
    """
    with only_builder(existing(where)), open_archive(where) as archive:
        whole = [archive.entry(name).row.name for name in names]
        with archive.catalogue.transaction():
            for name in whole:
                archive.catalogue.remove(name)
    return whole


def merge(archives: Sequence[Path_], where: Path_, report_to: Callable[[int, int, str], None] | None = None) -> Report:
    """Copy the recordings of archives into another, which is made if there is none. Bytes are copied as they are.

    A recording that is there already is left alone. Two recordings of one name and other content: the first stays, and
    the other is listed as failed. Merging one archive into a new one leaves out the bytes of removed recordings.
    Raises BadInput, Corrupt, TooNew.
    """
    opened = [open_archive(path) for path in archives]
    folder = remote.local_folder(where, "a change")
    if os.path.abspath(where) in [archive.path for archive in opened]:
        raise BadInput(f"{where}: an archive cannot be merged into itself; name another folder")
    make_folder(folder)
    with only_builder(folder):
        catalogue = Catalogue(folder, create=True)
        try:
            writer = Builder(folder, catalogue, Options(), shards.SHARD_BYTES)
            total, done, seen = sum(map(len, opened)), 0, dict[str, str]()
            with writer:
                for archive in opened:
                    for entry in archive:
                        _copy(entry, writer, seen, archive.catalogue.options(entry.row.options))
                        done += 1
                        if report_to is not None:
                            report_to(done, total, entry.row.name)
        finally:
            catalogue.close()
            for archive in opened:
                archive.close()
    return writer.report


def _copy(entry: Entry, writer: Builder, seen: dict[str, str], options: dict[str, Any]) -> None:
    """Copy one recording, unless the archive has it."""
    row, report = entry.row, writer.report
    there = writer.catalogue.row(row.name)
    content = seen.get(row.name) or (there.content if there is not None else None)
    if content == row.content:
        report.unchanged.append(row.name)
        return
    if content is not None:
        report.failed.append((row.name, f"another recording has this name; {entry.folder} has this one"))
        return
    try:
        blob = entry.read()
    except MocodecError as error:
        report.failed.append((row.name, str(error)))
        return
    if encoding.content_hash(blob) != row.content:
        report.failed.append((row.name, f"{entry.folder}: its bytes are damaged"))
        return
    if row.prior:
        try:
            _copy_prior(Path(entry.folder), row.prior, writer.folder)
        except (OSError, MocodecError) as error:
            report.failed.append((row.name, f"{entry.folder}: its prior {row.prior} cannot be read ({error})"))
            return
    writer.copy(row, blob, options)
    seen[row.name] = row.content
    report.added.append(row.name)


def _copy_prior(source: Path, hash_: str, target: Path) -> None:
    """Copy a prior of one's own. Raises OSError, BadInput; Corrupt if it has another content than its name says."""
    if encoding.keep_prior(target, encoding.prior_path(source, hash_).read_bytes()) != hash_:
        raise Corrupt("its content is not that of its name")


def repair(where: Path_) -> Report:
    """Make a new catalogue from the shards, in place of one that is lost or damaged, which is kept beside it.

    What only the catalogue said, where recordings came from and their errors, is kept where the old catalogue can be
    read and the recording is the same, and lost otherwise: then a build codes the sources again. A recording that the
    shard alone does not give, since its block or a place before it is damaged, is read with the old catalogue. Removed
    recordings come back; of a name that occurs twice, the last stays. Raises BadInput.
    """
    folder = existing(where, "shards")
    with only_builder(folder):
        new, report = folder / "repairing", Report()
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir()
        catalogue, known = Catalogue(new, create=True), _known(folder)
        try:
            with catalogue.transaction():
                for number, path in shards.numbered(folder).items():
                    _recover_shard(catalogue, number, path, known, report)
                missing = {number for number in known.in_shard if not shards.path_of(folder, number).exists()}
                for name, entry in known.entries.items():
                    if entry.row.shard in missing:
                        report.failed.append((name, f"its shard {entry.row.shard:06}.mocs is missing"))
        finally:
            catalogue.close()
        old = folder / catalogue_.NAME
        if old.exists():
            os.replace(old, old.with_suffix(".damaged"))
        old.with_name(f"{old.name}-journal").unlink(missing_ok=True)
        os.replace(new / catalogue_.NAME, old)
        shutil.rmtree(new)
    return report


@dataclass(frozen=True)
class Known:
    """What the old catalogue says: sound recordings by name and by shard, and the options of their coding by name."""

    entries: dict[str, Entry] = field(default_factory=dict[str, Entry])
    in_shard: dict[int, list[Entry]] = field(default_factory=dict[int, list[Entry]])
    options: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])


def _known(folder: Path) -> Known:
    """The recordings of the old catalogue; none if it is damaged."""
    known = Known()
    try:
        with open_archive(folder) as old:
            for row in old.rows_or_problems():
                if not isinstance(row, tuple):
                    known.entries[row.name] = old.entry_of(row)
                    known.options[row.name] = old.catalogue.options(row.options)
    except MocodecError:
        return Known()
    for entry in known.entries.values():
        known.in_shard.setdefault(entry.row.shard, []).append(entry)
    return known


def _recover_shard(catalogue: Catalogue, number: int, path: Path, known: Known, report: Report) -> None:
    """Put the recordings of a shard into the new catalogue: those that it names, then others that are known."""
    counted, blocks, failed = 0, list[bytes](), dict[str, str]()
    problem = ""
    try:
        shards.require_file(path)
        for found in shards.entries(path, blocks):
            counted = found.place.start + found.place.stored_bytes
            try:
                _recover(catalogue, found.name, found.place, found.bytes, known, report)
            except MocodecError as error:
                failed[found.name] = str(error).removeprefix(f"{found.name}: ")
    except Corrupt as error:
        problem = str(error)
    except MocodecError as error:
        report.failed.append((path.name, str(error)))
        return
    is_file = path.is_file() and not path.is_symlink()
    for entry in known.in_shard.get(number, []) if is_file else []:
        row = entry.row
        there = catalogue.row(row.name)
        if there is not None and there.content == row.content:
            continue
        place = shards.Place(row.shard, row.start, row.stored_bytes, row.block)
        try:
            _recover(catalogue, row.name, place, entry.place, known, report, row.content)
        except MocodecError as error:
            failed[row.name] = str(error).removeprefix(f"{entry.folder}: {row.name}: ")
            continue
        failed.pop(row.name, None)
        counted = max(counted, row.start + row.stored_bytes)
        if entry.block is not None:
            blocks += [entry.block] * (row.block - len(blocks))
            blocks[row.block - 1] = entry.block
    if problem:
        report.failed.append((path.name, problem))
    report.failed += failed.items()
    catalogue.put_blocks({number: blocks})
    catalogue.put_shards({number: counted})


def _recover(
    catalogue: Catalogue, name: str, place: shards.Place, source: FileRange, known: Known, report: Report,
    content: str | None = None,
) -> None:  # fmt: skip
    """Put the row of one recording into the new catalogue. content: the hash that it must have. Raises MocodecError."""
    with api.open(source) as file:
        facts = {**encoding.facts_of_name(name), **encoding.facts_of(file)}
    hash_ = encoding.content_hash(encoding.bytes_of(source))
    if content is not None and hash_ != content:
        raise Corrupt("these are not the bytes that were written")
    facts |= {"path": name, "origin": "", "source_hash": "", "source_bytes": 0, "source_time_ns": 0}
    options = Options().stored()
    old = known.entries.get(name)
    if old is not None and old.row.content == hash_:
        facts |= {column: getattr(old.row, column) for column in KEPT}
        options = known.options[name]
    if catalogue.row(name) is None:
        report.added.append(name)
    number = catalogue.option_number(options)
    catalogue.put(Row(**facts, options=number, content=hash_, **asdict(place)))


def existing(where: Path_, needs: str = catalogue_.NAME) -> Path:
    """The folder of an archive. Raises BadInput where there is none."""
    folder = remote.local_folder(where, "a change")
    if not (folder / needs).exists():
        raise BadInput(f"{where}: there is no archive here ({needs} is missing)")
    return folder
