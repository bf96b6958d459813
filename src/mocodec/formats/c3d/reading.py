"""C3D to Motion: header, parameters, then views of the data; every count is checked against the file's size first."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...motion import Motion, Signal
from ...typing import Booleans, Floats
from ..conventions import UNITS_M, guess_up, metres_in, unit_option
from ..zeros import parked_at_origin, store_parked, zeros_are_gaps
from .analog import note_analog_rate, read_analog, smallest
from .by_label import find_by_label
from .events import read_events, read_header_events
from .labels import unique_names
from .layout import Bytes, Header, Layout, data_end, data_start, read_header, settle
from .model_outputs import find_columns, keep, output_values
from .parameters import BLOCK, DEC, DERIVED, INTEL, MIPS, STANDARD, Parameters, floats, parse, same

RESIDUALS_SHARE = 0.002
"""Residuals and camera masks are kept by default below this share of the positions' float32 bytes: a tenth of what
these are compressed to at 50 : 1."""


def read(
    path: str | Path,
    residuals: bool | None = None,
    unit: str | float | None = None,
    rate: float | None = None,
    gaps: str | None = None,
    salvage: bool = False,
) -> Motion:
    """A C3D file as a motion; positions in metres, in the file's axes.

    Samples with a negative residual, without numbers, or parked at exactly (0, 0, 0) are gaps; gaps="keep" takes zeros
    as positions. residuals: keep each sample's residual and camera mask as `extras["residuals"]`; None keeps them if
    they are small (docs/formats.md). unit, rate: in place of the file's. salvage: read the complete frames of a
    truncated file. Angles, forces, moments and powers of a model are kept apart (`model_outputs`). Raises BadInput.
    """
    data = Path(path).read_bytes()
    try:
        return _read(data, Options(residuals, unit, rate, zeros_are_gaps(gaps), salvage))
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


class Options(NamedTuple):
    """The options of `read`."""

    residuals: bool | None
    unit: str | float | None
    rate: float | None
    zeros_are_gaps: bool
    salvage: bool


class Opened(NamedTuple):
    """What header and parameters say of the data. scale: units of a number of a coordinate. start: byte of the data."""

    header: Header
    parameters: Parameters
    processor: int
    order: str
    first: int
    rate: float
    start: int
    layout: Layout
    frames: int
    scale: float
    source: dict[str, Any]
    notes: list[str]

    def table(self, data: Bytes, begin: int, end: int) -> NDArray[Any]:
        """The numbers of frames [begin, end), (frames, width)."""
        numbers = data[self.start + begin * self.layout.frame_bytes : self.start + end * self.layout.frame_bytes]
        if self.layout.item == 4:
            return floats(numbers, self.processor).reshape(end - begin, self.layout.width)
        return np.frombuffer(numbers, f"{self.order}i2").reshape(end - begin, self.layout.width)

    def columns(self, table: NDArray[Any]) -> NDArray[Any]:
        """The samples of points (frames, points, 4) in a table."""
        return table[:, : 4 * self.layout.points].reshape(len(table), self.layout.points, 4)

    def samples(self, columns: NDArray[Any]) -> tuple[Floats, NDArray[Any], Booleans]:
        """Positions (frames, points, 3) in metres, the fourth words, and the mask of gaps."""
        with np.errstate(invalid="ignore", over="ignore"):
            positions = columns[:, :, :3].astype(np.float64) * (self.source["unit_m"] * self.scale)
            word = columns[:, :, 3]
            return positions, word, (word < 0) | np.isnan(word) | np.isnan(positions).any(axis=2)


def opened(head: bytes, data: Bytes, options: Options) -> Opened:
    """Header and parameters, checked against the size of the file. head: the bytes from its beginning to the data."""
    processor, order, section = _section(head)
    header = read_header(head, order, processor)
    parameters = parse(head, section, processor, (header.data_block - 1) * BLOCK)
    notes: list[str] = []
    first = _first_frame(header, parameters)
    source: dict[str, Any] = {"format": "c3d", "units": "", "unit_m": 1.0, "first_frame": first}
    source["units"], source["unit_m"] = _unit(parameters, options.unit, source)
    rate = _rate(header, parameters, options.rate, notes)
    start = data_start(header, parameters, data, section + BLOCK * head[section + 2], notes)
    available = data_end(data, parameters, start) - start
    layout, frames = settle(header, parameters, data, start, available, notes, options.salvage)
    if not layout.width and not parameters.count("ROTATION", "USED"):
        raise BadInput("has no points, no analog channels and no rotations: nothing to code")
    if layout.channels:
        note_analog_rate(parameters, rate, layout, notes)
    scale = 1.0 if layout.item == 4 else _scale(header, parameters, notes)
    return Opened(header, parameters, processor, order, first, rate, start, layout, frames, scale, source, notes)


class Beside(NamedTuple):
    """What the data section has beside positions, of whole recordings.

    analog: as stored. outputs (frames, outputs, 3): coordinates of model outputs by kind; output_words: their fourth
    words, kind after kind. words (frames, markers): fourth words, −1 in gaps. parked (frames, markers): gaps that were
    zeros, None without; other_gaps: whether there are others. rotations: segment poses.
    """

    analog: Signal | None
    outputs: Mapping[str, NDArray[Any]]
    output_words: NDArray[Any]
    words: NDArray[Any] | None
    parked: NDArray[Any] | None
    other_gaps: bool
    rotations: Signal | None


def _read(data: bytes, options: Options) -> Motion:
    file = opened(data, data, options)
    layout = file.layout
    table = file.table(data, 0, file.frames)
    columns = file.columns(table)
    labels, outputs, markers = split(file, columns)
    positions, word, gap = file.samples(columns[:, markers] if outputs else columns)
    words = None if options.residuals is False else smallest(np.where(gap, -1, word))
    other_gaps, parked = bool(gap.any()), None
    if options.zeros_are_gaps:
        parked = parked_at_origin(positions, gap)
        gap = gap | parked
    positions[gap] = np.nan
    beside = Beside(
        read_analog(table[:, 4 * layout.points :], layout, file.rate, file.parameters) if layout.channels else None,
        {kind: output_values(columns, of_kind, file.scale) for kind, of_kind in outputs.items()},
        smallest(np.ascontiguousarray(columns[:, [*chain.from_iterable(outputs.values())], 3])),
        words,
        parked,
        other_gaps,
        _rotations(data, file, file.notes if options.salvage else None),
    )
    about = describe(data, file, labels, outputs, markers, beside, options.residuals, positions)
    return replace(about, positions=positions)


def split(file: Opened, columns: NDArray[Any]) -> tuple[list[str], dict[str, list[int]], NDArray[np.intp]]:
    """Labels of all columns, the columns of model outputs by kind, and those of markers; columns: of some frames."""
    labels = file.parameters.texts("POINT", "LABELS")[: file.layout.points]
    outputs = all_outputs(file, labels, columns)
    return labels, outputs, np.setdiff1d(np.arange(file.layout.points), [*chain.from_iterable(outputs.values())])


def describe(
    data: bytes,
    file: Opened,
    labels: list[str],
    outputs: Mapping[str, Sequence[int]],
    markers: NDArray[np.intp],
    beside: Beside,
    residuals: bool | None,
    positions: Floats,
) -> Motion:
    """The motion without frames: names, axes, source and extras. data: header and parameters at least; positions
    (frames, points, 3): of some frames; residuals: the option.
    """
    parameters, rate, source, notes = file.parameters, file.rate, file.source, file.notes
    extras: dict[str, Any] = {}
    if beside.analog is not None:
        extras["analog"] = beside.analog
    has_events = read_all_events(data, file, extras)
    keep(parameters, outputs, labels, beside.outputs, beside.output_words, rate, source, extras)
    if beside.words is not None:
        _keep_residuals(beside.words, residuals, rate, source, extras)
    if beside.parked is not None:
        store_parked(beside.parked, beside.other_gaps, rate, source, extras, notes)
    names = point_names(labels, markers, source)
    if beside.rotations is not None:
        extras["rotations"] = beside.rotations
    up = up_of(parameters, positions, source)
    keep_parameters(parameters, beside.analog is not None, has_events, extras)
    if notes:
        source["notes"] = notes
    return Motion(positions[:0], rate, names, up, source=source, extras=extras)


def all_outputs(file: Opened, labels: list[str], columns: NDArray[Any]) -> dict[str, list[int]]:
    """The columns of model outputs by kind: those that the parameters list, and those that labels and values show."""
    outputs = find_columns(file.parameters, labels)
    with np.errstate(invalid="ignore", over="ignore"):
        unit_m = file.source["unit_m"] * file.scale
        return outputs | find_by_label(file.parameters, labels, outputs, columns, unit_m, file.notes)


def point_names(labels: list[str], markers: NDArray[Any], source: dict[str, Any]) -> tuple[str, ...]:
    """Names of the columns that are points; the labels go into the source where they differ."""
    names, originals = unique_names([labels[i] for i in markers if i < len(labels)], len(markers))
    if originals:
        source["labels"] = originals
    return names


def _section(data: bytes) -> tuple[int, str, int]:
    """Processor type, byte order, and first byte of the parameter section."""
    if len(data) < 2 * BLOCK:
        raise BadInput(f"not a C3D file, or cut off: {len(data)} bytes are fewer than its first two blocks")
    if data[1] != 0x50 or data[0] == 0:
        raise BadInput("not a C3D file: its second byte is not 0x50")
    section = (data[0] - 1) * BLOCK
    if section + 4 > len(data):
        raise BadInput(f"cut off: the parameters begin at byte {section}, the file has {len(data)}")
    processor = data[section + 3]
    if processor not in (INTEL, DEC, MIPS):
        raise BadInput(f"unknown processor type {processor} (known: 84 Intel, 85 DEC, 86 MIPS)")
    return processor, ">" if processor == MIPS else "<", section


def _first_frame(header: Header, parameters: Parameters) -> int:
    long_first = parameters.double_word("TRIAL", "ACTUAL_START_FIELD")
    return long_first if long_first is not None and long_first > 0xFFFF else header.first


def _unit(parameters: Parameters, unit: str | float | None, source: dict[str, Any]) -> tuple[str, float]:
    """The unit's name and its metres: as given, POINT:UNITS, or millimetres, which is noted as a guess."""
    if unit is not None:
        return unit_option(unit)
    texts = [part for text in parameters.texts("POINT", "UNITS") for part in text.replace(",", " ").split()]
    units = texts[0] if texts else ""
    if len({metres_in(text) for text in texts}) > 1:
        raise BadInput(f"its axes have different units, {', '.join(map(repr, texts[:3]))}; use unit= (--unit)")
    if not units:
        if parameters.count("POINT", "USED"):
            source["unit_guessed"] = True
        return "mm", UNITS_M["mm"]
    unit_m = metres_in(units)
    if unit_m is None:
        raise BadInput(f"its points have the unknown unit {units!r}; use unit= (--unit): {', '.join(UNITS_M)}")
    return units, unit_m


def _rate(header: Header, parameters: Parameters, rate: float | None, notes: list[str]) -> float:
    """Frames per second: as given, or POINT:RATE, or the header's."""
    if rate is not None:
        return rate
    declared = parameters.number("POINT", "RATE") or header.rate
    if not (math.isfinite(declared) and declared > 0):
        raise BadInput(f"its frame rate ({declared}) is not usable; give one with rate= (--rate)")
    if math.isfinite(header.rate) and header.rate > 0 and abs(header.rate - declared) > 1e-3 * declared:
        notes.append(f"POINT:RATE is {declared:g} Hz, the header {header.rate:g} Hz (--rate {header.rate:g} takes it)")
    return declared


def _scale(header: Header, parameters: Parameters, notes: list[str]) -> float:
    """Units of a coordinate's integer step: POINT:SCALE, or the header's."""
    scales = [abs(s) for s in (parameters.number("POINT", "SCALE"), header.scale) if s and math.isfinite(s)]
    if not scales:
        raise BadInput("its point scale is not usable")
    if len(scales) == 2 and abs(scales[0] - scales[1]) > 1e-4 * scales[0]:
        notes.append(f"POINT:SCALE is {scales[0]:g}, the header's scale {scales[1]:g}: POINT:SCALE is used")
    return scales[0]


def read_all_events(head: bytes, file: Opened, extras: dict[str, Any]) -> bool:
    """Put events into the extras, times from the first frame; False if EVENT:TIMES has numbers but no event."""
    in_group = read_events(file.parameters, file.notes)
    events = read_header_events(head, file.header.words, file.processor) + in_group
    if events:
        offset_s = (file.first - 1) / file.rate  # times in a C3D count from frame 1
        extras["events"] = [{**event, "time_s": event["time_s"] - offset_s} for event in events]
    is_read = bool(in_group) or not any(np.size(value) for value in file.parameters.chain("EVENT", "TIMES"))
    if not is_read:
        file.notes.append("none of its EVENT group is read as an event; it stays in the parameters")
    return is_read


def _keep_residuals(
    words: NDArray[Any], keep: bool | None, rate: float, source: dict[str, Any], extras: dict[str, Any]
) -> None:
    """Store the fourth words of the samples (frames, points), −1 in gaps: camera mask in the high byte, residual in the
    low byte.
    """
    known = [column[column >= 0] for column in words.T]
    first = next((column[0] for column in known if column.size), 0)
    if all((column == first).all() for column in known):
        source.update({"residual_word": float(first)} if first else {})
        return
    packer = zlib.compressobj(1)
    size = sum(len(packer.compress(np.ascontiguousarray(column).data)) for column in words.T) + len(packer.flush())
    if keep or size <= RESIDUALS_SHARE * 12 * words.size:
        extras["residuals"] = Signal(words, rate)
    else:
        source["residuals"] = "left out"


class RotationLayout(NamedTuple):
    """Where the ROTATION group has segment poses: per sample and segment a 4 × 4 matrix by columns and a reliability.

    start: byte of the first; ratio: samples in a frame; complete: samples that the file has in full.
    """

    segments: int
    start: int
    ratio: int
    samples: int
    complete: int

    def read(self, data: Bytes, begin: int, end: int, processor: int) -> NDArray[np.float32]:
        """Samples [begin, end): (samples, segments, 17)."""
        size = 68 * self.segments
        numbers = floats(data[self.start + begin * size : self.start + end * size], processor)
        return numbers.reshape(end - begin, self.segments, 17)


def rotation_layout(data: Bytes, file: Opened, may_be_cut: bool) -> RotationLayout | None:
    """None for a file without segment poses. Raises BadInput for one that is cut off, unless it may be."""
    parameters = file.parameters
    used = parameters.count("ROTATION", "USED")
    block = parameters.count("ROTATION", "DATA_START")
    if not used or not block:
        return None
    ratio = parameters.count("ROTATION", "RATIO") or 1
    start, samples = (block - 1) * BLOCK, file.frames * ratio
    complete = min(samples, max(0, len(data) - start) // (68 * used))
    if complete < samples and (not may_be_cut or samples * used * 68 > 16 * len(data)):
        raise BadInput(f"cut off: {used} rotations in {samples} samples run past the end of the file")
    return RotationLayout(used, start, ratio, samples, complete)


def _rotations(data: bytes, file: Opened, salvage_notes: list[str] | None) -> Signal | None:
    """Segment poses. salvage_notes: where to note samples that are cut off, which become NaN; None refuses them."""
    layout = rotation_layout(data, file, salvage_notes is not None)
    if layout is None:
        return None
    values = np.full((layout.samples, layout.segments, 17), np.nan, np.float32)
    values[: layout.complete] = layout.read(data, 0, layout.complete, file.processor)
    if layout.complete < layout.samples and salvage_notes is not None:
        salvage_notes.append(
            f"cut off: {layout.complete} of {layout.samples} samples of rotations are read, the others are NaN"
        )
    return Signal(values, file.rate * layout.ratio)


def up_of(parameters: Parameters, positions: Floats, source: dict[str, Any]) -> str:
    """The vertical axis: that of the screen's Y (POINT:Y_SCREEN), else guessed from the motion."""
    screen = "".join(parameters.texts("POINT", "Y_SCREEN"))[-1:].lower()
    if screen in ("x", "y", "z") and screen:
        return screen
    if positions.shape[1]:
        source["up_guessed"] = True
    return guess_up(positions)


def keep_parameters(parameters: Parameters, has_analog: bool, has_events: bool, extras: dict[str, Any]) -> None:
    """Store the parameters that neither follow from the motion nor are standard; all of EVENT if it was not read."""
    groups = {name: dict(group) for name, group in parameters.groups.items()}
    for group, names in DERIVED.items():
        if group == "EVENT" and not has_events:
            continue
        for key in list(groups.get(group, ())):
            base = key.rstrip("0123456789") if group in ("EVENT", "POINT", "ANALOG") else key
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
