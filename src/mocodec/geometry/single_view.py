"""Points that a single camera has seen: where the camera is, and which places the points hide from it.

points ──outward normals──► camera_place ──depth of the points in a picture──► is_hidden
"""

from __future__ import annotations

import numpy as np

from ..typing import Booleans, Floats
from . import normals

MIN_MEAN_NORMAL = 0.3
"""Length of the mean of all outward normals from which one camera has seen the points: 0 for a closed surface, 0.5 for
a visible half sphere."""
CAMERA_DISTANCE_M = 3.0
"""Distance of the camera from the points, metres: depth cameras stand about so far from a person."""
MAX_POINTS, NEIGHBOURS = 2500, 12
"""Points whose normals are estimated, and from how many neighbours each."""
PIXEL_M, PIXEL_SPACINGS = 0.03, 2.0
"""Width of a pixel, metres at the points' distance; in spacings of the points, if that is more."""
NEAREST_M = 0.1
"""Depth of places beside or behind the camera, metres."""
BEHIND_M = 0.05
"""A place is hidden if it is behind the points by more than this, metres."""


def camera_place(points: Floats) -> Floats | None:
    """Place (3,) of the camera that has seen points (n, 3), metres, if it was one; None if there were others."""
    if len(points) < NEIGHBOURS:
        return None
    some = points[np.random.default_rng(0).permutation(len(points))[:MAX_POINTS]]
    mean = normals.outward(some, NEIGHBOURS).mean(axis=0)
    length = float(np.linalg.norm(mean))
    return None if length < MIN_MEAN_NORMAL else some.mean(axis=0) + CAMERA_DISTANCE_M / length * mean


def is_hidden(places: Floats, points: Floats, camera: Floats) -> Booleans:
    """(k,): whether each of places (k, 3) is behind points (n, 3) as seen from the camera (3,), metres."""
    from scipy.ndimage import grey_closing

    forward = points.mean(axis=0) - camera
    distance = float(np.linalg.norm(forward))
    forward /= distance
    side = np.eye(3)[int(np.abs(forward).argmin())]
    side -= side @ forward * forward
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(forward, side)], axis=1)
    scale = distance / max(PIXEL_M, PIXEL_SPACINGS * normals.spacing(points))

    def seen(x: Floats) -> tuple[Floats, Floats]:
        """Pixels (k, 2), not rounded, and depths (k,)."""
        ray = x - camera
        depth = np.maximum(ray @ forward, NEAREST_M)
        return ray @ axes / depth[:, None] * scale, depth

    pixel, depth = seen(points)
    low = np.floor(pixel.min(axis=0)).astype(np.int64) - 2
    shape = np.floor(pixel.max(axis=0)).astype(np.int64) - low + 3
    far = float(depth.max()) + 100.0
    picture = np.full(shape, far)
    row, column = (np.floor(pixel).astype(np.int64) - low).T
    np.minimum.at(picture, (row, column), depth)
    picture = -np.asarray(grey_closing(-picture, size=(3, 3)))  # fill the gaps between points
    pixel, depth = seen(places)
    row, column = np.clip(np.floor(pixel).astype(np.int64) - low, 0, shape - 1).T
    return depth > picture[row, column] + BEHIND_M
