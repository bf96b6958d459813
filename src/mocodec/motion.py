"""Motion: named points over time, in metres and hertz; what every reader makes and every codec takes.

positions (frames, points, 3) · rate · names · up          the motion itself; NaN = gap
skeleton, rotations                                        where the source has them
source, extras                                             what it takes to write the file back as it came
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .errors import BadInput
from .typing import Floats

UP_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Limits:
    """How far the joints of a skeleton may turn.

    A joint's rotation against its parent is C · R · C⁻¹, where C is the turn of its axis frame, `axes` (joints, 4; unit
    quaternions, w first), and R is made of turns about the three axes named in its entry of `orders`, read as
    `geometry.rigid` reads them ("zyx" is Rz · Ry · Rx). ranges (joints, 3, 2): the least and the greatest of each of
    these angles, in that order, radians; −∞ and ∞ where nothing limits it, 0 and 0 where the joint does not turn so.
    """

    orders: tuple[str, ...]
    axes: Floats
    ranges: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "orders", tuple(self.orders))
        object.__setattr__(self, "axes", np.asarray(self.axes, np.float64))
        object.__setattr__(self, "ranges", np.asarray(self.ranges, np.float64))
        n = len(self.orders)
        if self.axes.shape != (n, 4) or self.ranges.shape != (n, 3, 2):
            raise BadInput(f"limits of {n} joints need axes ({n}, 4) and ranges ({n}, 3, 2)")
        if any(sorted(order) != ["x", "y", "z"] for order in self.orders):
            raise BadInput("the orders of limits are made of x, y and z")
        low, high = self.ranges[..., 0], self.ranges[..., 1]
        if not (np.isfinite(self.axes).all() and ((low <= high) & (low < np.inf) & (high > -np.inf)).all()):
            raise BadInput("limits need finite axes, and ranges from the lesser angle to the greater")


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of joints at rest.

    names: one per joint, in the order of the points of the motion. parents: index of each joint's parent, −1 for a
    root; a parent stands before its children. offsets (joints, 3): from parent to joint in the parent's frame, metres;
    at rest all frames are parallel. Where `source["format"]` is "amc" a joint is the end of a bone that turns about its
    start, so its offset is in its own frame: bones that begin in one joint turn apart, which no one frame of that joint
    could say (`geometry.kinematics.forward(…, own_frame=True)`). limits: how far the joints may turn, where the source
    says it (ASF); they do not bind `rotations`.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Floats
    limits: Limits | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "parents", tuple(int(p) for p in self.parents))
        object.__setattr__(self, "offsets", np.asarray(self.offsets, np.float64))
        n = len(self.names)
        if len(self.parents) != n or self.offsets.shape != (n, 3):
            raise BadInput(f"skeleton of {n} joints needs {n} parents and offsets ({n}, 3), not {self.offsets.shape}")
        for joint, parent in enumerate(self.parents):
            if not -1 <= parent < joint:
                raise BadInput(f"skeleton joint {joint} ({self.names[joint]}): its parent must stand before it")
        if self.limits is not None and len(self.limits.orders) != n:
            raise BadInput(f"skeleton of {n} joints with limits of {len(self.limits.orders)}")

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class Signal:
    """Samples beside the points: analog channels, camera masks, residuals. Sliced along time with the motion.

    values (samples, …), any dtype, kept bit for bit; rate in hertz (samples a second); labels and units by channel.
    Raises BadInput where these do not hold.
    """

    values: NDArray[Any]
    rate: float
    labels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0) or self.values.ndim == 0:
            raise BadInput(
                f"a signal is an array of samples at a positive rate, not {self.values.shape} at {self.rate}"
            )

    def between(self, start: int, stop: int, frame_rate: float) -> Signal:
        """The samples that fall into frames [start, stop) of a motion at `frame_rate`."""
        per_frame = self.rate / frame_rate
        return replace(self, values=self.values[round(start * per_frame) : round(stop * per_frame)])


@dataclass(frozen=True, eq=False)
class Motion:
    """Named points over time.

    positions (frames, points, 3) float64, metres, in the source's axes; a gap is NaN in all three coordinates.
    rate: frames a second. names: one per point. up: the vertical axis, "x", "y" or "z".
    skeleton, rotations (frames, joints, 4; unit quaternions, w first, from the parent's frame): where there are any.
    source: JSON values that say how the file was: `format`, `units`, `unit_m` (metres in one unit), `first_frame`, …
    extras: what codecs do not code and the container carries losslessly: a tree of dicts and lists with JSON values,
    bytes, NumPy arrays and `Signal`s. `extras["events"]` is a list of dicts with `label` and `time_s`, counted from the
    first frame.

    Raises BadInput where these do not hold.
    """

    positions: Floats
    rate: float
    names: tuple[str, ...] = ()
    up: str = "z"
    skeleton: Skeleton | None = None
    rotations: Floats | None = None
    source: Mapping[str, Any] = field(default_factory=dict)
    extras: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        positions = np.ascontiguousarray(self.positions, np.float64)
        if positions.ndim != 3 or positions.shape[2] != 3:
            raise BadInput(f"positions must be (frames, points, 3), not {positions.shape}")
        object.__setattr__(self, "positions", positions)
        names = tuple(self.names) or tuple(f"P{i + 1}" for i in range(positions.shape[1]))
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "rate", float(self.rate))
        if len(names) != positions.shape[1]:
            raise BadInput(f"{positions.shape[1]} points but {len(names)} names")
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise BadInput(f"the frame rate must be positive, not {self.rate}")
        if self.up not in UP_AXES:
            raise BadInput(f"up must be one of {', '.join(UP_AXES)}, not {self.up!r}")
        if self.skeleton is not None and len(self.skeleton) != len(names):
            raise BadInput(f"skeleton of {len(self.skeleton)} joints for {len(names)} points")
        if self.rotations is not None:
            rotations = np.ascontiguousarray(self.rotations, np.float64)
            if rotations.shape != (*positions.shape[:2], 4):
                raise BadInput(f"rotations must be (frames, joints, 4), not {rotations.shape}")
            object.__setattr__(self, "rotations", rotations)
        if not isinstance(self.extras, Deferred):
            require_events(self.extras)
        with np.errstate(over="ignore", invalid="ignore"):
            whole = math.isfinite(positions.sum())  # and so are all of them; far quicker than to look at each
        if not whole:
            self._require_points_or_gaps()

    def _require_points_or_gaps(self) -> None:
        """Raises BadInput for a point that is neither known nor missing."""
        if np.isinf(self.positions).any():
            frame, point = np.argwhere(np.isinf(self.positions))[0, :2]
            raise BadInput(f"point {self.names[point]} is infinite at frame {frame}")
        missing = np.isnan(self.positions)
        partial = missing.any(axis=2) & ~missing.all(axis=2)
        if partial.any():
            frame, point = np.argwhere(partial)[0]
            raise BadInput(f"point {self.names[point]} at frame {frame} has some coordinates missing, not all three")

    def __len__(self) -> int:
        """The number of frames."""
        return self.positions.shape[0]

    @property
    def points(self) -> int:
        """The number of points."""
        return self.positions.shape[1]

    @property
    def seconds(self) -> float:
        """Duration: frames / rate."""
        return len(self) / self.rate

    @property
    def gaps(self) -> NDArray[np.bool_]:
        """(frames, points): True where a point is missing."""
        return np.isnan(self.positions[:, :, 0])

    @property
    def raw_bytes(self) -> int:
        """Size as float32 positions, the measure that every ratio is taken against."""
        return self.positions.size * 4

    def __getitem__(self, key: slice | tuple[slice, Sequence[str]]) -> Motion:
        """`motion[a:b]` frames, `motion[a:b, ["LKNE", "RKNE"]]` frames of named points."""
        if isinstance(key, tuple):
            frames, names = key
            return self.between(*frame_range(frames, len(self))).select(names)
        return self.between(*frame_range(key, len(self)))

    def between(self, start: int, stop: int) -> Motion:
        """Frames [start, stop), with the signals and events that fall into them."""
        if (start, stop) == (0, len(self)):
            return self
        rotations = None if self.rotations is None else self.rotations[start:stop]
        return replace(
            self,
            positions=self.positions[start:stop],
            rotations=rotations,
            extras=extras_between(self.extras, start, stop, self.rate),
            source=source_from(self.source, start),
        )

    def select(self, names: Iterable[str]) -> Motion:
        """The points of these names, in this order; a skeleton stays only whole. Raises BadInput for unknown ones."""
        columns = point_columns(self.names, names)
        if columns == list(range(self.points)):
            return self
        return replace(
            self,
            positions=self.positions[:, columns],
            names=tuple(self.names[c] for c in columns),
            skeleton=None,
            rotations=None,
        )


def frame_range(frames: slice | None, count: int) -> tuple[int, int]:
    """A slice of frames as (start, stop) within [0, count]. Raises BadInput for a step."""
    if frames is None:
        return 0, count
    if not isinstance(cast(object, frames), slice) or frames.step not in (None, 1):
        raise BadInput("frames are chosen by a slice without a step, such as motion[1200:1320]")
    start, stop, _ = frames.indices(count)
    return start, max(start, stop)


def point_columns(all_names: Sequence[str], wanted: Iterable[str]) -> list[int]:
    """Columns of the points of these names. Raises BadInput for an unknown name."""
    wanted = [wanted] if isinstance(wanted, str) else list(wanted)
    where = {name: column for column, name in reversed(list(enumerate(all_names)))}
    unknown = [name for name in wanted if name not in where]
    if unknown:
        raise BadInput(f"no point named {', '.join(map(repr, unknown))}; the names are: {', '.join(all_names)}")
    return [where[name] for name in wanted]


class Deferred(Mapping[str, Any]):
    """Extras that are fetched when first looked at: so that opening a file and taking a slice of it need not."""

    def __init__(self, load: Callable[[], dict[str, Any]]) -> None:
        self._load = load

    @cached_property
    def _loaded(self) -> dict[str, Any]:
        return self._load()

    def __getitem__(self, key: str) -> Any:
        return self._loaded[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._loaded)

    def __len__(self) -> int:
        return len(self._loaded)


def require_events(extras: Mapping[str, Any]) -> None:
    """Raises BadInput where `extras["events"]` is not a list of dicts with their `time_s`."""
    events = extras.get("events", [])
    timed = isinstance(events, list | tuple) and all(
        isinstance(event, Mapping) and isinstance(time := event.get("time_s"), float | int) and -1e12 < time < 1e12
        for event in events
    )
    if not timed:
        raise BadInput("events must be a list of dicts, each with its time_s in seconds")


def extras_between(extras: Mapping[str, Any], start: int, stop: int, rate: float) -> Mapping[str, Any]:
    """Extras of frames [start, stop): signals cut, events outside dropped and the others' times shifted."""
    if isinstance(extras, Deferred):
        return Deferred(lambda: dict(extras_between(dict(extras), start, stop, rate)))

    def cut(value: Any) -> Any:
        if isinstance(value, Signal):
            return value.between(start, stop, rate)
        if isinstance(value, Mapping):
            return {k: cut(v) for k, v in cast(Mapping[str, Any], value).items()}
        return value

    result = {name: cut(value) for name, value in extras.items()}
    if "events" in result:
        shift = start / rate
        result["events"] = [
            {**event, "time_s": event["time_s"] - shift}
            for event in result["events"]
            if start <= event["time_s"] * rate < stop
        ]
    return result


def source_from(source: Mapping[str, Any], start: int) -> dict[str, Any]:
    """The source of a motion that begins `start` frames later."""
    if "first_frame" not in source:
        return dict(source)
    return {**source, "first_frame": source["first_frame"] + start}
