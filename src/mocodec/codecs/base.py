# pyright: strict
"""The contract of codecs: a frozen dataclass of settings with `encode`, and a static `decode` that needs only bytes."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Protocol, cast

import numpy as np

from .. import parallel
from ..encoded import Chunk, Encoded, Recording, RecordingT, about, restore
from ..errors import CannotEncode, Corrupt
from ..motion import Motion
from ..typing import Floats

GAP_CHUNK_FRAMES = 1 << 16
GAP_CHUNK_SAMPLES = 1 << 22
"""The most frames, and frames × points, of a chunk of a motion without samples."""

LARGEST_M, LARGEST_HZ = 1e12, 1e9
"""Positions and rates beyond are coded by lossless only."""


class Fields(Protocol):
    """A dataclass of settings."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


class Codec(Fields, Protocol[RecordingT]):
    """A frozen dataclass that codes motions, `Codec[Motion]`, or point clouds, `Codec[PointClouds]`.

    Settings are the fields of the dataclass, with the defaults of the paper. Fields named `max_error`, `mean_error`
    (metres), `ratio` or `size` (bytes) are the targets that this codec can meet. `name` is stored in files: never
    change it.
    """

    name: ClassVar[str]

    def encode(self, recording: RecordingT, /) -> Encoded[RecordingT]:
        """Raises CannotEncode if the recording cannot be coded with these settings, BadInput for unusable settings."""
        ...

    @staticmethod
    def decode(encoded: Encoded[RecordingT], frames: slice | None = None) -> RecordingT:
        """The recording, or a slice of its frames; the same as the slice of the whole. Raises Corrupt."""
        ...


def settings(codec: Fields) -> dict[str, Any]:
    """The settings that differ from the defaults, as JSON values: stored in the file as provenance."""
    changed: dict[str, Any] = {}
    for f in dataclasses.fields(codec):
        value = getattr(codec, f.name)
        default = f.default_factory() if f.default_factory is not dataclasses.MISSING else f.default
        if value != default:
            changed[f.name] = list(cast("tuple[Any, ...]", value)) if isinstance(value, tuple) else value
    return changed


def require_frames(motion: Motion) -> None:
    """Raises CannotEncode for a motion without frames."""
    if len(motion) == 0:
        raise CannotEncode("the motion has no frames")


def not_kept(codec: Codec[Any], recording: Recording) -> list[str]:
    """What a codec will not keep of a recording, in words: known before encoding."""
    if not isinstance(recording, Motion):
        return ["the normals of the points"] if recording.normals is not None else []
    lost: list[str] = []
    if recording.rotations is not None:
        lost_rotations = getattr(codec, "lost_rotations", None)
        reason = f"{codec.name} codes positions only" if lost_rotations is None else lost_rotations(recording)
        lost += [f"the rotations of the joints ({reason})"] if reason is not None else []
    if recording.skeleton is not None and recording.skeleton.limits is not None:
        lost += ["the limits of the joints"] if lost or recording.rotations is None else []
    return lost


def has_samples(motion: Motion) -> bool:
    """Whether any point is present in any frame; force plates may be recorded without points."""
    positions = motion.positions  # mostly the first frame tells
    return bool(positions.size) and not (np.isnan(positions[0]).all() and np.isnan(positions).all())


def require_usual_rate(codec: Codec[Motion], rate: float) -> None:
    """Raises CannotEncode for a rate, hertz, that integer frequencies do not reach: a damaged number."""
    if rate > LARGEST_HZ:
        raise CannotEncode(
            f"{codec.name} models motion at up to {LARGEST_HZ:g} Hz, and this one has {rate:.3g} Hz; "
            "correct the rate (--rate), or use the codec lossless"
        )


def require_usual_lengths(codec: Codec[Motion], positions: Floats) -> None:
    """Raises CannotEncode for positions that are too far away for coding in steps: a wrong unit, or damaged numbers."""

    def reach(some: slice) -> tuple[float, float]:
        block = positions[some]
        return np.fmax.reduce(block, axis=None), -np.fmin.reduce(block, axis=None)

    largest = float(np.fmax.reduce(list(parallel.over(reach, parallel.blocks(len(positions)))), axis=None))
    if largest > LARGEST_M:
        raise CannotEncode(
            f"{codec.name} codes positions up to {LARGEST_M:g} m, and there are some at {largest:.3g} m; "
            "correct the unit (--unit), or use the codec lossless"
        )


def encode_gaps(codec: Codec[Motion], motion: Motion, stored: dict[str, Any]) -> Encoded[Motion]:
    """A motion without samples: no shared bytes, empty payloads. stored: the settings for the file."""
    require_frames(motion)
    longest = max(1, min(GAP_CHUNK_FRAMES, GAP_CHUNK_SAMPLES // max(1, motion.points)))
    starts = range(0, len(motion), longest)
    chunks = [Chunk(start, min(longest, len(motion) - start), b"") for start in starts]
    return Encoded(codec.name, about(motion), chunks, settings=stored)


def decode_gaps(encoded: Encoded[Motion], frames: slice | None) -> Motion:
    """The inverse of `encode_gaps`: every point is missing in every frame. Raises Corrupt for payloads."""
    start, stop = encoded.range(frames)
    if any(chunk.payload or chunk.frames * encoded.about.points > GAP_CHUNK_SAMPLES
           for chunk in encoded.covering(start, stop)):  # fmt: skip
        raise Corrupt(f"{encoded.codec}: a stream without shared bytes has payloads, or chunks that are too long")
    return restore(encoded, np.full((stop - start, encoded.about.points, 3), np.nan), start)
