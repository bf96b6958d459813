# pyright: strict
"""The contract of codecs: a frozen dataclass of settings with `encode`, and a static `decode` that needs only bytes."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Protocol, cast

import numpy as np

from ..encoded import Encoded, Recording, RecordingT
from ..errors import CannotEncode
from ..motion import Motion


class Codec(Protocol[RecordingT]):
    """A frozen dataclass that codes motions, `Codec[Motion]`, or point clouds, `Codec[PointClouds]`.

    Settings are the fields of the dataclass, with the defaults of the paper. Fields named `max_error`, `mean_error`
    (metres), `ratio` or `size` (bytes) are the targets that this codec can meet. `name` is stored in files: never
    change it.
    """

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]
    name: ClassVar[str]

    def encode(self, recording: RecordingT, /) -> Encoded[RecordingT]:
        """Raises CannotEncode if the recording cannot be coded with these settings, BadInput for unusable settings."""
        ...

    @staticmethod
    def decode(encoded: Encoded[RecordingT], frames: slice | None = None) -> RecordingT:
        """The recording, or a slice of its frames; the same as the slice of the whole. Raises Corrupt."""
        ...


def settings(codec: Codec[Any]) -> dict[str, Any]:
    """The settings that differ from the defaults, as JSON values: stored in the file as provenance."""
    changed: dict[str, Any] = {}
    for f in dataclasses.fields(codec):
        value = getattr(codec, f.name)
        default = f.default_factory() if f.default_factory is not dataclasses.MISSING else f.default
        if value != default:
            changed[f.name] = list(cast("tuple[Any, ...]", value)) if isinstance(value, tuple) else value
    return changed


def require_frames(motion: Motion) -> None:
    """Raises CannotEncode for a motion without frames, without points, or with gaps only."""
    if len(motion) == 0:
        raise CannotEncode("the motion has no frames")
    if motion.points == 0:
        raise CannotEncode("the motion has no points")
    if np.isnan(motion.positions).all():
        raise CannotEncode("every point is missing in every frame")


def not_kept(codec: Codec[Any], recording: Recording) -> list[str]:
    """What a codec will not keep of a recording, in words: known before encoding."""
    if not isinstance(recording, Motion):
        return []
    lost: list[str] = []
    if recording.rotations is not None:
        lost_rotations = getattr(codec, "lost_rotations", None)
        reason = f"{codec.name} codes positions only" if lost_rotations is None else lost_rotations(recording)
        lost += [f"the rotations of the joints ({reason})"] if reason is not None else []
    if recording.skeleton is not None and recording.skeleton.limits is not None:
        lost += ["the limits of the joints"] if lost or recording.rotations is None else []
    return lost
