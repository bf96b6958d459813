# pyright: strict
"""Choosing frames and points: a frame number or a slice, names of points.

motion[100] · motion[-1] · motion[1200:1320] · motion[::4] · motion[1200:1320, ["LKNE", "RKNE"]]
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from typing import SupportsIndex, cast

from .errors import BadInput, FrameOutOfRange

Frames = SupportsIndex | slice
"""How frames are chosen: `100`, `-1`, `1200:1320`, `::4`."""


def counted(number: int, noun: str) -> str:
    """ "1 frame", "2,752 frames"."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def split_key(key: Frames | tuple[Frames, Sequence[str]]) -> tuple[Frames, Sequence[str] | None]:
    """The key of `[…]` as frames and point names; None without names. Raises BadInput for other tuples."""
    if not isinstance(key, tuple):
        return key, None
    if len(cast("tuple[object, ...]", key)) != 2:
        raise BadInput('write motion[frames] or motion[frames, names], such as motion[1200:1320, ["LKNE"]]')
    return key


def frame_steps(frames: Frames, count: int) -> tuple[int, int, int]:
    """A frame number or a slice of frames as (start, stop, step) within [0, count], step at least 1.

    Raises BadInput for anything else, FrameOutOfRange for a frame number outside [−count, count).
    """
    try:
        if isinstance(frames, slice):
            start, stop, step = frames.indices(count)
        else:
            number = operator.index(frames)
            if not -count <= number < count:
                raise FrameOutOfRange(f"there is no frame {number}: there are {counted(count, 'frame')}, from 0")
            start, stop, step = number % count, number % count + 1, 1
    except (TypeError, ValueError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"frames are chosen by a number or a slice, such as motion[1200:1320], not {frames!r}") from None
    if step < 1:
        raise BadInput("frames can only be taken forwards: the step of a slice must be 1 or more")
    return start, max(start, stop), step


def frame_range(frames: slice | None, count: int) -> tuple[int, int]:
    """A slice of frames as (start, stop) within [0, count]; None is all. Raises BadInput for a step."""
    if frames is None:
        return 0, count
    if not isinstance(cast(object, frames), slice) or frames.step not in (None, 1):
        raise BadInput("a codec decodes a slice of frames without a step, such as slice(1200, 1320)")
    return frame_steps(frames, count)[:2]


def point_columns(all_names: Sequence[str], wanted: Iterable[str]) -> list[int]:
    """Columns of the points with these names. Raises BadInput for an unknown name."""
    wanted = [wanted] if isinstance(wanted, str) else list(wanted)
    column_of = {name: column for column, name in reversed(list(enumerate(all_names)))}
    unknown = [name for name in wanted if name not in column_of]
    if unknown:
        raise BadInput(f"no point named {', '.join(map(repr, unknown))}; the names are: {', '.join(all_names)}")
    return [column_of[name] for name in wanted]
