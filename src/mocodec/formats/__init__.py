"""Files of the field to Motion and PointClouds, and back: a module with `read` and `write` for each.

`docs/formats.md` says what each file carries, what is kept and what is not.
"""

from __future__ import annotations

import os
import tempfile
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any

from ..errors import BadInput
from ..motion import Motion
from ..pointcloud import PointClouds

FORMATS = {
    ".c3d": "mocodec.formats.c3d",
    ".trc": "mocodec.formats.trc",
    ".bvh": "mocodec.formats.bvh",
    ".amc": "mocodec.formats.asf_amc",
    ".npz": "mocodec.formats.npz",
    ".ply": "mocodec.formats.ply",
}

LONGEST_MESSAGE = 400  # letters; one line, whatever names a damaged file has


def read(path: str | PathLike[str], **options: Any) -> Motion | PointClouds:
    """Read a file, or a folder of .ply, by its suffix; the options are those of the format's own `read`.

    Raises BadInput where there is no such file, no such format or option, or the content is not what the suffix says.
    """
    path = Path(path)
    if path.is_dir():
        return _call(FORMATS[".ply"], "read", path, **options)
    module = _module(path)
    if not path.exists():
        raise BadInput(f"{path}: no such file")
    return _call(module, "read", path, **options)


def write(path: str | PathLike[str], motion: Motion | PointClouds, **options: Any) -> None:
    """Write by suffix; a path without one is a folder of .ply. Raises BadInput for what the format cannot hold."""
    path = Path(path)
    folder = isinstance(motion, PointClouds) and not path.suffix
    _call(FORMATS[".ply"] if folder else _module(path), "write", path, motion, **options)


def _module(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        what = f"{suffix!r} is not a format" if suffix else "a file without a suffix is not a format"
        raise BadInput(f"{path}: {what} that mocodec knows; known: {' '.join(FORMATS)} .mocz")
    return FORMATS[suffix]


def _call(module: str, verb: str, path: Path, *args: Any, **options: Any) -> Any:
    function = getattr(import_module(module), verb)
    known = function.__code__.co_varnames[: function.__code__.co_argcount + function.__code__.co_kwonlyargcount]
    for name in options:
        if name not in known[1:]:
            raise BadInput(f"{path}: {verb} of {path.suffix.lower() or 'this format'} has no option {name!r}")
    try:
        return function(path, *args, **options)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror or error}") from error
    except BadInput as error:
        message = str(error)
        if message.isprintable() and len(message) <= LONGEST_MESSAGE:
            raise
        printable = "".join(letter if letter.isprintable() else " " for letter in message)
        raise BadInput(printable[:LONGEST_MESSAGE]) from None


def replace_whole(path: str | PathLike[str], data: bytes) -> None:
    """Write a file whole or not at all: to a temporary file beside it, then renamed over it."""
    path = Path(path)
    try:
        descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    except OSError as error:
        raise BadInput(f"{path}: cannot write here ({error.strerror})") from error
    try:
        with os.fdopen(descriptor, "wb") as f:
            f.write(data)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
