# pyright: strict
"""Motion: named points over time, in metres and hertz. Every reader returns one, every motion codec takes one.

positions (frames, points, 3) · rate · names · up          the motion itself; NaN = gap
skeleton, rotations                                        if the source has them
source, extras                                             what is needed to write the file back unchanged
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .errors import BadInput
from .selection import Frames, counted, frame_steps, point_columns, split_key
from .skeleton import Limits as Limits
from .skeleton import Skeleton as Skeleton
from .typing import Booleans, Floats

UP_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False, repr=False)
class Signal:
    """Samples beside the points: analog channels, camera masks, residuals. Slicing a motion slices its signals too.

    values (samples, …), any dtype, kept bit for bit; rate in hertz (samples per second); labels and units per channel.
    Raises BadInput for values without a time axis and for a rate that is not positive.
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

    def __repr__(self) -> str:
        return f"<Signal: {' × '.join(map(str, self.shape))} {self.dtype} at {self.rate:g} Hz>"

    def between(self, start: int, stop: int, frame_rate: float) -> Signal:
        """The samples of frames [start, stop) of a motion at `frame_rate`."""
        per_frame = self.rate / frame_rate
        return self.samples(round(start * per_frame), round(stop * per_frame))

    def samples(self, start: int, stop: int) -> Signal:
        """Samples [start, stop) of all channels, as a signal."""
        return replace(self, values=self.values[start:stop])

    def channel(self, number: int, start: int, stop: int) -> NDArray[Any]:
        """Samples [start, stop) of one channel, counted over all axes but the first."""
        return self.values[start:stop].reshape(max(0, len(self.values[start:stop])), -1)[:, number]

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of `values`: (samples, …)."""
        return self.values.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of `values`."""
        return self.values.dtype

    def loaded(self) -> Signal:
        """The signal with its values in memory."""
        return self


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Named points over time.

    positions (frames, points, 3) float64, metres, in the source's axes; a gap is NaN in all three coordinates.
    rate: frames per second. names: one per point; P1, P2, … by default. up: the vertical axis, "x", "y" or "z".
    skeleton, rotations (frames, joints, 4; unit quaternions, w first, relative to the parent's frame): None without.
    source: JSON values that describe the file: `format`, `units`, `unit_m` (metres per unit), `first_frame`, …
    extras: what codecs do not code and the container stores losslessly: a tree of dicts and lists with JSON values,
    bytes, NumPy arrays and `Signal`s. `extras["events"]` is a list of dicts with `label` and `time_s`, counted from the
    first frame.

    `motion[1200:1320]` is a motion of these frames, `motion[100]` of one, `motion[::4]` of every fourth;
    `np.asarray(motion, np.float32)` its positions as an array.

    Raises BadInput for arrays of other shapes, names that do not match, infinite or partly missing positions.
    """

    positions: Floats
    rate: float
    names: tuple[str, ...] = ()
    up: str = "z"
    skeleton: Skeleton | None = None
    rotations: Floats | None = None
    source: Mapping[str, Any] = field(default_factory=dict[str, Any])
    extras: Mapping[str, Any] = field(default_factory=dict[str, Any])

    if TYPE_CHECKING:  # the constructor takes more than the fields hold: `__post_init__` converts

        def __init__(
            self,
            positions: ArrayLike,
            rate: float,
            names: Iterable[str] = (),
            up: str = "z",
            skeleton: Skeleton | None = None,
            rotations: ArrayLike | None = None,
            source: Mapping[str, Any] = ...,
            extras: Mapping[str, Any] = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        positions = np.ascontiguousarray(self.positions, np.float64)
        if positions.ndim != 3 or positions.shape[2] != 3:
            raise BadInput(
                f"positions must be (frames, points, 3), not {positions.shape}{reshape_hint(positions.shape)}"
            )
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
            all_finite = math.isfinite(positions.sum())  # much faster than testing every coordinate
        if not all_finite:
            self._require_points_or_gaps()

    def _require_points_or_gaps(self) -> None:
        """Raises BadInput for infinite points and for points with only some coordinates missing."""
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

    def __repr__(self) -> str:
        facts = [f"{counted(len(self), 'frame')} of {counted(self.points, 'point')} at {self.rate:g} Hz"]
        facts += [f"{self.seconds:.4g} s", f"{self.up} up"]
        facts += ["skeleton"] if self.skeleton is not None else []
        facts += ["rotations"] if self.rotations is not None else []
        missing = int(self.gaps.sum())
        facts += [f"{100 * missing / self.gaps.size:.2g} % gaps"] if missing else []
        return f"<Motion: {', '.join(facts)}>"

    def _repr_html_(self) -> str:
        """The motion as a page that plays it, for notebooks; long motions are thinned out (`viewer.for_notebook`)."""
        return cast(str, import_module(f"{__package__}.viewer").for_notebook(self))

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """The positions (frames, points, 3), metres: `np.asarray(motion)`, `np.asarray(motion, np.float32)`."""
        if copy:
            return np.array(self.positions, dtype)
        if copy is False and dtype is not None and np.dtype(dtype) != self.positions.dtype:
            raise ValueError(f"positions are float64; as {np.dtype(dtype)} they must be copied")
        return np.asarray(self.positions, dtype)

    @property
    def points(self) -> int:
        """The number of points."""
        return self.positions.shape[1]

    @property
    def seconds(self) -> float:
        """Duration: frames / rate."""
        return len(self) / self.rate

    @property
    def gaps(self) -> Booleans:
        """(frames, points): True where a point is missing."""
        return np.isnan(self.positions[:, :, 0])

    @property
    def raw_bytes(self) -> int:
        """Size as float32 positions, the reference of every compression ratio."""
        return self.positions.size * 4

    def __getitem__(self, key: Frames | tuple[Frames, Sequence[str]]) -> Motion:
        """`motion[a:b]` frames, `motion[a:b, ["LKNE", "RKNE"]]` frames of named points.

        The result is always a motion: `motion[100]` and `motion[-1]` have one frame, `motion[::4]` has every fourth
        frame at a quarter of the rate. Raises BadInput; FrameOutOfRange (an IndexError too) for a single frame only.
        """
        frames, names = split_key(key)
        start, stop, step = frame_steps(frames, len(self))
        motion = self.between(start, stop).every(step)
        return motion if names is None else motion.select(names)

    def between(self, start: int, stop: int) -> Motion:
        """Frames [start, stop), with their signals and events."""
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

    def every(self, step: int) -> Motion:
        """Every `step`-th frame, at `rate / step`.

        Signals at the motion's own rate are thinned out with it; others keep all samples. Frame numbers of the source
        no longer apply, so `source["first_frame"]` is dropped.
        """
        if step == 1:
            return self
        return replace(
            self,
            positions=self.positions[::step],
            rate=self.rate / step,
            rotations=None if self.rotations is None else self.rotations[::step],
            extras=extras_every(self.extras, step, self.rate),
            source={name: value for name, value in self.source.items() if name != "first_frame"},
        )

    def select(self, names: Iterable[str]) -> Motion:
        """The points with these names, in this order. Raises BadInput for unknown names.

        Skeleton and rotations are kept if the joints are a skeleton of their own: no joint between two of them is
        left out, and parents come first.
        """
        columns = point_columns(self.names, names)
        if columns == list(range(self.points)):
            return self
        skeleton, rotations = None, None
        if self.skeleton is not None and len(set(columns)) == len(columns) > 0:
            kept = import_module(f"{__package__}.geometry.part").part(self.skeleton, self.rotations, columns)
            skeleton, rotations = kept or (None, None)
        return replace(
            self,
            positions=self.positions[:, columns],
            names=tuple(self.names[c] for c in columns),
            skeleton=skeleton,
            rotations=rotations,
        )

    def resample(self, rate: float) -> Motion:
        """The motion at `rate` hertz: see `geometry.resampling`. Raises BadInput for a rate that is not positive."""
        return cast(Motion, import_module(f"{__package__}.geometry.resampling").resample(self, rate))

    def turned(self, up: str) -> Motion:
        """The motion, with its skeleton, turned by a quarter turn so that `up` is vertical. Raises BadInput."""
        return cast(Motion, import_module(f"{__package__}.geometry.turning").turned(self, up))


def reshape_hint(shape: tuple[int, ...], array: str = "positions") -> str:
    """How an array of this shape becomes (frames, points, 3), if it can; empty otherwise."""
    if len(shape) == 2 and shape[1] and shape[1] % 3 == 0:
        return f"; if a row holds x, y, z of each point, use {array}.reshape(-1, {shape[1] // 3}, 3)"
    if len(shape) == 3 and shape[1] == 3:
        return f"; if x, y, z are the second axis, use {array}.transpose(0, 2, 1)"
    if len(shape) == 3 and shape[2] == 4:
        return f"; if the fourth number is no coordinate, use {array}[:, :, :3]"
    return ""


class Deferred(Mapping[str, Any]):
    """Extras that load on first use, so that opening a file and slicing it need not read them."""

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

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (self._loaded,)


def with_valid_positions(motion: Motion, positions: Floats, **others: Any) -> Motion:
    """`replace` of positions (frames, points, 3), float64, and other fields, all of which are known to be valid.

    Positions are not read again: that takes as long as copying them.
    """
    made = copy(motion)
    for name, value in {"positions": positions, **others}.items():
        object.__setattr__(made, name, value)
    return made


def require_events(extras: Mapping[str, Any]) -> None:
    """Raises BadInput unless `extras["events"]`, if present, is a list of dicts with `time_s`."""
    events = extras.get("events", [])
    timed = isinstance(events, list | tuple) and all(
        isinstance(event, Mapping)
        and isinstance(time := cast("Mapping[str, object]", event).get("time_s"), float | int)
        and -1e12 < time < 1e12
        for event in cast("Sequence[object]", events)
    )
    if not timed:
        raise BadInput("events must be a list of dicts, each with its time_s in seconds")


def extras_between(extras: Mapping[str, Any], start: int, stop: int, rate: float) -> Mapping[str, Any]:
    """Extras of frames [start, stop): signals are cut, events outside dropped, times of the others shifted."""
    if isinstance(extras, Deferred):
        return Deferred(lambda: dict(extras_between(dict(extras), start, stop, rate)))
    result = with_signals(extras, lambda signal: signal.between(start, stop, rate))
    if "events" in result:
        shift = start / rate
        result["events"] = [
            {**event, "time_s": event["time_s"] - shift}
            for event in result["events"]
            if start <= event["time_s"] * rate < stop
        ]
    return result


def extras_every(extras: Mapping[str, Any], step: int, rate: float) -> Mapping[str, Any]:
    """Extras of every `step`-th frame of a motion at `rate`: signals at that rate are thinned out too."""
    if isinstance(extras, Deferred):
        return Deferred(lambda: dict(extras_every(dict(extras), step, rate)))

    def thin_out(signal: Signal) -> Signal:
        per_frame = math.isclose(signal.rate, rate)
        return replace(signal, values=signal.values[::step], rate=rate / step) if per_frame else signal

    return with_signals(extras, thin_out)


def with_signals(extras: Mapping[str, Any], change: Callable[[Signal], Signal]) -> dict[str, Any]:
    """A copy of extras with every signal changed, also in nested mappings."""

    def changed(value: Any) -> Any:
        if isinstance(value, Signal):
            return change(value)
        if isinstance(value, Mapping):
            return {name: changed(inner) for name, inner in cast("Mapping[str, Any]", value).items()}
        return value

    return {name: changed(value) for name, value in extras.items()}


def source_from(source: Mapping[str, Any], start: int) -> dict[str, Any]:
    """The source of a motion that starts `start` frames later."""
    first = source.get("first_frame")
    return {**source, "first_frame": first + start} if type(first) is int else dict(source)
