# pyright: strict
"""C3D in pieces: header and parameters once, then frames where they are asked for. Analog channels, model outputs and
segment poses are left out (`Blocks.left_out`), residuals too, unless all are equal."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ...errors import BadInput
from ...motion import Motion
from ...typing import Booleans, Floats
from ..blocks import Blocks, block_frames, of_ranges
from ..zeros import parked_at_origin, zeros_are_gaps
from . import reading
from .parameters import BLOCK

HEAD_BYTES = (1 << 16) * BLOCK
"""Header and parameters end before this: the header counts blocks in 16 bits."""


Samples: TypeAlias = tuple[Floats, np.ndarray[tuple[int, ...], np.dtype[Any]], Booleans]
"""What `reading.Opened.samples` gives: positions, fourth words, gaps."""


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
    if residuals:
        raise BadInput(f"{path}: in pieces, residuals are not kept: read it at once")
    data, zeros = FileBytes(path), zeros_are_gaps(gaps)
    head = data[:HEAD_BYTES]
    try:
        file = reading.opened(head, data, reading.Options(residuals, unit, rate, zeros, salvage=False))
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
    if not file.layout.points or not file.frames:
        raise BadInput(f"{path}: has no points, and in pieces only points are read")
    each = block_frames(file.layout.points)
    columns = file.columns(file.table(data, 0, min(each, file.frames)))
    labels = file.parameters.texts("POINT", "LABELS")[: file.layout.points]
    outputs = reading.all_outputs(file, labels, columns)
    markers = np.setdiff1d(np.arange(file.layout.points), [*chain.from_iterable(outputs.values())])

    def samples(begin: int, end: int) -> Samples:
        return file.samples(file.columns(file.table(data, begin, end))[:, markers])

    def positions(begin: int, end: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        found, _, gap = samples(begin, end)
        found[gap | parked_at_origin(found, gap, is_part=True) if zeros else gap] = np.nan
        return found

    if residuals is None:
        ranges = ((begin, min(begin + each, file.frames)) for begin in range(0, file.frames, each))
        file.source.update(_residuals_fact(samples(*frames) for frames in ranges))
    about = _about(head, file, labels, markers, positions(0, len(columns)))

    def between(begin: int, end: int) -> Motion:
        return Motion(positions(begin, end), about.rate, about.names, about.up, source=about.source)

    left_out = {
        "analog channels": file.layout.channels,
        "model outputs": len(outputs),
        "segment poses": file.parameters.count("ROTATION", "USED"),
    }
    present = tuple(what for what, count in left_out.items() if count)
    return of_ranges(about, file.frames, between, each, present)


def _residuals_fact(blocks: Iterable[Samples]) -> dict[str, object]:
    """What `reading.read` says of the fourth words in the source, but for words that it would keep as samples: these
    are left out. Reads no further than to the first word that differs.
    """
    common: float | None = None
    for _, word, gap in blocks:
        words = word[~gap]
        if not words.size:
            continue
        common = float(words[0]) if common is None else common
        if np.any(words != common):
            return {"residuals": "left out"}
    return {"residual_word": common} if common else {}


def _about(
    head: bytes,
    file: reading.Opened,
    labels: list[str],
    markers: np.ndarray[tuple[int, ...], np.dtype[np.intp]],
    first: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> Motion:
    """Names, rate, vertical axis, events and parameters; first: positions of the first frames."""
    extras: dict[str, object] = {}
    has_events = reading.read_all_events(head, file, extras)
    source = file.source
    names = reading.point_names(labels, markers, source)
    up = reading.up_of(file.parameters, first, source)
    reading.keep_parameters(file.parameters, False, has_events, extras)
    if file.notes:
        source["notes"] = file.notes
    return Motion(first[:0], file.rate, names, up, source=source, extras=extras)
