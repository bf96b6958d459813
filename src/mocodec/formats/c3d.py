"""C3D: markers, analog channels, events and parameters of a capture (www.c3d.org, the user guide of 2008).

    512-byte header · parameter section · data: per frame, 4 words a point (x y z, cameras and residual), then analog
                      └─ read into a tree       └─ NumPy views of the file's bytes

Every count is checked against the file's size before anything is allocated. Intel, DEC and MIPS files, integer and
float, are read; Intel float files are written. What is kept and how: docs/formats.md.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..motion import Floats, Motion, Signal
from . import replace_whole

BLOCK = 512
INTEL, DEC, MIPS = 84, 85, 86
HEADER_EVENTS = 12345  # the key word that says that the header's events have four-character labels
UNITS_M = {"mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0, "in": 0.0254, "inch": 0.0254, "inches": 0.0254, "ft": 0.3048}

# What follows from the motion itself: written from it, and not kept beside it.
DERIVED = {
    "POINT": ("USED", "FRAMES", "LONG_FRAMES", "DATA_START", "RATE", "UNITS", "LABELS"),
    "ANALOG": ("USED", "RATE", "LABELS", "UNITS"),
    "EVENT": ("USED", "TIMES", "LABELS", "CONTEXTS", "DESCRIPTIONS", "SUBJECTS", "ICON_IDS", "GENERIC_FLAGS"),
    "ROTATION": ("DATA_START",),
}
OWN_GROUPS = ("POINT", "ANALOG", "EVENT", "TRIAL", "ROTATION", "FORCE_PLATFORM")  # ours to read: capitals, whatever the file has
EVENT_FIELDS = {
    "LABELS": "label", "CONTEXTS": "context", "DESCRIPTIONS": "description", "SUBJECTS": "subject",
    "ICON_IDS": "icon_id", "GENERIC_FLAGS": "generic_flag",
}  # fmt: skip


@dataclass
class Parameters:
    """The parameter section: {group: {name: value}}. A number is an array of the file's type (int8, int16, float32)
    in the file's shape; text is a string or lists of strings. notes: descriptions by "GROUP" or "GROUP:NAME"."""

    groups: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    locked: list[str] = field(default_factory=list)

    def number(self, group: str, name: str) -> float | None:
        """The first number of a parameter, or None where there is none."""
        value = self.groups.get(group, {}).get(name)
        return float(value.flat[0]) if isinstance(value, np.ndarray) and value.size else None

    def count(self, group: str, name: str) -> int | None:
        """The first number read as an unsigned 16-bit count (a float where the file has one)."""
        value = self.number(group, name)
        if value is None or not math.isfinite(value):
            return None
        return int(value) & 0xFFFF if self.groups[group][name].dtype != np.float32 else int(value)

    def double_word(self, group: str, name: str) -> int | None:
        """Two 16-bit words, low one first, as one count."""
        value = self.groups.get(group, {}).get(name)
        if not isinstance(value, np.ndarray) or value.dtype != np.int16 or value.size < 2:
            return None
        low, high = value.ravel(order="F").astype(np.int64)[:2] & 0xFFFF
        return int(low | high << 16)

    def texts(self, group: str, name: str) -> list[str]:
        """A text parameter and those that continue it (LABELS, LABELS2, LABELS3, …) as one list."""
        result: list[str] = []
        for number in range(1, 1000):
            value = self.groups.get(group, {}).get(name if number == 1 else f"{name}{number}")
            if value is None:
                break
            result += [value] if isinstance(value, str) else [v for v in value if isinstance(v, str)]
        return result


# ------------------------------------------------------------------------------------------------------------ reading


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
    section = (data[0] - 1) * BLOCK
    if section + 4 > len(data):
        raise BadInput(f"cut off: the parameters should begin at byte {section}, the file has {len(data)}")
    processor = data[section + 3]
    if processor not in (INTEL, DEC, MIPS):
        raise BadInput(f"unknown processor type {processor} (known: 84 Intel, 85 DEC, 86 MIPS)")
    order = ">" if processor == MIPS else "<"
    words = struct.unpack_from(f"{order}256H", data)
    header_scale, header_rate = (float(_floats(data[at : at + 4], processor)[0]) for at in (12, 20))
    parameters = _parameters(data, section, processor)

    def declared(group: str, name: str, otherwise: int) -> int:
        count = parameters.count(group, name)
        return otherwise if count is None else count

    points = declared("POINT", "USED", words[1])
    per_frame = words[9] if words[2] else 0  # analog samples of one channel in a frame
    channels = words[2] // per_frame if per_frame else 0
    if points == 0:
        rotations = parameters.count("ROTATION", "USED") or 0
        raise BadInput(f"has no points, only {channels} analog channels and {rotations} rotations: nothing to code")
    scale = parameters.number("POINT", "SCALE")
    scale = header_scale if not scale else scale
    rate = parameters.number("POINT", "RATE") or header_rate
    if not (math.isfinite(scale) and scale) or not (math.isfinite(rate) and rate > 0):
        raise BadInput(f"its point scale ({scale}) or frame rate ({rate}) is not usable")
    is_float = scale < 0

    start = (declared("POINT", "DATA_START", 0) or words[8]) - 1
    start = (start if start > 0 else words[8] - 1) * BLOCK
    width = 4 * points + channels * per_frame
    frames = _frames(parameters, words, len(data) - start, width * (4 if is_float else 2))
    count = frames * width
    if is_float:
        table = _floats(data[start : start + 4 * count], processor).reshape(frames, width)
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


def _floats(data: bytes, processor: int) -> NDArray[np.float32]:
    """Four-byte floats as the machine that wrote the file had them."""
    if processor != DEC:
        return np.frombuffer(data, "<f4" if processor == INTEL else ">f4").astype(np.float32)
    pairs = np.frombuffer(data, "<u2").reshape(-1, 2).astype(np.uint32)
    bits = pairs[:, 0] << 16 | pairs[:, 1]
    with np.errstate(invalid="ignore"):
        return np.where(bits & 0x7F800000, bits.view(np.float32) / 4, 0).astype(np.float32)


def _parameters(data: bytes, section: int, processor: int) -> Parameters:
    """Walk the parameter section: records of groups (negative number) and of their parameters (positive)."""
    order = ">" if processor == MIPS else "<"
    result = Parameters()
    group_names: dict[int, str] = {}
    records: list[tuple[int, str, Any, str, bool]] = []
    at = section + 4
    while at + 2 <= len(data):
        name_length, number = struct.unpack_from("bb", data, at)
        if number == 0 or name_length == 0:
            break
        name_end = at + 2 + abs(name_length)
        if name_end + 3 > len(data):
            raise BadInput(f"cut off or damaged: a parameter's record runs past the end at byte {at}")
        name = _text(data[at + 2 : name_end])
        (step,) = struct.unpack_from(f"{order}H", data, name_end)
        body = name_end + 2
        if number < 0:
            name = name.upper() if name.upper() in OWN_GROUPS else name
            note = _text(data[body + 1 : body + 1 + data[body]])
            group_names.setdefault(-number, name)
            result.groups.setdefault(name, {})
            if note:
                result.notes[name] = note
            if name_length < 0:
                result.locked.append(name)
        else:
            value, body = _value(data, body, name, processor)
            note = _text(data[body + 1 : body + 1 + data[body]]) if body < len(data) else ""
            records.append((number, name, value, note, name_length < 0))
        if step == 0:
            break
        at = name_end + step
    for number, name, value, note, locked in records:
        group = group_names.setdefault(number, f"GROUP{number}")
        name = name.upper() if group in OWN_GROUPS else name
        result.groups.setdefault(group, {})[name] = value
        if note:
            result.notes[f"{group}:{name}"] = note
        if locked:
            result.locked.append(f"{group}:{name}")
    return result


def _value(data: bytes, at: int, name: str, processor: int) -> tuple[Any, int]:
    """The value of the parameter whose type stands at `at`, and where its description begins."""
    kind, rank = struct.unpack_from("bB", data, at)
    if kind not in (-1, 1, 2, 4) or rank > 7 or at + 2 + rank > len(data):
        raise BadInput(f"damaged: parameter {name} at byte {at} has type {kind} and {rank} dimensions")
    shape = tuple(data[at + 2 : at + 2 + rank])
    at += 2 + rank
    count = math.prod(shape)
    stop = at + count * abs(kind)
    if stop > len(data):
        raise BadInput(f"cut off or damaged: parameter {name} of {count} values runs past the end at byte {at}")
    raw = data[at:stop]
    if kind == -1:
        width, *rest = shape or (1,)
        texts: Any = [_text(raw[i * width : (i + 1) * width]) for i in range(math.prod(rest))]
        for length in rest[:-1]:
            texts = [texts[i : i + length] for i in range(0, len(texts), length)] if length else []
        return (texts if rest else texts[0]), stop
    if kind == 4:
        numbers: NDArray[Any] = _floats(raw, processor)
    else:
        numbers = np.frombuffer(raw, np.int8 if kind == 1 else (">i2" if processor == MIPS else "<i2"))
        numbers = numbers.astype(np.int8 if kind == 1 else np.int16)
    return numbers.reshape(shape, order="F"), stop


def _text(raw: bytes) -> str:
    """Text without its padding: UTF-8 where it is valid, the Western European set of old files otherwise."""
    raw = raw.split(b"\0", 1)[0].rstrip()
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


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
        counts = _smallest(counts)
    elif "".join(parameters.texts("ANALOG", "FORMAT")).upper().startswith("UNSIGNED"):
        counts = counts.astype(np.int16).view(np.uint16)
    else:
        counts = counts.astype(np.int16)
    labels = tuple(parameters.texts("ANALOG", "LABELS")[:channels])
    return Signal(counts, rate * per_frame, labels, tuple(parameters.texts("ANALOG", "UNITS")[:channels]))


def _smallest(values: NDArray[Any]) -> NDArray[Any]:
    """Floats that are whole 16-bit numbers, as such; others as they are."""
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.int16)
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
        if name == "OFFSET" and signal.values.dtype == np.uint16:
            given %= 65536
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
    times = _floats(data[304:376], processor).tolist()
    return [
        {"label": _text(data[396 + 4 * i : 400 + 4 * i]), "time_s": times[i], "in_header": data[376 + i]}
        for i in range(min(words[150], 18))
        if math.isfinite(times[i])
    ]


def _keep_residuals(
    word: NDArray[Any], gap: NDArray[np.bool_], keep: bool | None, rate: float, source: dict[str, Any], extras: dict[str, Any]
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


RESIDUALS_SHARE = 0.002  # of the float32 positions' bytes: a tenth of what they are compressed to at 50 : 1


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
    values = _floats(data[start : start + 4 * count], processor).reshape(frames * ratio, used, 17)
    extras["rotations"] = Signal(values, rate * ratio)


def _up(parameters: Parameters, positions: Floats, source: dict[str, Any]) -> str:
    """The vertical axis: that of the screen's Y (POINT:Y_SCREEN), or what the motion looks like."""
    screen = "".join(parameters.texts("POINT", "Y_SCREEN"))[-1:].lower()
    if screen in ("x", "y", "z") and screen:
        return screen
    source["up_guessed"] = True
    return guess_up(positions)


def guess_up(positions: Floats) -> str:
    """The vertical axis, "y" or "z", of people on a floor: along it the lowest point of a frame stays where it is while
    the body extends far. The score is (standard deviation of the lowest point + 2 cm) / (median extent); the smaller wins.
    """
    some = positions[:: max(1, len(positions) // 500)]
    some = some[~np.isnan(some[:, :, 0]).all(axis=1)]
    if not len(some):
        return "z"
    lowest, highest = np.nanmin(some, axis=1), np.nanmax(some, axis=1)
    scores = (lowest.std(axis=0) + 0.02) / (np.median(highest - lowest, axis=0) + 1e-6)
    return "y" if scores[1] < scores[2] else "z"


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
            if name in groups.get(group, {}) and _same(groups[group][name], value):
                del groups[group][name]
    if groups:
        extras["parameters"] = groups
    notes = {key: note for key, note in parameters.notes.items() if note}
    if notes:
        extras["parameter_notes"] = notes
    if parameters.locked:
        extras["parameters_locked"] = parameters.locked


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and np.array_equal(a, b)
    return type(a) is type(b) and a == b


# ------------------------------------------------------------------------------------------------------------ writing


def _none(dtype: type) -> NDArray[Any]:
    return np.empty(0, dtype)


# Groups that every reader of C3D expects to find; a file that says the same does not need it kept.
STANDARD: dict[str, dict[str, Any]] = {
    "ANALOG": {
        "DESCRIPTIONS": [], "GEN_SCALE": np.ones(1, np.float32), "SCALE": _none(np.float32), "OFFSET": _none(np.int16),
    },
    "FORCE_PLATFORM": {
        "USED": np.zeros(1, np.int16), "TYPE": _none(np.int16), "ZERO": np.array([1, 0], np.int16),
        "CORNERS": _none(np.float32), "ORIGIN": _none(np.float32), "CHANNEL": _none(np.int16),
    },
    "EVENT": {
        "CONTEXTS": [], "ICON_IDS": _none(np.int16), "LABELS": [], "DESCRIPTIONS": [], "SUBJECTS": [],
        "TIMES": np.empty((2, 0), np.float32), "GENERIC_FLAGS": _none(np.int16), "USED": np.zeros(1, np.int16),
    },
}  # fmt: skip


def write(path: str | Path, motion: Motion) -> None:
    """Write a C3D (Intel, float): positions in the source's unit, gaps as residual −1, and all that `read` kept.

    Raises BadInput for what the format cannot hold: more than 65,535 points, or parameters of more than 255 blocks.
    """
    replace_whole(path, _packed(motion))


def _packed(motion: Motion) -> bytes:
    frames, points = motion.positions.shape[:2]
    if not 0 < points <= 0xFFFF:
        raise BadInput(f"a C3D holds 1 to 65535 points, not {points}")
    if frames == 0:
        raise BadInput("a C3D needs at least one frame")
    source, extras = motion.source, motion.extras
    from_c3d = source.get("format") == "c3d"
    units, unit_m = (source["units"], source["unit_m"]) if from_c3d else ("mm", 1e-3)
    first = int(source.get("first_frame", 1))

    kept = extras.get("parameters", {})
    parameters = Parameters({name: dict(kept.get(name, {})) for name in ("POINT", "ANALOG", "FORCE_PLATFORM")})
    parameters.groups |= {name: dict(group) for name, group in kept.items() if name not in parameters.groups}
    for group, standard in STANDARD.items():
        if group in parameters.groups:
            parameters.groups[group] = standard | parameters.groups[group]
    analog_signal = extras.get("analog")
    samples = _frame_samples(analog_signal, frames, motion.rate, "analog") if analog_signal is not None else None
    per_frame, channels = samples.shape[1:] if samples is not None else (1, 0)

    point, analog_group = parameters.groups["POINT"], parameters.groups["ANALOG"]
    scale = abs(parameters.number("POINT", "SCALE") or 0.1)
    point["USED"] = _counts(points)
    point["FRAMES"] = _counts(min(frames, 0xFFFF))
    point["DATA_START"] = _counts(0)
    point["SCALE"] = np.array([-scale], np.float32)
    point["RATE"] = np.array([motion.rate], np.float32)
    point["UNITS"] = [units]
    if not from_c3d:
        point |= {"X_SCREEN": ["+X"], "Y_SCREEN": [f"+{motion.up.upper()}"]}
    _set_texts(point, "LABELS", list(motion.names))
    last = first + frames - 1
    if last > 0xFFFF or "ACTUAL_END_FIELD" in parameters.groups.get("TRIAL", {}):
        trial = parameters.groups.setdefault("TRIAL", {})
        trial["ACTUAL_START_FIELD"] = _counts(first & 0xFFFF, first >> 16)
        trial["ACTUAL_END_FIELD"] = _counts(last & 0xFFFF, last >> 16)
    if frames > 0xFFFF:
        point["LONG_FRAMES"] = np.array([frames], np.float32)
    analog_group["USED"] = _counts(channels)
    analog_group["RATE"] = np.array([motion.rate * per_frame if channels else 0], np.float32)
    if channels:
        labels = list(analog_signal.labels)
        _set_texts(analog_group, "LABELS", labels + [f"A{i + 1}" for i in range(len(labels), channels)])
        _set_texts(analog_group, "UNITS", list(analog_signal.units))
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
    block[:, :, 3] = _frame_samples(extras["residuals"], frames, motion.rate, "residuals")[:, 0] if (
        "residuals" in extras
    ) else source.get("residual_word", 0.0)
    block[gap, 3] = -1.0
    table[:, : 4 * points] = block.reshape(frames, -1)
    if samples is not None:
        table[:, 4 * points :] = samples.reshape(frames, -1)

    section = _pack_parameters(parameters)
    data_start = 2 + len(section) // BLOCK
    body = _padded(table.tobytes())
    point["DATA_START"] = _counts(data_start)
    if rotations is not None:
        group = parameters.groups.setdefault("ROTATION", {})
        group["DATA_START"] = _counts(0)
        data_start = 2 + len(_pack_parameters(parameters)) // BLOCK
        group["DATA_START"], point["DATA_START"] = _counts(data_start + len(body) // BLOCK), _counts(data_start)
        if data_start + len(body) // BLOCK > 0xFFFF:
            raise BadInput("the rotations of this motion begin beyond what a C3D can point to")
        body += _padded(rotations.astype("<f4").tobytes())
    section = _pack_parameters(parameters)

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
            header[396 + 4 * i : 400 + 4 * i] = _encoded(event["label"], 4).ljust(4)
    return bytes(header) + section + body


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % BLOCK)


def _counts(*values: int) -> NDArray[np.int16]:
    """Unsigned 16-bit counts in the signed words of a C3D."""
    return np.array(values, np.uint16).view(np.int16)


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
        group["USED"] = _counts(len(events))
        group["TIMES"] = np.array([minutes, seconds], np.float32)
        for name, key in EVENT_FIELDS.items():
            if name.endswith("S") and any(key in event for event in events) or name == "LABELS":
                if key in ("icon_id", "generic_flag"):
                    group[name] = np.array([event.get(key, 0) for event in events], np.int16)
                else:
                    group[name] = [str(event.get(key, "")) for event in events]
    return in_header


def _pack_parameters(parameters: Parameters) -> bytes:
    """The parameter section, padded to whole blocks. Raises BadInput where it does not fit 255 of them."""
    out = bytearray(4)
    locked = set(parameters.locked)

    def record(name: str, number: int, key: str, body: bytes) -> None:
        label = _encoded(name, 127)
        body += bytes([len(note := _encoded(parameters.notes.get(key, ""), 255))]) + note
        if len(body) + 2 > 0xFFFF:
            raise BadInput(f"parameter {key} is too long for a C3D")
        out.extend(struct.pack("<bb", -len(label) if key in locked else len(label), number))
        out.extend(label + struct.pack("<H", len(body) + 2) + body)

    if len(parameters.groups) > 127:
        raise BadInput(f"a C3D holds 127 groups of parameters, not {len(parameters.groups)}")
    for number, (group, values) in enumerate(parameters.groups.items(), 1):
        record(group, -number, group, b"")
        for name, value in values.items():
            record(name, number, f"{group}:{name}", _pack_value(f"{group}:{name}", value))
    out.extend(b"\0\0")
    blocks = -(-len(out) // BLOCK)
    if blocks > 255:
        raise BadInput(f"the parameters fill {blocks} blocks of 512 bytes; a C3D holds 255")
    out[:4] = bytes([1, 0x50, blocks, INTEL])
    return _padded(bytes(out))


def _pack_value(key: str, value: Any) -> bytes:
    if isinstance(value, np.ndarray):
        if value.dtype not in (np.int8, np.int16, np.float32) or value.ndim > 7 or max(value.shape, default=0) > 255:
            raise BadInput(f"parameter {key}: a C3D holds int8, int16 and float32 of up to 255 a side, not {value.dtype}")
        head = struct.pack("bB", value.dtype.itemsize, value.ndim) + bytes(value.shape)
        return head + value.astype(value.dtype.newbyteorder("<")).tobytes(order="F")
    shape: list[int] = []
    texts = [value]
    while texts and not isinstance(texts[0], str) or (not texts and not shape):
        shape.append(len(texts[0]) if texts else 0)
        texts = [text for part in texts for text in part]
    raw = [_encoded(text, 255) for text in texts]
    width = max(map(len, raw), default=0)
    if max(shape, default=0) > 255 or len(shape) > 6:
        raise BadInput(f"parameter {key}: a C3D holds up to 255 texts a side, not {max(shape)}")
    return struct.pack("bB", -1, 1 + len(shape)) + bytes([width, *shape[::-1]]) + b"".join(t.ljust(width) for t in raw)


def _encoded(text: str, limit: int) -> bytes:
    raw = text.encode("utf-8")
    if len(raw) > limit:
        raise BadInput(f"{text[:40]!r}… is longer than the {limit} bytes that a C3D has for it")
    return raw
