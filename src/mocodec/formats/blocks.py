# pyright: strict
"""Files in pieces: a motion of some frames at a time, for recordings that do not fit into memory.

    read_blocks("day.npy", rate=120) ─► Blocks: about (names, rate, skeleton, extras), frames
    for motion in blocks: …

`formats.BLOCKS` lists the modules with a function `read_blocks`, which has the options of the format's `read`. Guesses
(unit, vertical axis) are made by the first frames.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..motion import Motion

BLOCK_SAMPLES = 1 << 18
"""Samples (frames × points) of a block, about."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """A recording in pieces; iterating gives motions that follow each other, from the first frame each time.

    about: names, rate, skeleton, source and extras, without frames. frames: how many, None if unknown before the end.
    parts: the blocks. between(start, stop): these frames, where the source can be read anywhere.
    """

    about: Motion
    frames: int | None
    parts: Callable[[], Iterator[Motion]]
    between: Callable[[int, int], Motion] | None = None

    def __iter__(self) -> Iterator[Motion]:
        return self.parts()

    def sample(self, count: int, parts: int, first: Motion) -> tuple[Motion, list[int]]:
        """About `count` frames in parts from everywhere, and where in them each part but the first begins.

        first: frames from the beginning, which are the sample where the source is read from front to back.
        """
        if self.between is None or not self.frames:
            return first, []
        each = max(2, count // parts)
        starts = np.linspace(0, self.frames - each, parts).astype(int).tolist()
        found = [self.between(start, start + each) for start in starts]
        positions = np.concatenate([m.positions for m in found])
        turned = [m.rotations for m in found if m.rotations is not None]
        rotations = np.concatenate(turned) if len(turned) == len(found) else None
        whole = replace(first, positions=positions, rotations=rotations)
        return whole, [each * k for k in range(1, parts)]


@contextmanager
def named_errors(path: Path) -> Generator[None, None, None]:
    """Raises BadInput with the file for what goes wrong while it is opened, also in temporary files."""
    try:
        yield
    except BadInput as error:
        raise BadInput(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    except OSError as error:
        raise BadInput(f"{path}: cannot be taken apart into temporary files: {error}") from error


def block_frames(points: int) -> int:
    """Frames of a block, by its number of points."""
    return max(1, BLOCK_SAMPLES // max(1, points))


def of_ranges(about: Motion, frames: int, between: Callable[[int, int], Motion], each: int) -> Blocks:
    """Blocks of `each` frames of a source that can be read anywhere."""

    def parts() -> Iterator[Motion]:
        for start in range(0, frames, each):
            yield between(start, min(frames, start + each))

    return Blocks(about, frames, parts, between)
