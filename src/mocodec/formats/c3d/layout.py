"""How the data section of a C3D is divided: words in a frame, and the number of frames.

    header ────┐
    parameters ┴─► candidate layouts × candidate frame counts ─► those that the size of the file agrees with

Header and parameters may contradict each other, and either may be right. The size of the file decides.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple, Protocol

import numpy as np

from ...errors import BadInput
from .parameters import BLOCK, Parameters, floats

MAX_COUNT = 0xFFFF
"""Where counts of 16 bits saturate."""
MAX_TESTED_BYTES = 1 << 16
"""Bytes of the data that are looked at to tell floats from integers."""


class Bytes(Protocol):
    """The bytes of a file: in memory, or read where they are asked for (`blocks.FileBytes`)."""

    def __len__(self) -> int: ...
    def __getitem__(self, where: slice, /) -> bytes: ...


class Header(NamedTuple):
    """The fields of the 512-byte header."""

    words: tuple[int, ...]
    scale: float
    rate: float
    processor: int

    @property
    def points(self) -> int:
        return self.words[1]

    @property
    def analog_words(self) -> int:
        """Analog samples of all channels in a frame."""
        return self.words[2]

    @property
    def first(self) -> int:
        return self.words[3]

    @property
    def last(self) -> int:
        return self.words[4]

    @property
    def data_block(self) -> int:
        return self.words[8]

    @property
    def samples_per_frame(self) -> int:
        """Analog samples of one channel in a frame."""
        return self.words[9]

    @property
    def frames(self) -> int:
        return max(0, self.last - self.first + 1) if self.last else 0


class Layout(NamedTuple):
    """Points and analog channels of a frame; item: bytes of a number, 4 for floats and 2 for integers."""

    points: int
    channels: int
    samples_per_frame: int
    item: int

    @property
    def width(self) -> int:
        """Numbers in a frame."""
        return 4 * self.points + self.channels * self.samples_per_frame

    @property
    def frame_bytes(self) -> int:
        return self.width * self.item

    def __str__(self) -> str:
        kind = "floats" if self.item == 4 else "integers"
        return f"{self.points} points and {self.channels} analog channels × {self.samples_per_frame} as {kind}"


def read_header(data: bytes, order: str, processor: int) -> Header:
    """The header; order: "<" or ">"."""
    words = struct.unpack_from(f"{order}256H", data)
    scale, rate = (float(floats(data[i : i + 4], processor)[0]) for i in (12, 20))
    return Header(words, scale, rate, processor)


def data_start(header: Header, parameters: Parameters, data: Bytes, section_end: int, notes: list[str]) -> int:
    """The byte where the data begin, by the header or POINT:DATA_START; a contradiction is settled and noted.

    section_end: where the parameters end, by their own count. Raises BadInput without evidence.
    """
    blocks = {"the header": header.data_block, "POINT:DATA_START": parameters.count("POINT", "DATA_START") or 0}
    named = {name: (block - 1) * BLOCK for name, block in blocks.items() if block > 1}
    if not named:
        raise BadInput("does not say where its data begin")
    starts = set(named.values())
    if len(starts) == 1:
        return starts.pop()
    layouts, claims = candidate_layouts(header, parameters), _claimed_frames(header, parameters)
    sizes = {start: data_end(data, parameters, start) - start for start in starts}
    fitting = {
        start
        for start, size in sizes.items()
        if any(_exact(layout, claims, data, start, size) for layout in layouts if layout.width)
    }
    starts = fitting if len(fitting) == 1 else starts & {section_end}
    if len(starts) != 1:
        says = "; ".join(f"{name} says block {start // BLOCK + 1}" for name, start in named.items())
        raise BadInput(f"it does not say clearly where its data begin: {says}")
    start = starts.pop()
    says = ", ".join(f"{name} says block {other // BLOCK + 1}" for name, other in named.items() if other != start)
    notes.append(f"the size of the file shows that its data begin at block {start // BLOCK + 1}; {says}")
    return start


def data_end(data: Bytes, parameters: Parameters, start: int) -> int:
    """The byte where the points and analog samples end: the file's end, or the start of the rotations behind them."""
    rotations = ((parameters.count("ROTATION", "DATA_START") or 0) - 1) * BLOCK
    return rotations if parameters.count("ROTATION", "USED") and start < rotations <= len(data) else len(data)


def settle(
    header: Header,
    parameters: Parameters,
    data: Bytes,
    start: int,
    available: int,
    notes: list[str],
    salvage: bool = False,
) -> tuple[Layout, int]:
    """The layout and the number of frames that the file's size agrees with; contradictions are noted.

    start, available: first byte and number of bytes of the data section. salvage: take the complete frames of truncated
    data. Raises BadInput for truncated data, and for contradictions that the size does not settle.
    """
    layouts = candidate_layouts(header, parameters)
    claims = _claimed_frames(header, parameters)
    if not any(layout.width for layout in layouts):
        return layouts[0], max(claims, default=0)
    layouts = [layout for layout in layouts if layout.width]
    fitting = _fitting(layouts, header, parameters, claims, data, start, available, notes)
    if not fitting:
        return _complete_frames(layouts[0], claims, available, salvage, notes)
    if len(fitting) > 1:  # what a layout leaves over is padding: zeros
        ends = {layout: start + frames * layout.frame_bytes for layout, frames in fitting.items()}
        padded = [layout for layout, end in ends.items() if not any(data[end : start + available])]
        fitting = {layout: fitting[layout] for layout in padded or fitting}
    if len(fitting) > 1:
        readings = "; ".join(f"{layout} in {frames} frames" for layout, frames in fitting.items())
        raise BadInput(f"header and parameters contradict each other, and the file's size allows both: {readings}")
    layout, frames = next(iter(fitting.items()))
    if len(layouts) > 1 or layout not in layouts:
        others = "; ".join(str(other) for other in layouts if other != layout)
        notes.append(f"header and parameters contradict each other; the size of the file gives {layout}, not {others}")
    elif layout.channels and header.samples_per_frame != layout.samples_per_frame:
        notes.append(
            f"the header has {header.samples_per_frame} analog samples per frame and channel; the parameters and the "
            f"size of the file give {layout.samples_per_frame}"
        )
    counts = [count for count in dict.fromkeys(claims) if count < MAX_COUNT and (frames - count) % (MAX_COUNT + 1)]
    if counts and frames in claims and header.last < MAX_COUNT:
        others = ", ".join(map(str, counts))
        notes.append(f"its counts of frames are {others} and {frames}; the size of the file gives {frames} frames")
    end = start + frames * layout.frame_bytes
    behind = start + available - end
    if behind >= max(2 * BLOCK, layout.frame_bytes) and any(data[end : end + min(behind, MAX_TESTED_BYTES)]):
        notes.append(f"behind its {frames} declared frames are {behind} more bytes, which are not read")
    return layout, frames


def _fitting(
    layouts: list[Layout],
    header: Header,
    parameters: Parameters,
    claims: list[int],
    data: Bytes,
    start: int,
    available: int,
    notes: list[str],
) -> dict[Layout, int]:
    """Layouts with the number of frames that the size allows: exactly, beyond 16 bits, as floats, with more behind."""
    fitting = {layout: frames for layout in layouts if (frames := _exact(layout, claims, data, start, available))}
    if fitting:
        return fitting
    for layout in layouts:
        if frames := _beyond_16_bits(layout, header, parameters, claims, data, start, available):
            notes.append(f"its counts of frames end at {MAX_COUNT}; the size of the file gives {frames} frames")
            return {layout: frames}
    if not claims:
        frames = _frames_of_size(layouts[0], data, start, available)
        notes.append(f"it does not say how many frames it has; the size of the file gives {frames}")
        return {layouts[0]: frames} if frames else {}
    others = [layout._replace(item=4) for layout in layouts if layout.item == 2]
    if not _are_floats(data[start : start + min(available, MAX_TESTED_BYTES)], header.processor):
        others += [layout._replace(item=2) for layout in layouts if layout.item == 4]
    fitting = {layout: frames for layout in others if (frames := _exact(layout, claims, data, start, available))}
    return fitting or {layout: frames for layout in layouts if (frames := _contained(layout, claims, available))}


def _complete_frames(
    layout: Layout, claims: list[int], available: int, salvage: bool, notes: list[str]
) -> tuple[Layout, int]:
    """The complete frames of truncated data, if they are to be salvaged. Raises BadInput otherwise."""
    promised = max(claims, default=0)
    if not promised:
        raise BadInput("has no frames")
    complete = max(0, available) // layout.frame_bytes
    if not salvage or not complete:
        hint = "; --salvage (salvage=True) reads these" if complete else ""
        raise BadInput(f"cut off: its header declares {promised} frames, the file has {complete} complete ones{hint}")
    notes.append(f"cut off: {complete} of {promised} declared frames are read")
    return layout, complete


def candidate_layouts(header: Header, parameters: Parameters) -> list[Layout]:
    """The layouts that header and parameters, or both together, describe; the preferred one first."""
    declared = parameters.count("POINT", "USED")
    points = list(dict.fromkeys(([] if declared is None else [declared]) + [header.points]))
    scale = parameters.number("POINT", "SCALE") or 0.0
    items = list(dict.fromkeys(4 if s < 0 else 2 for s in (scale, header.scale) if s and math.isfinite(s))) or [4]
    return [Layout(p, *split, item) for item in items for split in _analog_splits(header, parameters) for p in points]


def _analog_splits(header: Header, parameters: Parameters) -> list[tuple[int, int]]:
    """(channels, samples of each in a frame) as the header and as the parameters have it."""
    splits: list[tuple[int, int]] = []
    used = parameters.count("ANALOG", "USED")
    rates = parameters.number("ANALOG", "RATE"), parameters.number("POINT", "RATE") or header.rate
    ratio = rates[0] / rates[1] if rates[0] and rates[1] and math.isfinite(rates[0] / rates[1]) else 0.0
    words, per_frame = header.analog_words, header.samples_per_frame
    if words and per_frame and words % per_frame == 0:
        splits.append((words // per_frame, per_frame))
    if words and used and words % used == 0 and not (splits and splits[0][0] == used):
        splits.append((used, words // used))
    if used == 0 or not (words or used):
        splits.append((0, 0))
    if used and 0.5 <= ratio < 1e6 and abs(ratio - round(ratio)) < 0.01:
        splits.append((used, round(ratio)))
    if not words:
        splits.append((0, 0))
    if not splits and words:
        splits.append((words, 1))
    by_width: dict[int, tuple[int, int]] = {}
    for channels, samples in splits:  # the first split of each width: those after it say the same of the positions
        by_width.setdefault(channels * samples, (channels, samples))
    return list(by_width.values())


def _claimed_frames(header: Header, parameters: Parameters) -> list[int]:
    """The numbers of frames that header and parameters declare, from those that count farthest."""
    first, last = (parameters.double_word("TRIAL", f"ACTUAL_{end}_FIELD") for end in ("START", "END"))
    trial = last - first + 1 if first is not None and last is not None else None
    in_point = parameters.count("POINT", "FRAMES")
    if in_point == MAX_COUNT and not header.last:
        in_point = None  # −1: not counted
    counts = (trial, parameters.count("POINT", "LONG_FRAMES"), in_point, header.frames)
    return [count for count in counts if count is not None and count > 0]


def _are_floats(data: bytes, processor: int) -> bool:
    """Whether bytes are plausible coordinates as floats; pairs of integers are mostly tiny, huge or no numbers."""
    values = np.abs(floats(data[: len(data) & ~3], processor))
    with np.errstate(invalid="ignore"):
        plausible = (values == 0) | ((values > 1e-9) & (values < 1e9))
    return bool(plausible.mean() > 0.9) if values.size else True


def _exact(layout: Layout, claims: list[int], data: Bytes, start: int, available: int) -> int:
    """The largest claim that fills the data section up to padding, or 0; a last block of zeros is padding."""
    size = layout.frame_bytes
    fitting = sorted(claim for claim in claims if 0 <= available - claim * size < 2 * BLOCK)
    for claim in fitting:
        rest = start + claim * size
        if start + available - rest < BLOCK and not any(data[rest : start + available]):
            return claim
    fitting = [claim for claim in fitting if claim != MAX_COUNT or available - claim * size < size]  # or more frames
    return fitting[-1] if fitting else 0


def _contained(layout: Layout, claims: list[int], available: int) -> int:
    """The preferred claim if the data section is at least that long, or 0."""
    long = next((c for c in claims[:2] if c > MAX_COUNT), claims[-1] if claims else 0)
    return long if long * layout.frame_bytes <= available else 0


def _beyond_16_bits(
    layout: Layout,
    header: Header,
    parameters: Parameters,
    claims: list[int],
    data: Bytes,
    start: int,
    available: int,
) -> int:
    """The number of frames by the file's size if the declared counts are saturated or wrapped at 16 bits, or 0."""
    if available // layout.frame_bytes <= MAX_COUNT:
        return 0
    frames = _frames_of_size(layout, data, start, available)
    is_saturated = header.last == MAX_COUNT or parameters.count("POINT", "FRAMES") == MAX_COUNT
    is_wrapped = any((frames - claim) % (MAX_COUNT + 1) == 0 for claim in claims)
    return frames if is_saturated or is_wrapped else 0


def _frames_of_size(layout: Layout, data: Bytes, start: int, available: int) -> int:
    """The number of frames that fill the data section; frames of zeros in the last block are padding."""
    frames = max(0, available) // layout.frame_bytes
    end = start + frames * layout.frame_bytes
    while frames and start + available - (end - layout.frame_bytes) <= BLOCK:
        if any(data[end - layout.frame_bytes : end]):
            break
        frames, end = frames - 1, end - layout.frame_bytes
    return frames
