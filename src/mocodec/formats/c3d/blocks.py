# pyright: strict
"""C3D in pieces: header and parameters once, then frames where they are asked for.

What the data section has beside positions (analog channels, model outputs, residuals, segment poses) is first taken
apart into channels in temporary files, in one pass, so that extras are those of `reading.read`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadInput
from ...motion import Motion, Signal
from ...typing import Floats
from .. import zeros
from ..blocks import Blocks, block_frames, named_errors, of_ranges
from ..scratch import Array, Columns
from . import reading
from .analog import analog_signal, is_unsigned, smallest
from .model_outputs import output_values
from .parameters import BLOCK

HEAD_BYTES = (1 << 16) * BLOCK
"""Header and parameters end before this: the header counts blocks in 16 bits."""


class FileBytes:
    """The bytes of a file, read where they are asked for. Raises BadInput if the file has become shorter."""

    def __init__(self, path: Path) -> None:
        self._path, self._size = path, path.stat().st_size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, where: slice, /) -> bytes:
        start, stop, _ = where.indices(self._size)
        with self._path.open("rb") as file:
            file.seek(start)
            found = file.read(max(0, stop - start))
        if len(found) < stop - start:
            raise BadInput(f"{self._path}: has become shorter while it was read")
        return found


def read_blocks(
    path: str | Path,
    residuals: bool | None = None,
    unit: str | float | None = None,
    rate: float | None = None,
    gaps: str | None = None,
) -> Blocks:
    """As `reading.read`, in pieces. Which points are model outputs is decided by the first frames. Raises BadInput."""
    path = Path(path)
    with named_errors(path):
        options = reading.Options(residuals, unit, rate, zeros.zeros_are_gaps(gaps), salvage=False)
        return _blocks(FileBytes(path), options)


def _blocks(data: FileBytes, options: reading.Options) -> Blocks:
    head = data[:HEAD_BYTES]
    file = reading.opened(head, data, options)
    if not file.layout.points or not file.frames:
        raise BadInput("has no points, and in pieces only files with points are read")
    each = block_frames(max(file.layout.points, file.layout.width // 4))
    first = file.columns(file.table(data, 0, min(each, file.frames)))
    labels, outputs, markers = reading.split(file, first)
    beside = _beside(data, file, options, each, outputs, markers)

    def positions(begin: int, end: int) -> Floats:
        found, _, gap = file.samples(file.columns(file.table(data, begin, end))[:, markers])
        found[gap if beside.parked is None else gap | beside.parked[begin:end].astype(bool)] = np.nan
        return found

    about = reading.describe(head, file, labels, outputs, markers, beside, options.residuals, positions(0, len(first)))

    def between(begin: int, end: int) -> Motion:
        return Motion(positions(begin, end), about.rate, about.names, about.up, source=about.source)

    return of_ranges(about, file.frames, between, each)


def _beside(
    data: FileBytes,
    file: reading.Opened,
    options: reading.Options,
    each: int,
    outputs: Mapping[str, Sequence[int]],
    markers: np.ndarray[tuple[int, ...], np.dtype[np.intp]],
) -> reading.Beside:
    """What a file has beside positions, by one pass over its blocks of `each` frames."""
    layout, frames = file.layout, file.frames
    number = np.float32 if layout.item == 4 else np.int16
    analog = Columns(frames * layout.samples_per_frame, (layout.channels,), number)
    values = {kind: Columns(frames, (len(columns), 3), np.float32) for kind, columns in outputs.items()}
    listed = [*chain.from_iterable(outputs.values())]
    output_words = Columns(frames, (len(listed),), number)
    words = Columns(frames, (len(markers),), number)
    places = Columns(frames, (len(markers),), np.uint8)
    other_gaps = False
    for begin in range(0, frames, each):
        table = file.table(data, begin, min(frames, begin + each))
        columns = file.columns(table)
        positions, word, gap = file.samples(columns[:, markers])
        analog.add(table[:, 4 * layout.points :].reshape(len(table) * layout.samples_per_frame, layout.channels))
        for kind, of_kind in outputs.items():
            values[kind].add(output_values(columns, of_kind, file.scale))
        output_words.add(columns[:, listed, 3])
        other_gaps |= bool(gap.any())
        if options.residuals is not False:
            words.add(np.where(gap, -1, word))
        if options.zeros_are_gaps:
            places.add(zeros.places(positions, gap))
    return reading.Beside(
        analog_signal(_analog(analog, file), file.rate, layout, file.parameters) if layout.channels else None,
        {kind: columns.values for kind, columns in values.items()},
        _smallest(output_words),
        None if options.residuals is False else _smallest(words),
        zeros.parked_columns(places) if options.zeros_are_gaps else None,
        other_gaps,
        _rotations(data, file, each),
    )


def _analog(columns: Columns, file: reading.Opened) -> Array:
    """Analog samples as `read_analog` has them."""
    unsigned = is_unsigned(file.parameters)
    if file.layout.item == 2:
        return columns.values.view(np.uint16) if unsigned else columns.values
    return _smallest(columns, np.uint16 if unsigned else np.int16)


def _smallest(columns: Columns, dtype: type[np.integer[Any]] = np.int16) -> Array:
    """As `analog.smallest`, channel by channel."""
    values = columns.values
    channels = values.reshape(columns.rows, columns.channels).T
    if values.dtype == dtype or any(smallest(samples, dtype).dtype != dtype for samples in channels):
        return values
    whole = Columns(columns.rows, columns.shape, dtype)
    for number, samples in enumerate(channels):
        whole.put(number, smallest(samples, dtype))
    return whole.values


def _rotations(data: FileBytes, file: reading.Opened, each: int) -> Signal | None:
    """Segment poses."""
    layout = reading.rotation_layout(data, file, may_be_cut=False)
    if layout is None:
        return None
    values = Columns(layout.samples, (layout.segments, 17), np.float32)
    for begin in range(0, layout.samples, each):
        values.add(layout.read(data, begin, min(layout.samples, begin + each), file.processor))
    return Signal(values.values, file.rate * layout.ratio)
