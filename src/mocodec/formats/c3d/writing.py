"""Motion to C3D: Intel, float, with everything that `read` kept.

motion, extras ─► parameters (point, analog, events) ─► table of samples ─► header · parameters · data · rotations
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...motion import Motion, Signal
from .. import replace_whole
from ..conventions import first_frame, unit_of
from ..zeros import parked_of
from .events import put_events, put_header_events
from .labels import original_labels
from .model_outputs import merge
from .parameters import BLOCK, STANDARD, Parameters, counts, pack, padded


def write(path: str | Path, motion: Motion) -> None:
    """Write a C3D (Intel, float): positions in the source's unit, gaps as they were or as residual −1.

    Raises BadInput for data that the format cannot hold: more than 65,535 points, parameters of more than 255 blocks.
    """
    try:
        data = _file(motion)
    except (AttributeError, KeyError, IndexError, TypeError, ValueError, OverflowError, struct.error) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"{path}: the data beside the points do not fit a C3D ({error!r})") from error
    replace_whole(path, data)


def _file(motion: Motion) -> bytes:
    """The whole file."""
    frames = len(motion)
    if not (motion.points or any(name in motion.extras for name in ("analog", "rotations", "model_outputs"))):
        raise BadInput("a C3D holds 1 to 65535 points, not 0")
    if frames == 0:
        raise BadInput("a C3D needs at least one frame")
    source, extras = motion.source, motion.extras
    is_c3d = source.get("format") == "c3d" and "units" in source
    units, unit_m = (str(source["units"]), unit_of(source)) if is_c3d else ("mm", 1e-3)
    analog = extras.get("analog", Signal(np.empty((frames, 0)), motion.rate))
    samples = _by_frame(analog, frames, motion.rate, "analog")
    per_frame, channels = samples.shape[1:]

    parameters = _stored_parameters(motion)
    scale = abs(parameters.number("POINT", "SCALE") or 0.1)
    labels = original_labels(motion.names, motion.source)
    block, labels = merge(motion, _point_block(motion, units, unit_m), labels, parameters)
    points = len(labels)
    if points > 0xFFFF:
        raise BadInput(f"a C3D holds 1 to 65535 points, not {points}")
    _put_point(parameters, motion, units, scale, labels)
    _put_frame_counts(parameters, first_frame(source), frames)
    _put_analog(parameters, analog, samples, motion.rate)
    offset_s = (first_frame(source) - 1) / motion.rate
    in_header = put_events(parameters, list(extras.get("events", ())), offset_s)
    parameters.notes = dict(extras.get("parameter_notes", {}))
    parameters.locked = list(extras.get("parameters_locked", []))
    table = np.concatenate([block.reshape(frames, -1), samples.reshape(frames, -1).astype("<f4")], axis=1)
    section, data_start, body = _place(parameters, padded(table.tobytes()), motion)

    first = first_frame(source)
    ends = min(first, 0xFFFF), min(first + frames - 1, 0xFFFF)
    header = bytearray(BLOCK)
    struct.pack_into("<BBHHHHHfHHf", header, 0, 2, 0x50, points, per_frame * channels, *ends, 0, -scale, data_start,
                     per_frame if channels else 0, motion.rate)  # fmt: skip
    if in_header:
        put_header_events(header, in_header, offset_s)
    return bytes(header) + section + body


def _stored_parameters(motion: Motion) -> Parameters:
    """The parameters that `read` kept, with the standard groups first."""
    kept = motion.extras.get("parameters", {})
    parameters = Parameters({name: dict(kept.get(name, {})) for name in ("POINT", "ANALOG", "FORCE_PLATFORM")})
    parameters.groups |= {name: dict(group) for name, group in kept.items() if name not in parameters.groups}
    for group, standard in STANDARD.items():
        if group in parameters.groups:
            parameters.groups[group] = standard | parameters.groups[group]
    return parameters


def _put_point(parameters: Parameters, motion: Motion, units: str, scale: float, labels: list[str]) -> None:
    point = parameters.groups["POINT"]
    point["USED"] = counts(len(labels))
    point["DATA_START"] = counts(0)  # known later
    point["SCALE"] = _like(point.get("SCALE"), -scale)
    point["RATE"] = np.array([motion.rate], np.float32)
    point["UNITS"] = [units]
    screen = "".join(parameters.texts("POINT", "Y_SCREEN"))[-1:].lower()
    if screen != motion.up and (screen or not motion.source.get("up_guessed")):
        point |= {"X_SCREEN": ["+X"], "Y_SCREEN": [f"+{motion.up.upper()}"]}
    parameters.set_texts("POINT", "LABELS", labels)


def _put_frame_counts(parameters: Parameters, first: int, frames: int) -> None:
    """POINT:FRAMES, and where that saturates or the source has them, LONG_FRAMES and TRIAL:ACTUAL_*."""
    point, last = parameters.groups["POINT"], first + frames - 1
    point["FRAMES"] = counts(min(frames, 0xFFFF))
    if last > 0xFFFF or "ACTUAL_END_FIELD" in parameters.groups.get("TRIAL", {}):
        trial = parameters.groups.setdefault("TRIAL", {})
        trial["ACTUAL_START_FIELD"] = counts(first & 0xFFFF, first >> 16)
        trial["ACTUAL_END_FIELD"] = counts(last & 0xFFFF, last >> 16)
    if frames > 0xFFFF or "LONG_FRAMES" in point:
        point["LONG_FRAMES"] = _like(point.get("LONG_FRAMES"), frames)


def _put_analog(parameters: Parameters, analog: Any, samples: NDArray[Any], rate: float) -> None:
    """The ANALOG group; samples (frames, samples per frame, channels)."""
    per_frame, channels = samples.shape[1:]
    group = parameters.groups["ANALOG"]
    group["USED"] = counts(channels)
    group["RATE"] = np.array([rate * per_frame if channels else 0], np.float32)
    if samples.dtype == np.uint16:
        group["FORMAT"] = "UNSIGNED"
    if not channels:
        for name in ("LABELS", "UNITS"):
            group.setdefault(name, [])
        return
    labels = list(analog.labels)
    parameters.set_texts("ANALOG", "LABELS", labels + [f"A{i + 1}" for i in range(len(labels), channels)])
    parameters.set_texts("ANALOG", "UNITS", list(analog.units))
    for name, default in (("SCALE", np.float32(1)), ("OFFSET", np.int16(0))):
        if not np.size(group[name]):
            parameters.set_chain("ANALOG", name, np.full(channels, default))


def _point_block(motion: Motion, units: str, unit_m: float) -> NDArray[np.float32]:
    """(frames, points, 4): coordinates in the file's unit, and the word of camera mask and residual."""
    frames, points = motion.positions.shape[:2]
    block = np.zeros((frames, points, 4), "<f4")
    gap = motion.gaps
    with np.errstate(over="ignore"):
        block[:, :, :3] = np.where(gap[:, :, None], 0.0, motion.positions / unit_m)
    if np.isinf(block).any():
        raise BadInput(f"a position exceeds a C3D's 32-bit floats in {units}")
    if "residuals" in motion.extras:
        block[:, :, 3] = _by_frame(motion.extras["residuals"], frames, motion.rate, "residuals")[:, 0]
    else:
        block[:, :, 3] = np.clip(motion.source.get("residual_word", 0.0), -0x8000, 0x7FFF)
    block[gap & ~parked_of(motion), 3] = -1.0
    return block


def _place(parameters: Parameters, body: bytes, motion: Motion) -> tuple[bytes, int, bytes]:
    """The parameter section, the block where the data start, and the data with the rotations behind them."""
    point = parameters.groups["POINT"]
    data_start = 2 + len(pack(parameters)) // BLOCK
    point["DATA_START"] = counts(data_start)
    if "rotations" in motion.extras:
        rotations = _by_frame(motion.extras["rotations"], len(motion), motion.rate, "rotations")
        group = parameters.groups.setdefault("ROTATION", {})
        group.setdefault("USED", counts(rotations.shape[2]))
        if rotations.shape[1] > 1:
            group.setdefault("RATIO", counts(rotations.shape[1]))
        group["DATA_START"] = counts(0)
        data_start = 2 + len(pack(parameters)) // BLOCK
        rotations_start = data_start + len(body) // BLOCK
        if rotations_start > 0xFFFF:
            raise BadInput("the rotations of this motion begin beyond the blocks that a C3D can count")
        group["DATA_START"], point["DATA_START"] = counts(rotations_start), counts(data_start)
        body += padded(rotations.astype("<f4").tobytes())
    return pack(parameters), data_start, body


def _like(before: Any, value: float) -> NDArray[np.float32]:
    """One number as a scalar or as a list of one, like the value before."""
    return np.full(() if isinstance(before, np.ndarray) and before.ndim == 0 else (1,), value, np.float32)


def _by_frame(signal: Any, frames: int, rate: float, what: str) -> NDArray[Any]:
    """A signal's samples as (frames, samples per frame, …). Raises BadInput if they do not fit the frames."""
    values = np.asarray(signal.values)
    per_frame = round(signal.rate / rate)
    if values.ndim < 2 or per_frame < 1 or len(values) != frames * per_frame:
        raise BadInput(f"{len(values)} samples of {what} at {signal.rate} Hz do not fit {frames} frames at {rate} Hz")
    return values.reshape(frames, per_frame, *values.shape[1:])
