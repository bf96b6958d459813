# pyright: strict
"""Maintenance of an archive: check every recording, remove some, merge archives, rebuild a lost catalogue."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
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

Path_ = str | PathLike[str]


def damage(recordings: Recordings, decode: bool = False) -> Iterator[tuple[str, str]]:
    """Name of each recording whose bytes are not what was written, and why. decode: also decode all frames."""
    for entry in recordings:
        try:
            blob = entry.read()
            with api.open(blob) as f:
                f.verify()
                if decode:
                    for _ in f:
                        pass
            if encoding.content_hash(blob) != entry.row.content:
                raise Corrupt("these are not the bytes that were written")
        except MocodecError as error:
            yield entry.row.name, str(error).removeprefix(f"{entry.place.label}: ")


def unused_bytes(recordings: Recordings) -> int:
    """Bytes in shards that no recording uses: of those that were removed or replaced. A merge leaves them out."""
    catalogue = open_archive(recordings.folder).catalogue
    sizes, stored = catalogue.shards(), set[tuple[int, int]]()
    unused = sum(sizes.values()) - len(sizes) * len(shards.HEAD)
    for row in catalogue.rows():
        if (row.shard, row.start) not in stored:
            stored.add((row.shard, row.start))
            unused -= row.bytes + len(shards.entry_head(row.name, row.bytes))
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
        encoding.keep_prior(writer.folder, encoding.prior_path(Path(entry.folder), row.prior).read_bytes())
    writer.copy(row, blob, options)
    seen[row.name] = row.content
    report.added.append(row.name)


def repair(where: Path_) -> Report:
    """Make a new catalogue from the shards, in place of one that is lost or damaged, which is kept beside it.

    What only the catalogue said is lost: where recordings came from, and their errors; so a build codes the sources
    again. Removed recordings come back; of a name that occurs twice, the last stays. Raises BadInput.
    """
    folder = existing(where, "shards")
    with only_builder(folder):
        new, report = folder / "repairing", Report()
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir()
        catalogue = Catalogue(new, create=True)
        try:
            with catalogue.transaction():
                options = catalogue.option_number(Options().stored())
                for path in sorted((folder / shards.FOLDER).glob("*.mocs")):
                    try:
                        for name, place in shards.entries(path):
                            _recover(catalogue, name, place, int(path.stem), options, report)
                    except MocodecError as error:
                        report.failed.append((path.name, str(error)))
                    catalogue.put_shards({int(path.stem): path.stat().st_size})
        finally:
            catalogue.close()
        old = folder / catalogue_.NAME
        if old.exists():
            os.replace(old, old.with_suffix(".damaged"))
        old.with_name(f"{old.name}-journal").unlink(missing_ok=True)
        os.replace(new / catalogue_.NAME, old)
        shutil.rmtree(new)
    return report


def _recover(catalogue: Catalogue, name: str, place: FileRange, shard: int, options: int, report: Report) -> None:
    """Put the row of one entry of a shard into the new catalogue."""
    try:
        with api.open(place) as file:
            facts = {**encoding.facts_of_name(name), **encoding.facts_of(file)}
    except MocodecError as error:
        report.failed.append((name, str(error)))
        return
    facts |= {"path": name, "origin": "", "source_hash": "", "source_bytes": 0, "source_time_ns": 0}
    content = encoding.content_hash(encoding.bytes_of(place))
    catalogue.put(catalogue_.Row(**facts, options=options, content=content, shard=shard, start=place.start))
    report.added.append(name)


def existing(where: Path_, needs: str = catalogue_.NAME) -> Path:
    """The folder of an archive. Raises BadInput where there is none."""
    folder = remote.local_folder(where, "a change")
    if not (folder / needs).exists():
        raise BadInput(f"{where}: there is no archive here ({needs} is missing)")
    return folder
