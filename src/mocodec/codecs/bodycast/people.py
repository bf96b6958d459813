"""Several people in a recording: who stands in the first frame, and whose points are whose later."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import BadInput, CannotEncode
from ...geometry import neighbours
from ...geometry.body_matching import FramePoints
from ...typing import AnyInteger, Floats
from ..clouds.raw_frames import Cloud
from ..clouds.tracked_motion import skeleton_motion
from .tracking import MIN_BODY_POINTS, PersonTracker

MIN_FIRST_POINTS = 4 * MIN_BODY_POINTS  # of a person in the first frame
MIN_GAP_M = 0.12  # between two people in the first frame
MIN_SHARE, MIN_HEIGHT_SHARE = 0.25, 0.5  # of the largest group's points and height, that a person has
CONNECTED_CELLS = 6  # squared distance up to which cells of half a gap are connected: 2.5 cells
CELL_STRIDES = np.array([1 << 42, 1 << 21, 1])  # to number cells: no frame has 2^21 of them along an axis
MAX_BODY_DISTANCE_M = 0.4  # from the nearest body, beyond which a point is an outlier


def segment_people(points: Floats, up: str, limit: int) -> list[AnyInteger]:
    """The rows of each person in points (n, 3), most points first; all rows as one if there is one person."""
    if limit < 2:
        return [np.arange(len(points))]
    cells = np.floor(points / (MIN_GAP_M / 2)).astype(np.int64)
    key = (cells - cells.min(axis=0)) @ CELL_STRIDES
    _, first, cell_of = np.unique(key, return_index=True, return_inverse=True)
    group = neighbours.groups(cells[first], CONNECTED_CELLS)[cell_of.reshape(-1)]
    size = np.bincount(group)
    largest = int(size.argmax())
    vertical = points[:, "xyz".index(up)]
    height = np.ptp(vertical[group == largest])
    chosen = [
        g
        for g in np.argsort(-size, kind="stable").tolist()
        if size[g] >= max(MIN_SHARE * size[largest], MIN_FIRST_POINTS)
        and np.ptp(vertical[group == g]) >= MIN_HEIGHT_SHARE * height
    ]
    if len(chosen) < 2:
        return [np.arange(len(points))]
    return [np.flatnonzero(group == g) for g in chosen[:limit]]


def start_trackers(
    first: Cloud, skeletons: Sequence[Any], up: str, tracked_points: int, limit: int
) -> list[PersonTracker]:
    """Trackers of the people in a frame: one for each skeleton given, then one for every other person found.

    Raises CannotEncode if there is no body, BadInput for a skeleton that does not fit.
    """
    points, colours = first
    groups = segment_people(points, up, max(limit, len(skeletons)))
    trackers = list[PersonTracker]()

    def start(rows: AnyInteger, skeleton: Any) -> None:
        cloud = points[rows], None if colours is None else colours[rows]
        trackers.append(PersonTracker(cloud, skeleton, up, tracked_points))

    for skeleton in skeletons:
        if len(groups) > 1:
            centre = skeleton_motion(skeleton).positions[0].mean(axis=0)
            distance = [float(np.linalg.norm(points[rows].mean(axis=0) - centre)) for rows in groups]
            start(groups.pop(int(np.argmin(distance))), skeleton)
        else:
            start(groups.pop() if groups else np.arange(len(points)), skeleton)
    for rows in groups:
        try:
            start(rows, None)
        except (CannotEncode, BadInput):
            if not trackers and rows is groups[-1]:
                raise
    return trackers


def assign_points(points: Floats, trackers: Sequence[PersonTracker]) -> AnyInteger:
    """(n,): index of the predicted body nearest to each point, −1 for outliers. A single body gets all points."""
    if len(trackers) == 1:
        return np.zeros(len(points), np.int64)
    predicted = [t.posed_template(t.tracker.predict())[::3] for t in trackers]
    distance = [FramePoints.build(p).nearest(points, None, MAX_BODY_DISTANCE_M)[0] for p in predicted]
    nearest = np.argmin(distance, axis=0)
    return np.where(np.isfinite(np.min(distance, axis=0)), nearest, -1)
