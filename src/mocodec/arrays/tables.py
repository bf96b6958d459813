"""Motions as pandas frames: a row per frame, columns (point, axis), index in seconds."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import BadInput
from ..motion import Motion
from . import times
from .libraries import library

AXES = ("x", "y", "z")


def to_pandas(motion: Motion) -> Any:
    """A pandas.DataFrame of the positions, metres, NaN in gaps; `frame.attrs` has rate (Hz), up and units.

    index "time": seconds from the first frame. columns: a MultiIndex (point, axis), so that `frame["LKNE"]` has the
    columns x, y and z. Raises MissingExtra without pandas.
    """
    pandas = library("pandas", "mocodec.arrays.to_pandas", "pandas")
    columns = pandas.MultiIndex.from_product([motion.names, AXES], names=["point", "axis"])
    index = pandas.Index(times.seconds(len(motion), motion.rate), name="time")
    frame = pandas.DataFrame(motion.positions.reshape(len(motion), -1), index=index, columns=columns, copy=True)
    frame.attrs.update(rate=motion.rate, up=motion.up, units="m")
    return frame


def from_pandas(frame: Any) -> Motion:
    """The motion of a frame with columns (point, axis) as `to_pandas` makes it; axes may be in any order.

    The rate is that of the index, seconds; up is `frame.attrs["up"]` or z. Raises BadInput for other columns and for
    times that are not evenly spaced, MissingExtra without pandas.
    """
    library("pandas", "mocodec.arrays.from_pandas", "pandas")
    keys = [tuple(key) if isinstance(key, tuple) else (key,) for key in frame.columns]
    names = list(dict.fromkeys(key[0] for key in keys))
    wanted = [(name, axis) for name in names for axis in AXES]
    if sorted(map(str, keys)) != sorted(map(str, wanted)):
        raise BadInput("columns must be (point, axis), with the axes x, y and z of each point once")
    order = [keys.index(key) for key in wanted]
    values = np.asarray(frame.iloc[:, order], np.float64).reshape(len(frame), len(names), 3)
    rate = times.rate_of(np.asarray(frame.index, np.float64), frame.attrs)
    return Motion(values, rate, [str(name) for name in names], up=frame.attrs.get("up", "z"))
