"""Files of the field to Motion and PointClouds, and back: a module with `read` and `write` for each.

`docs/formats.md` says what each file carries, what is kept and what is not.
"""

from __future__ import annotations

import os
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
    ".glb": "mocodec.formats.gltf",
    ".ply": "mocodec.formats.ply",
}
CLOUDS = (".ply", ".npz")
"""Formats that hold point clouds; .npz holds motions too."""

LONGEST_MESSAGE = 400  # letters; one line, whatever names a damaged file has


def read(path: str | PathLike[str], **options: Any) -> Motion | PointClouds:
    """Read a file, or a folder or glob of .ply, by its suffix; the options are those of the format's own `read`.

    Raises BadInput where there is no such file, no such format or option, or the content is not what the suffix says.
    """
    path = Path(path)
    if path.is_dir() or (path.suffix.lower() == ".ply" and any(sign in str(path) for sign in "*?[")):
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


def dropped(path: str | PathLike[str], motion: Motion | PointClouds) -> list[str]:
    """What of this motion the format of `path` has no place for, in words: `write` leaves it out.

    Positions, gaps, names and rate are no part of it: a format that cannot hold those refuses. Raises BadInput for an
    unknown suffix.
    """
    if not isinstance(motion, Motion):
        return []
    held: frozenset[str] = getattr(import_module(_module(Path(path))), "HOLDS", frozenset())
    there = [*motion.extras]
    there += ["skeleton"] if motion.skeleton is not None else []
    there += ["joint rotations"] if motion.rotations is not None else []
    return list(dict.fromkeys(IN_WORDS.get(what, what) for what in there if what not in held))


# Keys of `Motion.extras` for people; others are shown as they are.
IN_WORDS = {
    "analog": "analog channels",
    "parameters": "C3D parameters",
    "parameter_notes": "C3D parameters",
    "parameters_locked": "C3D parameters",
    "rotations": "segment poses",
}


def replace_whole(path: str | PathLike[str], data: bytes) -> None:
    """Write a file whole or not at all: to a temporary file beside it, then renamed over it.

    A link is followed and stays a link; a file that was there keeps its permissions; a pipe or a device takes the bytes
    as they come. Raises BadInput where that cannot be done.
    """
    path = Path(path)
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise BadInput(f"{path}: is a folder: name a file in it")
    try:
        if target.exists() and not target.is_file():
            target.write_bytes(data)
            return
        temporary = target.with_name(f".mocodec-{os.urandom(6).hex()}.part")
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    except OSError as error:
        raise BadInput(f"{path}: cannot write here ({error.strerror})") from error
    try:
        with os.fdopen(descriptor, "wb") as f:
            f.write(data)
        if target.exists():
            os.chmod(temporary, target.stat().st_mode & 0o7777)
        os.replace(temporary, target)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise BadInput(f"{path}: cannot be written ({error.strerror})") from error
        raise
