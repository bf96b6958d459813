"""A motion at another frame rate: what it would be at other times within its span.

    with rotations     rotations ─► slerp ─┐
                       root and moving joints' translations ─► cubic splines ─┴─► forward kinematics ─► positions
    positions alone    cubic spline of each run of a point between its gaps ─► positions; gaps stay gaps

Nothing is filtered: a lower rate keeps the samples at its times, and vibration above half of it appears as slower
motion, as it does in a camera.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import BadInput
from ..motion import Motion, Signal, with_signals
from ..typing import Booleans, Floats, Integers
from . import bone_frames, kinematics, rigid

ON_FRAME = 1e-6
"""A time this near a frame, in frames, is that frame."""
STILL_M = 1e-7
"""A joint that moves less than this against its parent keeps its offset."""
MAX_FRAMES = 1 << 31


def resample(motion: Motion, rate: float) -> Motion:
    """The motion at `rate` hertz, from its first frame to the last time within its span.

    Rotations turn along the shorter arc (slerp), other coordinates follow cubic splines. A point is a gap at a time
    that has a gap on either side. Events and signals keep their own times and rates; marks of samples at the motion's
    own rate (residuals, zeros) are those of the nearest frame. Raises BadInput for a rate that is not positive.
    """
    if not (math.isfinite(rate) and rate > 0):
        raise BadInput(f"a frame rate is a positive number of hertz, not {rate}")
    if rate == motion.rate:
        return motion
    frames = len(motion)
    span = max(frames - 1, 0) * rate / motion.rate
    if span > MAX_FRAMES:
        raise BadInput(f"{rate:g} Hz would make more than {MAX_FRAMES} frames")
    at = np.arange(math.floor(span + ON_FRAME) + 1 if frames else 0) * (motion.rate / rate)
    nearest = np.rint(at)
    at = np.minimum(np.where(np.abs(at - nearest) < ON_FRAME, nearest, at), max(frames - 1, 0))
    rotations = None
    if motion.rotations is not None and motion.skeleton is not None:
        rotations = rotations_at(motion.rotations, at)
        positions = _placed(motion, rotations, at)
    else:
        positions = positions_at(motion.positions, at)
        rotations = None if motion.rotations is None else rotations_at(motion.rotations, at)
    extras = motion.extras if isinstance(motion.extras, dict) else dict(motion.extras)
    return replace(
        motion,
        positions=positions,
        rotations=rotations,
        rate=rate,
        source=_source(motion),
        extras=_extras(extras, motion, rate, np.rint(at).astype(np.int64)),
    )


def positions_at(positions: Floats, at: Floats) -> Floats:
    """Positions (frames, points, 3) at times `at` (in frames, ascending), by a cubic spline for each run without gaps.

    A time on a frame has the frame's position; between two frames, both must be there.
    """
    result = np.full((len(at), *positions.shape[1:]), np.nan)
    for (start, stop), points in _runs(np.isnan(positions[:, :, 0])).items():
        inside = (at >= start) & (at <= stop - 1)
        if not inside.any():
            continue
        values = _spline(positions[start:stop, points].reshape(stop - start, -1), at[inside] - start)
        result[np.ix_(np.flatnonzero(inside), np.array(points))] = values.reshape(-1, len(points), 3)
    return result


def rotations_at(rotations: Floats, at: Floats) -> Floats:
    """Rotations (frames, joints, 4) at times `at` (in frames), along the shorter arc."""
    if not len(rotations):
        return rotations[:0]
    before = np.minimum(np.floor(at).astype(np.int64), len(rotations) - 1)
    share = (at - before)[:, None]
    after = np.minimum(before + 1, len(rotations) - 1)
    between = rigid.slerp(rotations[before], rotations[after], np.broadcast_to(share, (len(at), rotations.shape[1])))
    return np.where(share[..., None] == 0, rotations[before], between)


def _runs(gaps: Booleans) -> dict[tuple[int, int], list[int]]:
    """The points of each run (start, stop) of frames without gaps, of `gaps` (frames, points)."""
    edges = np.diff(np.pad(~gaps, ((1, 1), (0, 0))).astype(np.int8), axis=0).T
    starts, stops = np.nonzero(edges == 1), np.nonzero(edges == -1)
    runs: dict[tuple[int, int], list[int]] = {}
    for point, start, stop in zip(starts[0].tolist(), starts[1].tolist(), stops[1].tolist(), strict=True):
        runs.setdefault((start, stop), []).append(point)
    return runs


def _spline(values: Floats, at: Floats) -> Floats:
    """The cubic spline through values (frames, k) at 0, 1, …, at times `at` within: (len(at), k)."""
    if len(values) < 3:
        return values[:1] + at[:, None] * (values[-1:] - values[:1])
    from scipy.interpolate import CubicSpline

    result: Floats = CubicSpline(np.arange(len(values)), values)(at)
    on_frame = at == np.rint(at)
    result[on_frame] = values[at[on_frame].astype(np.int64)]
    return result


def _placed(motion: Motion, rotations: Floats, at: Floats) -> Floats:
    """Positions by forward kinematics of resampled rotations; gaps as in `positions_at`."""
    skeleton, original = motion.skeleton, motion.rotations
    assert skeleton is not None
    assert original is not None
    own_frame = bone_frames.is_own_frame(motion)
    world = kinematics.world_rotations(skeleton, original)
    translations: dict[int, Floats] = {}
    for joint, parent in enumerate(skeleton.parents):
        if parent < 0:
            translations[joint] = positions_at(motion.positions[:, joint : joint + 1], at)[:, 0]
            continue
        carrier = world[:, joint if own_frame else parent]
        local = rigid.rotate(rigid.inverse(carrier), motion.positions[:, joint] - motion.positions[:, parent])
        missing = np.isnan(local[:, 0])
        if np.abs(local - skeleton.offsets[joint])[~missing].max(initial=0.0) > STILL_M:
            translations[joint] = positions_at(local[:, None], at)[:, 0]
    positions = kinematics.forward(
        skeleton, rotations, np.zeros((len(at), 3)), own_frame=own_frame, translations=translations
    )
    if motion.gaps.any():
        before, after = np.floor(at).astype(np.int64), np.ceil(at).astype(np.int64)
        positions[motion.gaps[before] | motion.gaps[after] | np.isnan(positions).any(axis=2)] = np.nan
    return positions


def _source(motion: Motion) -> dict[str, Any]:
    """The source without frame numbers, which no longer apply; the time of the first frame stays."""
    source = {name: value for name, value in motion.source.items() if name != "first_frame"}
    first, offset = motion.source.get("first_frame", 1), motion.source.get("time_of_frame_1", 0.0)
    if isinstance(first, int) and isinstance(offset, float | int) and first > 1:
        source["time_of_frame_1"] = round(offset + (first - 1) / motion.rate, 9)
    return source


PER_FRAME = ("zero_samples", "residuals")
"""Signals that mark the samples of frames, not times of their own."""


def _extras(extras: Mapping[str, Any], motion: Motion, rate: float, nearest: Integers) -> dict[str, Any]:
    """The extras with the marks of samples taken from the nearest frames."""

    def at_frames(signal: Signal) -> Signal:
        if len(signal.values) != len(motion) or not math.isclose(signal.rate, motion.rate):
            return signal
        return replace(signal, values=signal.values[nearest], rate=rate)

    marks = with_signals({name: extras[name] for name in PER_FRAME if name in extras}, at_frames)
    return {name: marks.get(name, value) for name, value in extras.items()}
