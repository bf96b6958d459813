"""Each measure of error once, with the number of its equation in the paper.

motion          distances between motions: `compare` and the measures that it reports
skeletal        shell points and rotations of skeletal motions, by forward kinematics of its own
point_clouds    D1, D2, luma and rendered views of point clouds
splats          the rendering of point clouds that the views are compared by
"""

from .motion import (
    Comparison,
    Errors,
    compare,
    distances,
    distortion_percent,
    errors,
    in_order_of,
    mean_distance,
    rms_per_frame,
)
from .skeletal import SHELL_M, SkeletalErrors, Spread

__all__ = [
    "SHELL_M",
    "Comparison",
    "Errors",
    "SkeletalErrors",
    "Spread",
    "compare",
    "distances",
    "distortion_percent",
    "errors",
    "in_order_of",
    "mean_distance",
    "rms_per_frame",
]
