"""A recording to the bytes of a `.mocz` that meet a size or a ratio for the whole file."""

from __future__ import annotations

import dataclasses
import math
from numbers import Real
from typing import Any, cast

from . import codecs
from . import progress as progress_
from .codecs import rescue
from .codecs.base import Codec
from .encoded import TARGETS, Encoded, Recording, RecordingT
from .errors import BadInput, CannotEncode, MocodecError
from .motion import Motion

DEFAULT_CODECS = ("tempo", "bodycast")
"""The codecs that are used by default: for motion, and for point clouds."""
ATTEMPTS = 5
"""How often a recording is encoded to meet a size or a ratio."""
EASIER = {"size": "larger size", "ratio": "smaller ratio"}
"""What a user can ask for where a target cannot be met."""
SMALLEST_FILE_BYTES = 64
"""About how many bytes a file takes at least, without its extras."""


def pack(codec: Codec[RecordingT], recording: RecordingT, signal_error: str | None = None) -> bytes:
    """Encode, and meet `size` for the whole file and `ratio` for the whole file without extras.

    A codec counts only its own bytes. If the container makes the file too large, the codec encodes again with a target
    that is smaller by the excess. Raises CannotEncode if the target cannot be met. signal_error: as in `encode`.
    """
    from . import container

    _require_kind(codec, recording)
    if signal_error is not None:
        recording = with_signal_error(recording, signal_error)
    promised = {} if signal_error is None else {"signal_error": signal_error}
    target = next((name for name in ("size", "ratio") if getattr(codec, name, None)), None)
    if target is None:
        return container.pack(_with_promises(_encoded(codec, recording), promised))
    if target == "size":
        _require_room(recording, codec)
    with progress_.attempt(0):
        try:
            encoded = _with_promises(_encoded(codec, recording), promised)
        except CannotEncode as error:
            wanted = f"{target} of {getattr(codec, target):,g}"
            raise CannotEncode(
                f"{codec.name} cannot encode this at a {wanted} ({error}): ask for a {EASIER[target]}"
            ) from error
    blob, settings, value = container.pack(encoded), encoded.settings, getattr(codec, target)
    target_bytes: float = value if target == "size" else recording.raw_bytes / value
    limit = target_bytes + (extras_bytes(blob) if target == "ratio" else 0)
    for attempt in range(1, ATTEMPTS):
        if len(blob) <= limit:
            return blob
        target_bytes = math.floor(min(target_bytes, encoded.payload_bytes) - (len(blob) - limit))
        if target_bytes < 1:
            break
        value = target_bytes if target == "size" else recording.raw_bytes / target_bytes
        with progress_.attempt(attempt):
            encoded = _encoded(dataclasses.replace(codec, **{target: value}), recording)
        blob = container.pack(dataclasses.replace(encoded, settings=settings))
    if len(blob) <= limit:
        return blob
    raise CannotEncode(
        f"{codec.name} cannot encode this to a file of {limit:,.0f} bytes, only of {len(blob):,}: "
        f"ask for a {EASIER[target]}"
    )


def _require_kind(codec: Codec[Any], recording: Recording) -> None:
    """Raises CannotEncode for a motion and a codec of point clouds, or the other way round."""
    codes_clouds = codec.name in codecs.CLOUD_CODECS
    if codec.name not in codecs.CODECS or codes_clouds != isinstance(recording, Motion):
        return
    if codes_clouds:
        raise CannotEncode(f"{codec.name} codes point clouds, not motions")
    raise CannotEncode(
        f"{codec.name} codes motions, not point clouds; codecs of point clouds: {', '.join(codecs.CLOUD_CODECS)}"
    )


def _encoded(codec: Codec[RecordingT], recording: RecordingT) -> Encoded[RecordingT]:
    """By the codec, or for a motion by the default codec if an error in mocodec ends the codec; a note says so."""
    try:
        return codec.encode(recording)
    except (MocodecError, MemoryError, OSError):
        raise
    except Exception as error:
        if not rescue.may_rescue(error):
            raise
        failure = rescue.in_words(f"with {codec.name}", error)
        if not isinstance(recording, Motion):
            raise CannotEncode(f"{failure}; try another codec") from error
        targets = {name: value for name in TARGETS if (value := getattr(codec, name, None))}
        names = [name for name in targets if name != "mean_error" or "max_error" not in targets]
        default: Codec[Any] = with_options(DEFAULT_CODECS[0], **{name: targets[name] for name in names})
        encoded = rescue.with_note(default.encode(recording), f"{failure}; {default.name} codes the motion")
        return cast("Encoded[RecordingT]", encoded)


def with_signal_error(recording: RecordingT, signal_error: str) -> RecordingT:
    """The recording with signals within this error. Raises BadInput for an error that does not fit its channels."""
    from .signals import bounds

    return dataclasses.replace(recording, extras=bounds.bounded(recording.extras, signal_error))


def _with_promises(encoded: Encoded[RecordingT], promised: dict[str, str]) -> Encoded[RecordingT]:
    """The encoded recording, whose settings also name these promises."""
    return dataclasses.replace(encoded, settings={**encoded.settings, **promised}) if promised else encoded


def _require_room(recording: Recording, codec: Codec[Any]) -> None:
    """Raises CannotEncode if the extras of a recording alone exceed the size that the codec is asked for."""
    from . import container

    extras, size = container.extras_bytes(recording), cast("int", getattr(codec, "size", 0))
    if extras + SMALLEST_FILE_BYTES > size and extras:
        raise CannotEncode(
            f"{codec.name} cannot encode this to a file of {size:,} bytes: analog channels, events, parameters and "
            f"other extras alone take {extras:,}; ask for a larger size, or leave them out (--bare)"
        )


def extras_bytes(blob: bytes) -> int:
    """Bytes of the extras in a .mocz, signals included."""
    from . import container

    with container.Reader(blob) as reader:
        sizes = reader.info()["bytes_by_part"]
        return sizes["extras"] + sizes["signals"]


def default_codec(recording: Recording) -> str:
    """The name of the codec that is used by default."""
    return DEFAULT_CODECS[0 if isinstance(recording, Motion) else 1]


def with_options(codec: str | Codec[RecordingT], **options: Any) -> Codec[RecordingT]:
    """A codec, by name or instance, with these settings.

    Raises BadInput for a setting that it does not have, and for a target that is no number.
    """
    chosen: Codec[RecordingT] = codecs.codec_class(codec)() if isinstance(codec, str) else codec
    known = [f.name for f in dataclasses.fields(chosen)]
    for name, value in options.items():
        if name in TARGETS and not isinstance(value, Real):
            example = " of metres, such as 0.002," if name.endswith("error") else ","
            raise BadInput(f"{name} must be a number{example} not {value!r}")
        if name not in known:
            what = "target" if name in TARGETS else "setting"
            raise BadInput(f"{chosen.name} has no {what} {name!r}; it has: {', '.join(known)}")
    return dataclasses.replace(chosen, **options)
