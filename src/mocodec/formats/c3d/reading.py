"""C3D to Motion: header, parameters, then views of the data; every count is checked against the file's size first."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...motion import Floats, Motion, Signal
from ..conventions import UNITS_M, guess_up
from .parameters import (
    BLOCK,
    DEC,
    DERIVED,
    EVENT_FIELDS,
    HEADER_EVENTS,
    INTEL,
    MIPS,
    STANDARD,
    Parameters,
    floats,
    parse,
    same,
    text,
)  # fmt: skip

# Residuals and camera masks are kept unasked below this share of the positions' float32 bytes: a tenth of what those
# are compressed to at 50 : 1.
RESIDUALS_SHARE = 0.002


def read(path: str | Path, residuals: bool | None = None) -> Motion:
    """A C3D file as a motion; positions in metres, in the file's axes.

    A sample with a negative residual or without numbers is a gap. residuals: keep each sample's residual and camera
    mask as `extras["residuals"]`; None keeps them where they take little room (see docs/formats.md). Raises BadInput.
    """
    data = Path(path).read_bytes()
    try:
        return _read(data, residuals)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def _read(data: bytes, keep_residuals: bool | None) -> Motion:
    if len(data) < 2 * BLOCK:
        raise BadInput(f"not a C3D file, or cut off: {len(data)} bytes are fewer than its two first blocks")
    if data[1] != 0x50 or data[0] == 0:
        raise BadInput("not a C3D file: its second byte is not 0x50")
    at = (data[0] - 1) * BLOCK
    if at + 4 > len(data):
        raise BadInput(f"cut off: the parameters should begin at byte {at}, the file has {len(data)}")
    processor = data[at + 3]
    if processor not in (INTEL, DEC, MIPS):
        raise BadInput(f"unknown processor type {processor} (known: 84 Intel, 85 DEC, 86 MIPS)")
    order = ">" if processor == MIPS else "<"
    words = struct.unpack_from(f"{order}256H", data)
    header_scale, header_rate = (float(floats(data[i : i + 4], processor)[0]) for i in (12, 20))
    parameters = parse(data, at, processor)

    def declared(group: str, name: str, otherwise: int) -> int:
        count = parameters.count(group, name)
        return otherwise if count is None else count

    points = declared("POINT", "USED", words[1])
    per_frame = words[9] if words[2] else 0  # analog samples of one channel in a frame
    channels = words[2] // per_frame if per_frame else 0
    if points == 0:
        rotations = parameters.count("ROTATION", "USED") or 0
        raise BadInput(f"has no points, only {channels} analog channels and {rotations} rotations: nothing to code")
    scale = parameters.number("POINT", "SCALE") or header_scale
    rate = parameters.number("POINT", "RATE") or header_rate
    if not (math.isfinite(scale) and scale) or not (math.isfinite(rate) and rate > 0):
        raise BadInput(f"its point scale ({scale}) or frame rate ({rate}) is not usable")
    is_float = scale < 0

    start = ((words[8] or declared("POINT", "DATA_START", 0)) - 1) * BLOCK
    if start < BLOCK:
        raise BadInput("does not say where its data begin")
    width = 4 * points + channels * per_frame
    frames = _frames(parameters, words, len(data) - start, width * (4 if is_float else 2))
    count = frames * width
    if is_float:
        table = floats(data[start : start + 4 * count], processor).reshape(frames, width)
    else:
        table = np.frombuffer(data, f"{order}i2", count, start).reshape(frames, width)
    samples = table[:, : 4 * points].reshape(frames, points, 4)

    units, unit_m = _units(parameters)
    with np.errstate(invalid="ignore", over="ignore"):
        positions = samples[:, :, :3].astype(np.float64) * (unit_m if is_float else scale * unit_m)
        word = samples[:, :, 3]
        gap = (word < 0) | np.isnan(word) | np.isnan(positions).any(axis=2)
    positions[gap] = np.nan
    labels = parameters.texts("POINT", "LABELS")[:points]
    names = tuple(name or f"P{i + 1}" for i, name in enumerate(labels + [""] * (points - len(labels))))

    first = words[3]
    long_first = parameters.double_word("TRIAL", "ACTUAL_START_FIELD")
    if long_first is not None and long_first > 0xFFFF:
        first = long_first
    source: dict[str, Any] = {"format": "c3d", "units": units, "unit_m": unit_m, "first_frame": first}
    extras: dict[str, Any] = {}
    if channels:
        extras["analog"] = _analog(table[:, 4 * points :], channels, per_frame, rate, is_float, parameters)
    events = _header_events(data, words, processor) + _events(parameters)
    if events:
        early = (first - 1) / rate  # times in a C3D count from frame 1
        extras["events"] = [{**event, "time_s": event["time_s"] - early} for event in events]
    _keep_residuals(word, gap, keep_residuals, rate, source, extras)
    _keep_rotations(data, parameters, frames, rate, processor, extras)
    up = _up(parameters, positions, source)
    _keep_parameters(parameters, bool(channels), extras)
    return Motion(positions, rate, names, up, source=source, extras=extras)


def _frames(parameters: Parameters, words: tuple[int, ...], available: int, frame_bytes: int) -> int:
    """The number of frames. The header counts to 65,535; longer files say it in one of three other places.

    Of several counts the one that the file's size agrees with is right. Raises BadInput where the data are cut off.
    """
    header = max(0, words[4] - words[3] + 1) if words[4] else 0
    first, last = (parameters.double_word("TRIAL", f"ACTUAL_{end}_FIELD") for end in ("START", "END"))
    trial = last - first + 1 if first is not None and last is not None else None
    long = parameters.count("POINT", "LONG_FRAMES")
    stated = parameters.count("POINT", "FRAMES")
    claims = [c for c in (trial, long, stated, header) if c is not None and c > 0]
    agreeing = [c for c in claims if 0 <= available - c * frame_bytes < 2 * BLOCK]
    if agreeing:
        return max(agreeing)
    promised = next((c for c in (trial, long) if c is not None and c > 0xFFFF), header or stated or 0)
    if promised == 0:
        raise BadInput("has no frames")
    if promised * frame_bytes > available:
        holds = max(0, available) // frame_bytes
        raise BadInput(f"cut off: its header promises {promised} frames, the file holds {holds} whole ones")
    return promised


def _units(parameters: Parameters) -> tuple[str, float]:
    """POINT:UNITS and metres in one unit; millimetres, the format's custom, where the file does not say."""
    units = next(iter(parameters.texts("POINT", "UNITS")), "") or "mm"
    if units.lower().rstrip(".") not in UNITS_M:
        raise BadInput(f"its points have the unknown unit {units!r}; known: {', '.join(UNITS_M)}")
    return units, UNITS_M[units.lower().rstrip(".")]


def _analog(
    table: NDArray[Any], channels: int, per_frame: int, rate: float, is_float: bool, parameters: Parameters
) -> Signal:
    """Analog samples as the file has them (counts): a physical value is (count − OFFSET) × SCALE × GEN_SCALE."""
    counts = np.ascontiguousarray(table).reshape(-1, channels)
    if is_float:
        counts = _smallest(counts, np.uint16 if _unsigned(parameters) else np.int16)
    else:
        counts = counts.astype(np.int16)
        counts = counts.view(np.uint16) if _unsigned(parameters) else counts
    labels = tuple(parameters.texts("ANALOG", "LABELS")[:channels])
    return Signal(counts, rate * per_frame, labels, tuple(parameters.texts("ANALOG", "UNITS")[:channels]))


def _unsigned(parameters: Parameters) -> bool:
    """Whether analog samples and offsets are without sign: ANALOG:FORMAT says so, however the file stores them."""
    return "".join(parameters.texts("ANALOG", "FORMAT")).strip().upper() == "UNSIGNED"


def _smallest(values: NDArray[Any], dtype: type[np.integer[Any]] = np.int16) -> NDArray[Any]:
    """Floats that are all whole numbers of this 16-bit type, as such; others as they are."""
    with np.errstate(invalid="ignore"):
        whole = values.astype(dtype)
    same = np.array_equal(whole, values) and not np.signbit(values[values == 0]).any()
    return whole if same else values.astype(np.float32)


def analog(motion: Motion) -> Floats:
    """Analog samples in physical units (samples, channels): (count − OFFSET) × SCALE × GEN_SCALE.

    Raises BadInput where the motion has none.
    """
    signal = motion.extras.get("analog")
    if not isinstance(signal, Signal):
        raise BadInput("this motion has no analog channels")
    parameters = Parameters(dict(motion.extras.get("parameters", {})))
    channels = signal.values.shape[1]

    def by_channel(name: str, otherwise: float) -> Floats:
        value = parameters.groups.get("ANALOG", {}).get(name)
        given = np.ravel(value).astype(np.float64)[:channels] if isinstance(value, np.ndarray) else np.empty(0)
        if name == "OFFSET" and _unsigned(parameters):
            given %= 65536  # a negative offset is one where samples have signs
        return np.concatenate([given, np.full(channels - len(given), otherwise)])

    general = parameters.number("ANALOG", "GEN_SCALE")
    scale = by_channel("SCALE", 1.0) * (1.0 if general is None else general)
    return (signal.values - by_channel("OFFSET", 0.0)) * scale


def _events(parameters: Parameters) -> list[dict[str, Any]]:
    """Events of the EVENT group, times from frame 1."""
    group = parameters.groups.get("EVENT", {})
    times = group.get("TIMES")
    if not isinstance(times, np.ndarray) or times.ndim != 2 or times.shape[0] != 2:
        return []
    count = min(parameters.count("EVENT", "USED") or 0, times.shape[1])
    columns: dict[str, Any] = {}
    for name, key in EVENT_FIELDS.items():
        value = group.get(name)
        columns[key] = parameters.texts("EVENT", name) if not isinstance(value, np.ndarray) else value.ravel().tolist()
    events = []
    for i, (minutes, seconds) in enumerate(times.T[:count].tolist()):
        if not math.isfinite(minutes + seconds):
            continue
        event: dict[str, Any] = {"label": "", "time_s": 60.0 * minutes + seconds}
        event |= {key: values[i] for key, values in columns.items() if i < len(values) and values[i]}
        events.append(event | ({"minutes": int(minutes)} if minutes else {}))
    return events


def _header_events(data: bytes, words: tuple[int, ...], processor: int) -> list[dict[str, Any]]:
    """Up to 18 events that older files have in their header."""
    if words[149] != HEADER_EVENTS:
        return []
    times = floats(data[304:376], processor).tolist()
    return [
        {"label": text(data[396 + 4 * i : 400 + 4 * i]), "time_s": times[i], "in_header": data[376 + i]}
        for i in range(min(words[150], 18))
        if math.isfinite(times[i])
    ]


def _keep_residuals(
    word: NDArray[Any],
    gap: NDArray[np.bool_],
    keep: bool | None,
    rate: float,
    source: dict[str, Any],
    extras: dict[str, Any],
) -> None:
    """The fourth word of a sample: camera mask in its high byte, residual in its low byte."""
    there = word[~gap]
    if keep is False or there.size == 0 or not np.any(there):
        return
    if np.all(there == there[0]):
        source["residual_word"] = float(there[0])
        return
    kept = _smallest(np.where(gap, -1, word))
    size = len(zlib.compress(np.ascontiguousarray(kept.T).tobytes(), 1))
    if keep or size <= RESIDUALS_SHARE * 12 * word.size:
        extras["residuals"] = Signal(kept, rate)
    else:
        source["residuals"] = "left out"


def _keep_rotations(
    data: bytes, parameters: Parameters, frames: int, rate: float, processor: int, extras: dict[str, Any]
) -> None:
    """Segment poses of the ROTATION group: per frame and segment a 4 × 4 matrix by columns and a reliability."""
    used = parameters.count("ROTATION", "USED")
    block = parameters.count("ROTATION", "DATA_START")
    if not used or not block:
        return
    ratio = parameters.count("ROTATION", "RATIO") or 1
    start, count = (block - 1) * BLOCK, frames * ratio * used * 17
    if start + 4 * count > len(data):
        raise BadInput(f"cut off: {used} rotations in {frames * ratio} samples run past the end of the file")
    values = floats(data[start : start + 4 * count], processor).reshape(frames * ratio, used, 17)
    extras["rotations"] = Signal(values, rate * ratio)


def _up(parameters: Parameters, positions: Floats, source: dict[str, Any]) -> str:
    """The vertical axis: that of the screen's Y (POINT:Y_SCREEN), or what the motion looks like."""
    screen = "".join(parameters.texts("POINT", "Y_SCREEN"))[-1:].lower()
    if screen in ("x", "y", "z") and screen:
        return screen
    source["up_guessed"] = True
    return guess_up(positions)


def _keep_parameters(parameters: Parameters, has_analog: bool, extras: dict[str, Any]) -> None:
    """Put the tree beside the motion, without what follows from the motion or is what `write` puts there anyway."""
    groups = {name: dict(group) for name, group in parameters.groups.items()}
    for group, names in DERIVED.items():
        for key in list(groups.get(group, ())):
            base = key.rstrip("0123456789") if key.startswith(("LABELS", "UNITS")) else key
            if base in names and not (group == "ANALOG" and not has_analog and np.size(groups[group][key]) > 1):
                del groups[group][key]
    for group, standard in STANDARD.items():
        for name, value in standard.items():
            if name in groups.get(group, {}) and same(groups[group][name], value):
                del groups[group][name]
    if groups:
        extras["parameters"] = groups
    notes = {key: note for key, note in parameters.notes.items() if note}
    if notes:
        extras["parameter_notes"] = notes
    if parameters.locked:
        extras["parameters_locked"] = parameters.locked
