"""NumPy's files without pickle: arrays of an .npz and of an .npy, each checked against its bytes before it is read."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import replace_whole

MAX_ARRAY_BYTES = 1 << 32
MAX_DEFLATE_RATIO = 1100
"""Deflate packs at most about 1,032 bytes into one."""

MAX_HEADER_BYTES = 1 << 16
GIVE_RATE = "; give it with rate= (--rate)"
"""What to do where a file does not say its frame rate."""


class Header(NamedTuple):
    """What an array's bytes begin with. size: bytes of the header itself. is_fortran: the first index runs fastest."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    size: int
    is_fortran: bool = False


@contextmanager
def reading(path: str | Path, what: str = "an NPZ") -> Generator[None, None, None]:
    """Turn whatever a damaged file raises in zipfile and NumPy into BadInput with its path."""
    try:
        yield
    except (zipfile.BadZipFile, zipfile.LargeZipFile, EOFError, ValueError, KeyError, NotImplementedError, RuntimeError,
            OverflowError, SyntaxError, TokenError, TypeError, IndexError, AttributeError, MemoryError,
            zlib.error) as error:  # fmt: skip
        if isinstance(error, BadInput):
            raise error if str(error).startswith(str(path)) else BadInput(f"{path}: {error}") from None
        raise BadInput(f"{path}: cannot be read as {what} ({error})") from None


class Archive:
    """The arrays of an .npz, each loaded on demand."""

    def __init__(self, archive: zipfile.ZipFile, path: str | Path) -> None:
        self.archive, self.path = archive, path
        self.names = {Path(info.filename).stem: info for info in archive.infolist() if info.filename.endswith(".npy")}

    def first(self, names: tuple[str, ...]) -> str | None:
        """The first of these names that the archive has."""
        return next((name for name in names if name in self.names), None)

    def _member(self, name: str) -> zipfile.ZipInfo:
        """The entry of an array. Raises BadInput for methods of compression that NumPy does not write."""
        info = self.names[name]
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise BadInput(f"{self.path}: array {name!r} is compressed by a method that NumPy does not write")
        return info

    def header(self, name: str) -> Header:
        """The shape and type of one array, which is not read."""
        with self.archive.open(self._member(name)) as member:
            return header_of(member.read(MAX_HEADER_BYTES))

    def raw(self, name: str) -> bytes:
        """The bytes of one array with its header. Raises BadInput for sizes that the archive cannot hold."""
        info = self._member(name)
        if info.file_size > min(MAX_ARRAY_BYTES, MAX_DEFLATE_RATIO * info.compress_size + 4096):
            raise BadInput(f"{self.path}: array {name!r} declares {info.file_size} bytes, too many for its archive")
        with self.archive.open(info) as member:
            data = member.read(info.file_size + 1)
        if len(data) != info.file_size:
            raise BadInput(f"{self.path}: array {name!r} does not have the {info.file_size} bytes that it declares")
        return data

    def load(self, name: str) -> NDArray[Any]:
        """One array. Raises BadInput for arrays of objects and for declared sizes that the archive cannot hold."""
        return array_of(self.raw(name), f"{self.path}: array {name!r}")

    def single(self, name: str, remedy: str = "") -> Any:
        """The value of an array that repeats one value. Raises BadInput where it has none, or values that differ.

        remedy: what to do about the latter.
        """
        values = self.load(name).reshape(-1)
        if not len(values):
            raise BadInput(f"{self.path}: array {name!r} is empty")
        if len(values) > 1 and (values != values[0]).any():
            shown = ", ".join(map(str, values[:3]))
            raise BadInput(f"{self.path}: array {name!r} holds values that differ ({shown}, …), not one{remedy}")
        return values[0]

    def word(self, name: str) -> str:
        """As `single`, as text."""
        value = self.single(name)
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


class Rows(Archive):
    """The arrays of an .npz in pieces: those with a row for each frame give the next `count` rows when they are loaded.

    Each is read from front to back, once. frames: rows of the arrays named in `by_frame`.
    """

    def __init__(self, archive: zipfile.ZipFile, path: str | Path, by_frame: tuple[str, ...], count: int) -> None:
        super().__init__(archive, path)
        self.count = count
        self._open = {name: self._opened(name) for name in by_frame}
        self._whole: dict[str, NDArray[Any]] = {}

    def _opened(self, name: str) -> tuple[Any, Header]:
        header = self.header(name)
        if header.dtype.hasobject or header.is_fortran or not header.shape:
            raise BadInput(f"{self.path}: array {name!r} cannot be read in pieces: save it as numbers in C order")
        member = self.archive.open(self._member(name))
        member.read(header.size)
        return member, header

    def load(self, name: str) -> NDArray[Any]:
        if name not in self._open:
            if name not in self._whole:
                self._whole[name] = super().load(name)
            return self._whole[name]
        member, header = self._open[name]
        row_bytes = math.prod(header.shape[1:]) * header.dtype.itemsize
        data = member.read(self.count * row_bytes)
        if row_bytes and len(data) % row_bytes:
            raise BadInput(f"{self.path}: array {name!r} is cut off or damaged")
        return np.frombuffer(data, header.dtype).reshape(-1, *header.shape[1:])


def header_of(data: bytes) -> Header:
    """The header of an array's bytes. Raises ValueError where there is none."""
    stream = io.BytesIO(data[:MAX_HEADER_BYTES])
    version = np.lib.format.read_magic(stream)
    parse = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, is_fortran, dtype = parse(stream)
    return Header(shape, dtype, stream.tell(), is_fortran)


def array_of(data: bytes, what: str) -> NDArray[Any]:
    """The array in these bytes. what: its name in messages. Raises BadInput for objects and for damage."""
    header = header_of(data)
    if header.dtype.hasobject:
        raise BadInput(f"{what} holds Python objects, a pickle that runs code when it is opened; save it as numbers")
    if math.prod(header.shape) * header.dtype.itemsize != len(data) - header.size:
        raise BadInput(f"{what} is cut off or damaged")
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def bytes_of(array: NDArray[Any]) -> bytes:
    """An array as the bytes of an .npy."""
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asarray(array), allow_pickle=False)
    return out.getvalue()


def save(path: str | Path, arrays: Mapping[str, NDArray[Any] | bytes]) -> None:
    """Write an .npz in this order; a value of bytes is an array's own bytes, with its header."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            member.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(member, array if isinstance(array, bytes) else bytes_of(array))
    replace_whole(path, out.getvalue())
