"""Motion-capture and point-cloud files to Motion and PointClouds and back: a module with `read` and `write` for each.

docs/formats.md lists what each format stores, what is kept and what is not.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import BadInput
from ..motion import UP_AXES, Motion
from ..pointcloud import PointClouds
from .blocks import Blocks
from .conventions import UNITS_M, metres_in, with_start
from .decisions import left_out, notes, without_extras

__all__ = [
    "CLOUDS", "FORMATS", "Blocks", "can_read_blocks", "dropped", "is_images", "left_out", "notes",
    "read", "read_blocks", "read_options", "replace_whole", "without_extras", "write", "writing_whole",
]  # fmt: skip

FORMATS = {
    ".c3d": "mocodec.formats.c3d",
    ".trc": "mocodec.formats.trc",
    ".bvh": "mocodec.formats.bvh",
    ".amc": "mocodec.formats.asf_amc",
    ".npz": "mocodec.formats.npz",
    ".npy": "mocodec.formats.npy",
    ".glb": "mocodec.formats.gltf",
    ".gltf": "mocodec.formats.gltf",
    ".ply": "mocodec.formats.ply",
    ".pcd": "mocodec.formats.pcd",
    ".sto": "mocodec.formats.opensim",
    ".mot": "mocodec.formats.opensim",
    ".csv": "mocodec.formats.delimited",
}
BLOCKS = {
    ".c3d": "mocodec.formats.c3d.blocks",
    ".npy": "mocodec.formats.npy",
    ".npz": "mocodec.formats.npz",
    ".bvh": "mocodec.formats.bvh.blocks",
    ".trc": "mocodec.formats.trc_blocks",
    ".amc": "mocodec.formats.amc_blocks",
    ".csv": "mocodec.formats.delimited_blocks",
}
"""Modules with `read_blocks`: the formats that can be read in pieces."""
IMAGES = "mocodec.formats.rgbd"
"""Reads a folder of depth and colour images; it has no suffix."""
PICKLES = (".pkl", ".pickle")
CAPTURE = "it is not read; export a .c3d from the program that captured it"
POINTS = (
    "of point clouds .ply and .pcd are read, a folder with a file for each frame; convert these files to one of them, "
    "for example with Open3D: write_point_cloud('0001.ply', read_point_cloud('0001.xyz'))"
)
NOT_READ = {
    **dict.fromkeys(
        PICKLES, "a pickle runs code when it is opened, so mocodec reads none; save its arrays with numpy.savez"
    ),
    **dict.fromkeys((".tak", ".mcp", ".tsv", ".trb", ".mvnx"), CAPTURE),
    **dict.fromkeys((".xyz", ".pts", ".las", ".laz", ".e57", ".drc"), POINTS),
}
OTHERS = {
    **NOT_READ,
    ".fbx": "an FBX is neither read nor written; programs that export it export .glb or .bvh too",
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "a USD is neither read nor written; export a .glb from it"),
    ".asf": "an .asf is the skeleton of an .amc: name the .amc, with asf= (--asf) if they are apart",
}
"""What to do with files of other suffixes; NOT_READ: with those to read."""
READ_ONLY = {".pcd": "a .pcd is read, not written; name a folder for .ply files, or an .npz"}
"""Formats that are not written, and what to write instead."""
WRITABLE = tuple(suffix for suffix in FORMATS if suffix not in READ_ONLY)
"""Formats that are written."""
CLOUDS = (".ply", ".pcd", ".npz")
"""Formats of point clouds; .npz stores motions too."""
FRAMES = (".ply", ".pcd")
"""Formats with a file for each frame: a folder or a glob of one of them is a recording."""

MAX_MESSAGE_CHARACTERS = 400
"""Error messages are one line, whatever names a damaged file has."""


def read(path: str | PathLike[str], **options: Any) -> Motion | PointClouds:
    """Read a file by its suffix, a folder or glob of .ply or of .pcd, or a folder of depth images (`formats.rgbd`).

    The options are those of the format's own `read`. Every format takes `up` (vertical axis), `unit` (of its lengths: a
    name, or metres) and `rate` (hertz) in place of what the file says; motions take `start`, the time of the first
    frame in seconds. `salvage=True` reads a truncated file as far as it goes. `read_options` names the options of a
    format.
    Raises BadInput if there is no such file, format or option, or if the content does not match the suffix.
    """
    path = Path(path)
    if is_images(path):
        return _read(IMAGES, path, options)
    if path.is_dir():
        return _read(FORMATS[_suffix_of_frames(path)], path, options)
    if path.suffix.lower() in FRAMES and any(wildcard in str(path) for wildcard in "*?["):
        return _read(FORMATS[path.suffix.lower()], path, options)
    if not path.suffix and not path.exists():
        raise BadInput(f"{path}: no such file or folder")
    module = _module(path)
    if not path.exists():
        raise BadInput(f"{path}: no such file")
    return _read(module, path, options)


def _suffix_of_frames(folder: Path) -> str:
    """The suffix of the frames in a folder; ".ply" without any. Raises BadInput for frames of two formats."""
    try:
        present = {file.suffix.lower() for file in folder.iterdir()} & set(FRAMES)
    except OSError as error:
        raise BadInput(f"{folder}: {error.strerror}") from error
    if len(present) > 1:
        kinds = " and ".join(sorted(present))
        raise BadInput(f"{folder}: has {kinds} files, frames of two recordings; move one kind to another folder")
    return present.pop() if present else FRAMES[0]


def read_blocks(path: str | PathLike[str], **options: Any) -> Blocks:
    """A recording in pieces, for files that do not fit into memory: motions that follow each other (`formats.blocks`).

    The options are those of `read`, without `salvage`. Raises BadInput for a format that is read as a whole only, and
    what `read` raises.
    """
    path = Path(path)
    _module(path)
    if not can_read_blocks(path):
        raise BadInput(f"{path}: {path.suffix.lower()} is read as a whole only; in pieces: {', '.join(BLOCKS)}")
    if not path.exists():
        raise BadInput(f"{path}: no such file")
    blocks: Blocks = _call(BLOCKS[path.suffix.lower()], "read_blocks", path, **options)
    return replace(blocks, parts=lambda: _with_file_named(path, blocks.parts()))


def _with_file_named(path: Path, blocks: Iterator[Motion]) -> Iterator[Motion]:
    """The blocks. Raises BadInput with the file and the frames for one that is no motion, which knows neither."""
    begin = 0
    try:
        for block in blocks:
            yield block
            begin += len(block)
    except BadInput as error:
        if path.name in str(error):
            raise
        raise BadInput(f"{path}: in the frames from {begin:,} on, {error} of them") from None


def can_read_blocks(path: str | PathLike[str]) -> bool:
    """Whether the format of a path can be read in pieces."""
    return Path(path).suffix.lower() in BLOCKS


def is_images(path: str | PathLike[str]) -> bool:
    """Whether a path is a folder of depth images with intrinsics, which `read` takes for one recording."""
    return Path(path).is_dir() and import_module(IMAGES).is_sequence(path)


def _read(module: str, path: Path, options: dict[str, Any]) -> Motion | PointClouds:
    """Read, with the overrides that need nothing of the format: `up` and `start`."""
    if options.get("up") is not None and options["up"] not in UP_AXES:
        raise BadInput(f"{path}: up is one of {', '.join(UP_AXES)}, not {options['up']!r:.40}")
    names = _parameters(import_module(module).read)
    up = options.pop("up") if "up" in options and "up" not in names else None
    start = options.pop("start", None)
    recording = _call(module, "read", path, **options)
    if up is not None:
        source = {key: value for key, value in recording.source.items() if key != "up_guessed"}
        recording = replace(recording, up=up, source=source)
    if start is not None:
        if not isinstance(recording, Motion):
            raise BadInput(f"{path}: point clouds have no start time")
        recording = replace(recording, source=with_start(recording.source, recording.rate, float(start)))
    return recording


def write(path: str | PathLike[str], motion: Motion | PointClouds, **options: Any) -> None:
    """Write by suffix; a path without one is a folder of .ply. Raises BadInput for data that the format cannot hold.

    `unit` (a name such as "cm") is that of lengths in the file, for formats that have one: .bvh .amc .c3d .trc.
    """
    path = Path(path)
    folder = isinstance(motion, PointClouds) and not path.suffix
    module = FORMATS[".ply"] if folder else _module(path, writes=True)
    if isinstance(motion, PointClouds) and module not in {FORMATS[suffix] for suffix in CLOUDS}:
        raise BadInput(
            f"{path}: a {path.suffix.lower()} stores motions, not point clouds; name a folder for .ply files, or an "
            ".npz. The motion of a body in them is in their .mocz: `mocodec encode`, then `mocodec decode`"
        )
    if isinstance(motion, Motion) and module == FORMATS[".ply"]:
        raise BadInput(f"{path}: a .ply stores point clouds, not motions; an .npz has the positions as an array")
    if "unit" in options and "unit" not in _parameters(import_module(module).write):
        motion = _in_unit(path, motion, options.pop("unit"))
    _call(module, "write", path, motion, **options)


def _in_unit(path: Path, motion: Motion | PointClouds, unit: Any) -> Motion | PointClouds:
    """A motion whose source has this unit, which the writers of .c3d and .trc follow. Raises BadInput for others."""
    suffix = path.suffix.lower()
    if suffix not in (".c3d", ".trc") or not isinstance(motion, Motion):
        what = f"a {suffix}" if suffix else "a folder of .ply"
        raise BadInput(f"{path}: {what} has a unit of its own; unit= (--to-unit) is for .bvh .amc .c3d .trc")
    unit_m = metres_in(str(unit))
    if unit_m is None:
        raise BadInput(f"{path}: a {suffix} names its unit: one of {', '.join(UNITS_M)}, not {unit!r:.40}")
    return replace(motion, source={**motion.source, "format": suffix[1:], "units": str(unit).strip(), "unit_m": unit_m})


def _module(path: Path, writes: bool = False) -> str:
    suffix = path.suffix.lower()
    if suffix in OTHERS and not (writes and suffix in NOT_READ):
        raise BadInput(f"{path}: {OTHERS[suffix]}")
    if writes and suffix in READ_ONLY:
        raise BadInput(f"{path}: {READ_ONLY[suffix]}")
    if suffix not in FORMATS:
        problem = f"unknown suffix {suffix!r}" if suffix else "a file needs a suffix"
        raise BadInput(f"{path}: {problem}; the formats are {' '.join(WRITABLE if writes else FORMATS)} .mocz")
    return FORMATS[suffix]


def _parameters(function: Any) -> tuple[str, ...]:
    """The names of a function's parameters after the first."""
    code = function.__code__
    return code.co_varnames[1 : code.co_argcount + code.co_kwonlyargcount]


def _call(module: str, verb: str, path: Path, *args: Any, **options: Any) -> Any:
    function = getattr(import_module(module), verb)
    names = _parameters(function)
    for name in options:
        if name not in names:
            raise BadInput(f"{path}: {_no_option(path, verb, name)}")
    try:
        return function(path, *args, **options)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror or error}") from error
    except BadInput as error:
        message = str(error)
        if verb != "write" and path.name not in message:  # of a motion, which does not know its file
            message = f"{path}: {message}"
        if message == str(error) and message.isprintable() and len(message) <= MAX_MESSAGE_CHARACTERS:
            raise
        printable = "".join(c if c.isprintable() else " " for c in message)
        raise BadInput(printable[:MAX_MESSAGE_CHARACTERS]) from None


def _no_option(path: Path, verb: str, name: str) -> str:
    """What is wrong with an option that a format does not have: the formats that have it."""
    takers = [suffix for suffix in FORMATS if verb == "read" and name in read_options(f"x{suffix}")]
    only = f"; --{name} is for {', '.join(takers)}" if takers else ""
    how = {"read_blocks": "reading in pieces"}.get(verb, verb)
    return f"{how} of {path.suffix.lower() or 'this format'} has no option {name!r}{only}"


def read_options(path: str | PathLike[str]) -> frozenset[str]:
    """The names of the options that the reader of a path's format takes. Raises BadInput for an unknown suffix."""
    path = Path(path)
    module = IMAGES if is_images(path) else FORMATS[".ply"] if path.is_dir() else _module(path)
    names = frozenset(_parameters(import_module(module).read)) | {"up"}
    return names if module in (*(FORMATS[suffix] for suffix in FRAMES), IMAGES) else names | {"start"}


def dropped(path: str | PathLike[str], motion: Motion | PointClouds) -> list[str]:
    """Descriptions of the data beside the positions that `write` leaves out, since the format of `path` cannot hold it.

    Positions and gaps are never left out: `write` raises instead; names and rate only by an .npy. Raises BadInput for
    an unknown suffix.
    """
    if not isinstance(motion, Motion):
        return []
    module = import_module(_module(Path(path), writes=True))
    kept: frozenset[str] = module.holds(motion) if hasattr(module, "holds") else getattr(module, "HOLDS", frozenset())
    lacks: tuple[str, ...] = getattr(module, "LACKS", ())
    present = [*motion.extras, *lacks]
    present += ["skeleton"] if motion.skeleton is not None else []
    present += ["joint rotations"] if motion.rotations is not None else []
    return list(dict.fromkeys(DESCRIPTIONS.get(name, name) for name in present if name not in kept))


DESCRIPTIONS = {
    "amass": "body model parameters beside the poses (betas, gender, …)",
    "analog": "analog channels",
    "model_outputs": "joint angles, forces, moments and powers of a model",
    "gltf": "the node tree of a GLB",
    "parameters": "C3D parameters",
    "parameter_notes": "C3D parameters",
    "parameters_locked": "C3D parameters",
    "rotations": "segment poses",
    "sections": "devices and model outputs of a Nexus export",
    "signals": "signals beside the points",
    "zero_samples": "marks of zeros",
}
"""Keys of `Motion.extras` as users read them; other keys are shown as they are."""


def replace_whole(path: str | PathLike[str], data: bytes) -> None:
    """Write a file completely or not at all: to a temporary file beside it, which is then renamed.

    Links are followed and stay links; an existing file keeps its permissions; pipes and devices are written directly.
    Raises BadInput if the file cannot be written.
    """
    with writing_whole(path) as file:
        file.write(data)


@contextmanager
def writing_whole(path: str | PathLike[str]) -> Generator[BinaryIO, None, None]:
    """As `replace_whole`, with a file to write to: the file appears at the end of the context, unless it raises."""
    path = Path(path)
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise BadInput(f"{path}: this is a folder; name a file in it")
    try:
        if target.exists() and not target.is_file():
            with target.open("wb") as file:
                yield file
            return
        temporary = target.with_name(f".mocodec-{os.urandom(6).hex()}.part")
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    except OSError as error:
        missing = not target.parent.exists()
        raise BadInput(
            f"{path}: there is no folder {target.parent}"
            if missing
            else f"{path}: cannot write here ({error.strerror})"
        ) from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
        if target.exists():
            os.chmod(temporary, target.stat().st_mode & 0o7777)
        os.replace(temporary, target)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise BadInput(f"{path}: cannot be written ({error.strerror})") from error
        raise
