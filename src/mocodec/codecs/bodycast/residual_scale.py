"""The scale of `residual`: from poses alone to every point, each step with more bytes and less error.

    0 ── finer poses, finer static surface ── 25 ── all points within a bound ── 100 ── "exact"
                                               │       falls by a constant factor for each percent
                                               └─ starts at a D1 below that of the surface

Pictures of the changing surface, which files of older versions have above 25 percent, took up to seven times the bytes
of the static surface and left D1 as it was: what remains is the sampling, not the shape.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...encoded import Chunk
from ...metrics import point_clouds
from ...pointcloud import PointClouds
from ..clouds.raw_frames import Cloud
from . import lattice
from .body_model import BodyModel
from .decoder import SceneDecoder
from .point_targets import COARSEST_BOUND_M, DEFAULT_BOUND_M

SURFACE_PERCENT = 25  # up to which surface and poses become finer; above it all points are coded
FINEST_BOUND_M = 1e-4  # at 100 percent
FIRST_D1_SHARE = 0.7  # D1 of the coarsest points, of that of the surface
MEASURED_FRAMES = 4


def bound_of_residual(percent: float, first_m: float) -> float:
    """The bound on the error of points, metres. percent: from SURFACE_PERCENT, where it is first_m, to 100."""
    share = (percent - SURFACE_PERCENT) / (100 - SURFACE_PERCENT)
    return first_m * (FINEST_BOUND_M / first_m) ** share


def first_bound(models: Sequence[BodyModel], payload: bytes, frames: Sequence[Cloud], coloured: bool) -> float:
    """The bound of the coarsest points, metres, whose D1 is below that of the surface. payload: of a chunk of these
    frames without points; without models, the bound of frames without a body.
    """
    if not models or not frames:
        return DEFAULT_BOUND_M
    chunk, scene = Chunk(0, len(frames), payload), SceneDecoder(models, coloured)
    errors = list[float]()
    for k in np.unique(np.linspace(0, len(frames) - 1, MEASURED_FRAMES).round().astype(int)).tolist():
        [(decoded, _)] = scene.decode_chunk(chunk, k, k + 1)
        if len(decoded) and len(frames[k][0]):
            errors.append(point_clouds.d1(PointClouds([frames[k][0]], 1.0), PointClouds([decoded], 1.0), 0))
    wrong = [error for error in errors if error > 0]  # frames without the body are stored as they are
    bound = FIRST_D1_SHARE * float(np.mean(wrong)) / lattice.RMS_PER_BOUND if wrong else DEFAULT_BOUND_M
    return float(np.clip(bound, 2 * FINEST_BOUND_M, COARSEST_BOUND_M))
