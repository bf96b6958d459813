"""Motion to C3D: Intel, float, with all that reading kept."""

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
from .parameters import BLOCK, EVENT_FIELDS, HEADER_EVENTS, STANDARD, Parameters, counts, encoded, pack, padded


def write(path: str | Path, motion: Motion) -> None:
    """Write a C3D (Intel, float): positions in the source's unit, gaps as residual −1, and all that `read` kept.

    Raises BadInput for what the format cannot hold: more than 65,535 points, or parameters of more than 255 blocks.
    """
    try:
        data = _packed(motion)
    except (AttributeError, KeyError, IndexError, TypeError, ValueError, OverflowError, struct.error) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"{path}: what is beside the points is not what a C3D has ({error!r})") from error
    replace_whole(path, data)


def _packed(motion: Motion) -> bytes:
    frames, points = motion.positions.shape[:2]
    if not 0 < points <= 0xFFFF:
        raise BadInput(f"a C3D holds 1 to 65535 points, not {points}")
    if frames == 0:
        raise BadInput("a C3D needs at least one frame")
    source, extras = motion.source, motion.extras
    its_own = source.get("format") == "c3d" and "units" in source
    units, unit_m = (str(source["units"]), unit_of(source)) if its_own else ("mm", 1e-3)
    first = first_frame(source)

    kept = extras.get("parameters", {})
    parameters = Parameters({name: dict(kept.get(name, {})) for name in ("POINT", "ANALOG", "FORCE_PLATFORM")})
    parameters.groups |= {name: dict(group) for name, group in kept.items() if name not in parameters.groups}
    for group, standard in STANDARD.items():
        if group in parameters.groups:
            parameters.groups[group] = standard | parameters.groups[group]
    analog = extras.get("analog", Signal(np.empty((frames, 0)), motion.rate))
    samples = _frame_samples(analog, frames, motion.rate, "analog")
    per_frame, channels = samples.shape[1:]

    point, analog_group = parameters.groups["POINT"], parameters.groups["ANALOG"]
    scale = abs(parameters.number("POINT", "SCALE") or 0.1)
    point["USED"] = counts(points)
    point["FRAMES"] = counts(min(frames, 0xFFFF))
    point["DATA_START"] = counts(0)
    point["SCALE"] = _like(point.get("SCALE"), -scale)
    point["RATE"] = np.array([motion.rate], np.float32)
    point["UNITS"] = [units]
    screen = "".join(parameters.texts("POINT", "Y_SCREEN"))[-1:].lower()
    if screen != motion.up and (screen or not source.get("up_guessed")):
        point |= {"X_SCREEN": ["+X"], "Y_SCREEN": [f"+{motion.up.upper()}"]}
    _set_texts(point, "LABELS", list(motion.names))
    last = first + frames - 1
    if last > 0xFFFF or "ACTUAL_END_FIELD" in parameters.groups.get("TRIAL", {}):
        trial = parameters.groups.setdefault("TRIAL", {})
        trial["ACTUAL_START_FIELD"] = counts(first & 0xFFFF, first >> 16)
        trial["ACTUAL_END_FIELD"] = counts(last & 0xFFFF, last >> 16)
    if frames > 0xFFFF or "LONG_FRAMES" in point:
        point["LONG_FRAMES"] = _like(point.get("LONG_FRAMES"), frames)
    analog_group["USED"] = counts(channels)
    analog_group["RATE"] = np.array([motion.rate * per_frame if channels else 0], np.float32)
    if samples.dtype == np.uint16:
        analog_group["FORMAT"] = "UNSIGNED"
    if channels:
        labels = list(analog.labels)
        _set_texts(analog_group, "LABELS", labels + [f"A{i + 1}" for i in range(len(labels), channels)])
        _set_texts(analog_group, "UNITS", list(analog.units))
        for name, otherwise in (("SCALE", np.float32(1)), ("OFFSET", np.int16(0))):
            if not np.size(analog_group[name]):
                analog_group[name] = np.full(channels, otherwise)
    else:
        for name in ("LABELS", "UNITS"):
            analog_group.setdefault(name, [])
    in_header = _put_events(parameters, list(extras.get("events", ())), (first - 1) / motion.rate)
    rotations = _frame_samples(extras["rotations"], frames, motion.rate, "rotations") if "rotations" in extras else None
    parameters.notes = dict(extras.get("parameter_notes", {}))
    parameters.locked = list(extras.get("parameters_locked", []))

    width = 4 * points + per_frame * channels
    table = np.zeros((frames, width), "<f4")
    block = table[:, : 4 * points].reshape(frames, points, 4)
    gap = motion.gaps
    with np.errstate(over="ignore"):
        block[:, :, :3] = np.where(gap[:, :, None], 0.0, motion.positions / unit_m)
    if np.isinf(block).any():
        raise BadInput(f"a position does not fit a C3D's 32-bit floats in {units}")
    if "residuals" in extras:
        block[:, :, 3] = _frame_samples(extras["residuals"], frames, motion.rate, "residuals")[:, 0]
    else:
        block[:, :, 3] = np.clip(source.get("residual_word", 0.0), -0x8000, 0x7FFF)
    block[gap, 3] = -1.0
    table[:, : 4 * points] = block.reshape(frames, -1)
    table[:, 4 * points :] = samples.reshape(frames, -1)

    section = pack(parameters)
    data_start = 2 + len(section) // BLOCK
    body = padded(table.tobytes())
    point["DATA_START"] = counts(data_start)
    if rotations is not None:
        group = parameters.groups.setdefault("ROTATION", {})
        group["DATA_START"] = counts(0)
        data_start = 2 + len(pack(parameters)) // BLOCK
        group["DATA_START"], point["DATA_START"] = counts(data_start + len(body) // BLOCK), counts(data_start)
        if data_start + len(body) // BLOCK > 0xFFFF:
            raise BadInput("the rotations of this motion begin beyond what a C3D can point to")
        body += padded(rotations.astype("<f4").tobytes())
    section = pack(parameters)

    header = bytearray(BLOCK)
    ends = min(first, 0xFFFF), min(last, 0xFFFF)
    struct.pack_into("<BBHHHHHfHHf", header, 0, 2, 0x50, points, per_frame * channels, *ends, 0, -scale, data_start,
                     per_frame if channels else 0, motion.rate)  # fmt: skip
    if in_header:
        early = (first - 1) / motion.rate
        struct.pack_into("<HH", header, 298, HEADER_EVENTS, len(in_header))
        for i, event in enumerate(in_header):
            struct.pack_into("<f", header, 304 + 4 * i, event["time_s"] + early)
            header[376 + i] = event["in_header"]
            header[396 + 4 * i : 400 + 4 * i] = encoded(event["label"], 4).ljust(4)
    return bytes(header) + section + body


def _like(before: Any, value: float) -> NDArray[np.float32]:
    """One number, as a scalar or as a list of one, whichever it was."""
    return np.full(() if isinstance(before, np.ndarray) and before.ndim == 0 else (1,), value, np.float32)


def _frame_samples(signal: Any, frames: int, rate: float, what: str) -> NDArray[Any]:
    """A signal's samples as (frames, samples a frame, …). Raises BadInput where they do not fit the frames."""
    values = np.asarray(signal.values)
    per_frame = round(signal.rate / rate)
    if values.ndim < 2 or per_frame < 1 or len(values) != frames * per_frame:
        raise BadInput(f"{len(values)} samples of {what} at {signal.rate} Hz do not fit {frames} frames at {rate} Hz")
    return values.reshape(frames, per_frame, *values.shape[1:])


def _set_texts(group: dict[str, Any], name: str, texts: list[str]) -> None:
    """A list of texts, continued as NAME2, NAME3, … where it is longer than 255."""
    for key in [key for key in group if key == name or (key.startswith(name) and key[len(name) :].isdigit())]:
        del group[key]
    for number in range(max(1, -(-len(texts) // 255))):
        group[name if number == 0 else f"{name}{number + 1}"] = texts[255 * number : 255 * (number + 1)]


def _put_events(parameters: Parameters, events: list[Any], early: float) -> list[Any]:
    """Events into the EVENT group; those that stood in the header are returned for it."""
    in_header = [event for event in events if "in_header" in event][:18]
    events = [event for event in events if "in_header" not in event]
    if len(events) > 255:
        raise BadInput(f"a C3D holds 255 events, not {len(events)}")
    if events:
        group = parameters.groups.setdefault("EVENT", {})
        minutes = [event.get("minutes", 0) for event in events]
        seconds = [event["time_s"] + early - 60.0 * m for event, m in zip(events, minutes, strict=True)]
        group["USED"] = counts(len(events))
        group["TIMES"] = np.array([minutes, seconds], np.float32)
        for name, key in EVENT_FIELDS.items():
            if (name.endswith("S") and any(key in event for event in events)) or name == "LABELS":
                if key in ("icon_id", "generic_flag"):
                    group[name] = np.array([event.get(key, 0) for event in events], np.int16)
                else:
                    group[name] = [str(event.get(key, "")) for event in events]
    return in_header
