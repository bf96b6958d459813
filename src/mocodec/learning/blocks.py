# pyright: strict
"""Blocks: runs of windows of one recording, whose features are computed together and kept while memory allows.

    recording ─slice─► frames of a block ─rate─► frames at the windows' rate ─features─► float32 arrays ─► windows

A window is always cut from the same block, so its values do not depend on what was read before.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..api import File
from ..errors import BadInput
from ..geometry import resampling
from ..motion import Motion
from .features import FEATURES, Float32

BLOCK_FRAMES = 4096
"""Source frames of a block, about: enough that its ends cost little, few enough that one window is not dear."""
MARGIN_FRAMES = 16
"""Frames beyond a block that its splines see: farther ones change nothing that float32 shows."""

Block = dict[str, Float32]


@dataclass(frozen=True)
class Cut:
    """How windows are cut: frames and stride at `rate` (Hz; None: that of the recording)."""

    frames: int
    stride: int
    rate: float | None

    def __post_init__(self) -> None:
        if self.frames < 1 or self.stride < 1:
            raise BadInput(
                f"windows have at least 1 frame and a stride of at least 1, not {self.frames}, {self.stride}"
            )
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0):
            raise BadInput(f"the rate of windows is a positive number of hertz, not {self.rate}")

    def step(self, rate: float) -> float:
        """Frames of a recording at `rate` from one frame of a window to the next."""
        return 1.0 if self.rate is None else rate / self.rate

    def windows(self, frames: int, rate: float) -> int:
        """The number of windows in a recording."""
        usable = math.floor((frames - 1) / self.step(rate) + resampling.ON_FRAME) + 1 if frames else 0
        return max(0, (usable - self.frames) // self.stride + 1)

    def windows_per_block(self, rate: float) -> int:
        """The number of windows in a block but the last."""
        return max(1, round(BLOCK_FRAMES / self.step(rate)) // self.stride)


def read(file: File[Any], cut: Cut, first: int, count: int, prepare: Callable[[Motion], Motion]) -> Motion:
    """The frames of `count` windows from the window `first` on, at the rate of the windows, with one frame more on
    each side where the recording has it; `source["before"]` is how many are before the first window."""
    rate, step = file.rate, cut.step(file.rate)
    start = first * cut.stride
    stop = start + (count - 1) * cut.stride + cut.frames
    last = math.floor((len(file) - 1) / step + resampling.ON_FRAME) + 1
    outer = max(0, start - 1), min(last, stop + 1)
    times = np.arange(*outer) * step
    nearest = np.rint(times)
    times = np.where(np.abs(times - nearest) < resampling.ON_FRAME, nearest, times)
    margin = 0 if step.is_integer() else MARGIN_FRAMES
    a = max(0, math.floor(times[0]) - margin)
    b = min(len(file), math.ceil(times[-1]) + 1 + margin)
    motion = replace(file[a:b], extras={})
    if step.is_integer():
        motion = motion[:: int(step)] if step > 1 else motion
    else:
        turned = None if motion.rotations is None else resampling.rotations_at(motion.rotations, times - a)
        placed = resampling.positions_at(motion.positions, times - a)
        motion = replace(motion, positions=placed, rotations=turned)
    return replace(prepare(motion), rate=rate / step, source={"before": start - outer[0]})


def features(motion: Motion, names: tuple[str, ...], frames: int) -> Block:
    """The features of `frames` frames, after those before the first window."""
    before = int(motion.source["before"])
    inside = slice(before, before + frames)
    return {name: np.ascontiguousarray(FEATURES[name](motion)[inside], np.float32) for name in names}


class BlockCache:
    """Blocks by number, at most `most_bytes` of them and always the last one; the least recently used leave it."""

    def __init__(self, most_bytes: int, load: Callable[[int], Block]) -> None:
        self.most_bytes, self.load = most_bytes, load
        self.bytes = 0
        self._blocks: OrderedDict[int, Block] = OrderedDict()

    def get(self, number: int) -> Block:
        """The block, which is loaded if it is not in memory."""
        block = self._blocks.get(number)
        if block is not None:
            self._blocks.move_to_end(number)
            return block
        block = self.load(number)
        self._blocks[number] = block
        self.bytes += size(block)
        while self.bytes > self.most_bytes and len(self._blocks) > 1:
            self.bytes -= size(self._blocks.popitem(last=False)[1])
        return block


def size(block: Block) -> int:
    """The bytes of a block."""
    return sum(array.nbytes for array in block.values())
