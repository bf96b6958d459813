# pyright: strict
"""The public functions: read, write, encode, decode, open, compare.

file ─read─► Motion ─encode─► bytes of a .mocz ─decode─► Motion ─write─► file
                                 └─open─► slices, without reading the rest
"""

from __future__ import annotations

import dataclasses
import math
import os
import warnings
from collections.abc import Iterable
from os import PathLike
from typing import TYPE_CHECKING, Any, cast, overload

from . import formats, parallel
from . import progress as progress_
from .codecs import base
from .codecs.base import Codec
from .encoded import TARGETS, Recording, RecordingT
from .errors import BadInput
from .metrics import compare
from .motion import Deferred, Motion, with_signals
from .opened import File, Source, of_kind, open
from .packing import default_codec, pack, with_options
from .pointcloud import PointClouds
from .progress import Callback

if TYPE_CHECKING:  # imported where they are used: they import a codec
    from .codecs.tempo import Tempo
    from .in_pieces import Written

__all__ = [
    "File", "compare", "decode", "encode", "encode_blocks", "not_kept", "open", "read", "read_blocks", "write",
]  # fmt: skip

AnyPath = str | PathLike[str]


@overload
def read(path: AnyPath, kind: type[RecordingT], **options: Any) -> RecordingT: ...
@overload
def read(path: AnyPath, kind: None = None, *, asf: AnyPath, **options: Any) -> Motion: ...
@overload
def read(path: AnyPath, kind: None = None, *, fps: float, **options: Any) -> PointClouds: ...
@overload
def read(path: AnyPath, kind: None = None, **options: Any) -> Recording: ...
def read(path: AnyPath, kind: type[Recording] | None = None, **options: Any) -> Recording:
    """Read a recording by its suffix: .c3d .trc .bvh .amc .npz .npy .glb .csv …, a .mocz, or a folder of .ply or .pcd.

        motion = mocodec.read("walk.c3d", mocodec.Motion)
        motion = mocodec.read("walk.bvh", unit="cm")
        clouds = mocodec.read("dancer", mocodec.PointClouds, fps=15)

    kind: `Motion` or `PointClouds`: a file of the other kind is an error, and type checkers know the result.
    options: those of the format's reader (docs/formats.md; `mocodec.formats.read_options(path)` lists them). Most take
    unit ("mm", or metres per unit), rate (hertz), up ("x", "y", "z") and start (seconds) in place of what the file
    says; an .amc takes asf, a folder of .ply or .pcd fps.

    Returns positions in metres. Raises BadInput; for a .mocz also what `decode` raises.
    """
    if is_mocz(path):
        if options:
            raise BadInput(f"{os.fspath(path)}: reading a .mocz takes no options, but got {', '.join(options)}")
        return decode(path, kind)
    return of_kind(formats.read(path, **options), kind, path)


def read_blocks(path: AnyPath, **options: Any) -> formats.Blocks:
    """A recording that does not fit into memory, in pieces: for `encode_blocks`, or for your own loop over motions.

    Reads .npy, .npz and what docs/howto/long.md lists. The options are those of `read`; unit and vertical axis are
    guessed from the first frames where the file does not say. Raises BadInput.
    """
    return formats.read_blocks(path, **options)


def write(path: AnyPath, recording: Recording, **options: Any) -> None:
    """Write a file in the format of its suffix; for a .mocz, options are those of `encode`.

    The file appears complete or not at all. A format that cannot store all of the recording (a .trc has no analog
    channels) leaves the rest out; `mocodec.formats.dropped(path, recording)` lists it.
    Raises BadInput; for a .mocz also CannotEncode.
    """
    if is_mocz(path):
        formats.replace_whole(path, encode(recording, **options))
    else:
        formats.write(path, recording, **options)


@overload
def encode(
    recording: Motion,
    codec: str | Codec[Motion] | None = None,
    *,
    max_error: float | None = None,
    mean_error: float | None = None,
    ratio: float | None = None,
    size: int | None = None,
    signal_error: str | None = None,
    threads: int | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> bytes: ...
@overload
def encode(
    recording: PointClouds,
    codec: str | Codec[PointClouds] | None = None,
    *,
    max_error: float | None = None,
    mean_error: float | None = None,
    ratio: float | None = None,
    size: int | None = None,
    psnr: float | None = None,
    threads: int | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> bytes: ...
@overload
def encode(
    recording: Recording,
    codec: str | None = None,
    *,
    max_error: float | None = None,
    mean_error: float | None = None,
    ratio: float | None = None,
    size: int | None = None,
    signal_error: str | None = None,
    threads: int | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> bytes: ...
def encode(
    recording: Recording,
    codec: str | Codec[Any] | None = None,
    *,
    signal_error: str | None = None,
    threads: int | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> bytes:
    """Encode a motion or point clouds as the bytes of a .mocz.

        blob = mocodec.encode(motion, max_error=0.002)                         # no point is farther off than 2 mm
        blob = mocodec.encode(motion, "hou2014", ratio=100, components=40)     # another codec, target and setting

    recording: `Motion` (positions (frames, points, 3) in metres) or `PointClouds`.
    codec: "tempo" (the default for motion), "hou2014", "liu2006", "lossless"; "bodycast" (the default for point
    clouds), "lien2006"; or an instance that has settings, such as `Hou2014(components=40)`.

    Targets, at most one of the first four; without any, tempo moves no point of any frame by more than 5 mm:

    max_error: metres (2 mm is 0.002; a warning says so from 0.5 on); no point of any frame is farther off. Where
    rotations are kept, this holds for joints and points 3 cm off them; of point clouds, errors are distances to the
    nearest point of the other cloud, in both directions.
    mean_error: metres; the mean over all points and frames is not larger.
    ratio: size as float32 positions (`raw_bytes`) over size of the file without extras, at least.
    size: bytes of the file, at most.
    max_rotation: degrees; no joint is rotated farther off. For tempo, alone or with another target.
    psnr: dB, of the luma between nearest points of clouds, at least. For bodycast, alone or with another target.

    signal_error: how far samples of signals in `extras` may be off: "12bit" or "0.1%" of their range, or by label
    "Fz*=0.5N, EMG*=12bit"; None keeps them exactly.
    threads: how many chunks are coded at a time, where the codec can; None: all processors, or MOCODEC_THREADS. The
    bytes do not depend on it.
    progress: called with fractions from 0 to 1.
    settings: the targets and other settings of the codec, which are the fields of its class (`help(mocodec.Tempo)`).

    Returns the bytes; `mocodec.write("walk.mocz", motion, max_error=0.002)` writes them to a file, `decode` decodes
    them. Raises BadInput for settings that the codec does not have or that contradict each other, CannotEncode if it
    cannot meet them.
    """
    if not isinstance(cast(object, recording), (Motion, PointClouds)):
        raise BadInput(
            f"encode takes a Motion or PointClouds, not {type(recording).__name__}; make one with "
            "mocodec.Motion(positions, rate)"
        )
    chosen = with_options(codec or default_codec(recording), **without_empty_targets(settings))
    _warn_of_metres(settings)
    with progress_.listening(progress), parallel.threads(threads):
        return pack(chosen, recording, signal_error)


def encode_blocks(
    blocks: Iterable[Motion],
    path: AnyPath,
    codec: str | Tempo = "tempo",
    *,
    frames: int | None = None,
    threads: int | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> Written:
    """Write a .mocz of a recording that comes in blocks and need not fit into memory; returns its size and errors.

        written = mocodec.encode_blocks(mocodec.read_blocks("day.npy", rate=120), "day.mocz", max_error=0.005)

    blocks: motions that follow each other, of the same points and rate and of any lengths: `read_blocks(path)`, or your
    own generator. Names, skeleton and `source` are those of the first block; extras are those of `read_blocks`, and
    left out of other sources.
    frames: the number of frames, for `ratio`, `size` and progress, where the source does not say it.
    threads, progress, settings (targets and others): as in `encode`.

    The model is fitted to the first minutes, or to parts of the whole recording if the source can be read at any frame.
    Every chunk is decoded and measured; the file appears complete or not at all. A recording of less than some minutes
    is encoded as by `encode`. Rotations are kept under `max_error`, of motions without gaps.
    Raises BadInput, also for codecs other than tempo; CannotEncode.
    """
    from . import in_pieces

    chosen = with_options(codec, **without_empty_targets(settings))
    _warn_of_metres(settings)
    with progress_.listening(progress), parallel.threads(threads):
        return in_pieces.write(blocks, path, chosen, frames)


IMPLAUSIBLE_ERROR_M = 0.5
"""Errors of human motion from here on are rarely meant: `max_error=2` is two metres."""


def _warn_of_metres(settings: dict[str, Any]) -> None:
    """A warning for errors that are millimetres by their size, at the call of the function of this module."""
    for name in ("max_error", "mean_error"):
        value = settings.get(name)
        if value is not None and IMPLAUSIBLE_ERROR_M <= value < math.inf:
            text = f"{name}={value:g} is {value:g} m: lengths are in metres; {value:g} mm is {value / 1000:g}"
            warnings.warn(text, stacklevel=3)


def not_kept(recording: Recording, codec: str | Codec[Any] | None = None) -> list[str]:
    """What a codec will not keep of a recording, in words, before anything is encoded: rotations, joint limits.

    codec: a name or an instance; by default that of `encode`. Positions are kept within the target of the codec, and
    `extras` without loss. Offsets of a skeleton are rounded to 10 µm, but for the lossless codec. Raises BadInput.
    """
    return base.not_kept(with_options(codec or default_codec(recording)), recording)


def without_empty_targets(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings without the targets that are None."""
    return {name: value for name, value in settings.items() if value is not None or name not in TARGETS}


@overload
def decode(
    source: Source, kind: type[RecordingT], *, threads: int | None = None, progress: Callback | None = None
) -> RecordingT: ...
@overload
def decode(
    source: Source, kind: None = None, *, threads: int | None = None, progress: Callback | None = None
) -> Recording: ...
def decode(
    source: Source,
    kind: type[Recording] | None = None,
    *,
    threads: int | None = None,
    progress: Callback | None = None,
) -> Recording:
    """Decode a .mocz: a `Motion` or `PointClouds`, with all frames, gaps, names and extras.

        motion = mocodec.decode("walk.mocz", mocodec.Motion)
        motion.positions                                   # (frames, points, 3) float64, metres; NaN where missing

    source: bytes, a path, an http(s) URL or a binary file object. `open` reads some frames without the others.
    kind: `Motion` or `PointClouds`: a file of the other kind is an error, and type checkers know the result.
    threads: how many threads decode, where the codec and the compiled module can; None: all processors, or
    MOCODEC_THREADS.
    progress: called with fractions from 0 to 1.

    Raises Truncated and Corrupt for damaged files, TooNew and UnknownCodec for those of a later version, BadInput for
    files that are no .mocz or do not exist.
    """
    with progress_.listening(progress), open(source, kind) as f:
        recording = f.decode(slice(0, len(f)), threads=threads)
        if isinstance(recording.extras, Deferred):
            recording = dataclasses.replace(
                recording, extras=with_signals(recording.extras, lambda signal: signal.loaded())
            )
        return recording


def is_mocz(path: AnyPath) -> bool:
    """Whether a path has the suffix .mocz."""
    return os.fspath(path).lower().endswith(".mocz")
