# pyright: strict
"""Where the recordings of an archive come from: files, folders, globs, members of .zip and .tar, URLs of fsspec.

arguments ─find─► sources (name, path, stamp) ─local─► a path on this machine for as long as it is needed
"""

from __future__ import annotations

import glob
import os
import re
import shutil
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import PurePosixPath
from typing import IO, Any

from ..container.remote_sources import file_system
from ..errors import BadInput
from ..formats import FORMATS
from ..formats.folders import COMPANIONS, below, fingerprint, mirrored_name

SUFFIXES = (*FORMATS, ".mocz")
PACKED = (".zip", ".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")
URL = re.compile(r"[a-z][a-z0-9+.-]+://", re.IGNORECASE)


@dataclass(frozen=True)
class Source:
    """path: relative, with "/", as the catalogue shows it. origin: the file, folder of frames, packed file or URL that
    it is in. member: its name in a packed file. companions: names beside it there. stamp: bytes and time of change
    (ns).
    """

    path: str
    origin: str
    member: str = ""
    companions: tuple[str, ...] = ()
    stamp: tuple[int, int] = field(default=(0, 0), compare=False)

    @property
    def where(self) -> str:
        """The origin and the member, for people and to tell sources apart."""
        return f"{self.origin}!{self.member}" if self.member else self.origin

    @property
    def suffix(self) -> str:
        """The suffix, in lower case; "" for a folder."""
        return PurePosixPath(self.path).suffix.lower() if self.stamp != FOLDER else ""


FOLDER = (-1, -1)


def find(arguments: Sequence[str], suffixes: Collection[str] = SUFFIXES) -> list[Source]:
    """The sources that the arguments name, each once, in order of paths; those of a .tar in its order.

    Raises BadInput for what does not exist, or holds nothing that mocodec reads.
    """
    found: dict[str, Source] = {}
    for argument in arguments:
        sources = list(_of_argument(argument, suffixes))
        if not sources:
            raise BadInput(f"{argument}: there is nothing here that mocodec reads")
        found |= {source.where: source for source in sources if source.where not in found}
    return list(found.values())


def _of_argument(argument: str, suffixes: Collection[str]) -> Generator[Source, None, None]:
    if URL.match(argument):
        yield from _of_url(argument, suffixes)
    elif argument.lower().endswith(PACKED) and os.path.isfile(argument):
        yield from _of_packed(argument, suffixes)
    elif os.path.exists(argument):
        base = argument if os.path.isdir(argument) else os.path.dirname(argument)
        for path in sorted(below(argument, suffixes)):
            yield _of_path(path, base)
    elif glob.has_magic(argument):
        base = re.split(r"[*?\[]", argument)[0].rpartition("/")[0]
        for path in sorted(glob.glob(argument, recursive=True)):
            if os.path.splitext(path)[1].lower() in suffixes:
                yield _of_path(path, base)
    else:
        raise BadInput(f"{argument}: no such file or folder")


def _of_path(path: str, base: str) -> Source:
    absolute = os.path.abspath(path)
    stamp = fingerprint(path) or [0, 0]
    return Source(mirrored_name(absolute, os.path.abspath(base)), absolute, stamp=(stamp[0], stamp[1]))


def _of_packed(path: str, suffixes: Collection[str]) -> Generator[Source, None, None]:
    """The members of a .zip or .tar; their paths begin with its name."""
    origin = os.path.abspath(path)
    members = _members(origin, os.stat(origin).st_mtime_ns)
    for name, stamp in members.items():
        if PurePosixPath(name).suffix.lower() in suffixes:
            beside = _companions(name, members)
            yield Source(str(PurePosixPath(name)), origin, name, beside, stamp)


def _companions(name: str, all_names: Collection[str]) -> tuple[str, ...]:
    path = PurePosixPath(name)
    wanted = COMPANIONS.get(path.suffix.lower())
    if wanted is None:
        return ()
    return tuple(n for n in all_names if n.lower().endswith(wanted) and PurePosixPath(n).parent == path.parent)


@lru_cache(maxsize=8)
def _packed(path: str, _: int) -> zipfile.ZipFile | tarfile.TarFile:
    """An open .zip or .tar; the second argument is its time of change. Raises BadInput."""
    try:
        return zipfile.ZipFile(path) if path.lower().endswith(".zip") else tarfile.open(path)
    except (OSError, zipfile.BadZipFile, tarfile.TarError, EOFError) as error:
        raise BadInput(f"{path}: cannot be read ({error})") from error


@lru_cache(maxsize=8)
def _members(path: str, changed: int) -> dict[str, tuple[int, int]]:
    """Bytes and checksum, or time, of each file in a .zip or .tar. Raises BadInput."""
    packed = _packed(path, changed)
    try:
        if isinstance(packed, zipfile.ZipFile):
            return {i.filename: (i.file_size, i.CRC) for i in packed.infolist() if not i.is_dir()}
        return {m.name: (m.size, int(m.mtime * 1e9)) for m in packed if m.isfile()}
    except (OSError, tarfile.TarError, EOFError) as error:
        raise BadInput(f"{path}: cannot be read ({error})") from error


def _of_url(url: str, suffixes: Collection[str]) -> Generator[Source, None, None]:
    """The files that a URL of fsspec names, by a glob or as a folder."""
    files, where = file_system(url)
    try:
        if glob.has_magic(where):
            base = re.split(r"[*?\[]", where)[0].rpartition("/")[0]
            found: dict[str, Any] = files.glob(where, detail=True)
        elif files.isdir(where):
            base, found = where.rstrip("/"), files.find(where, detail=True)
        else:
            base, found = where.rpartition("/")[0], {where: files.info(where)}
    except (OSError, ValueError) as error:
        raise BadInput(f"{url}: {error}") from error
    for name, info in sorted(found.items()):
        if info.get("type") == "file" and PurePosixPath(name).suffix.lower() in suffixes:
            path = name[len(base) :].lstrip("/") or PurePosixPath(name).name
            beside = _companions(name, found)
            origin = files.unstrip_protocol(name)
            yield Source(path, origin, companions=beside, stamp=(int(info.get("size") or 0), _version(info)))


def _version(info: Mapping[str, Any]) -> int:
    """A number that changes with a remote file: of its tag or time of change."""
    facts = [
        str(info.get(key)) for key in ("ETag", "etag", "md5Hash", "mtime", "LastModified", "last_modified", "created")
    ]
    return zlib.crc32(" ".join(facts).encode())


def is_local(source: Source) -> bool:
    """Whether the origin is the source itself, on this machine."""
    return not source.member and not URL.match(source.origin)


@contextmanager
def local(source: Source) -> Generator[str, None, None]:
    """A path of the source on this machine; a copy of a packed or remote source lasts as long as the context."""
    if is_local(source):
        yield source.origin
        return
    with tempfile.TemporaryDirectory(prefix="mocodec-") as folder:
        yield copied(source, folder)


def copied(source: Source, folder: str) -> str:
    """The path in `folder` of a copy of a packed or remote source, with its companions. Raises BadInput."""
    names = [source.member or source.origin, *source.companions]
    try:
        if source.member:
            packed = _packed(source.origin, os.stat(source.origin).st_mtime_ns)
            for name in names:
                with _content(packed, name) as content, open(_copy_path(folder, name), "wb") as file:
                    shutil.copyfileobj(content, file)
        else:
            files, first = file_system(source.origin)
            for name in (first, *source.companions):
                files.get_file(name, _copy_path(folder, name))
    except (OSError, KeyError, RuntimeError, EOFError, zipfile.BadZipFile, tarfile.TarError) as error:
        raise BadInput(f"{source.where}: cannot be read ({error})") from error
    return _copy_path(folder, names[0])


def _content(packed: zipfile.ZipFile | tarfile.TarFile, name: str) -> IO[bytes]:
    if isinstance(packed, zipfile.ZipFile):
        return packed.open(name)
    member = packed.extractfile(name)
    assert member is not None  # links and folders are no members that `_members` lists
    return member


def _copy_path(folder: str, name: str) -> str:
    """The last part of this name in the folder: a member's own folders are not followed."""
    return os.path.join(folder, PurePosixPath(name).name)
