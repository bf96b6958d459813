"""The rows of a chunk's coefficients, and their quantisation steps.

    (frequencies, rows):  heading · place x, y, z · components of the pose

All rows except the heading share one step, in metres. The heading's steps depend on the number of frames only: it is
rounded before the pose is computed, so that the pose absorbs its rounding error.
"""

from __future__ import annotations

import numpy as np

from ....typing import Floats, Integers
from . import contexts

HEADING = 0
PLACE = slice(1, 4)
POSE = 4
HEADING_STEP = -213
"""log₂ of the step of the mean heading, radians, in 1/32 octave: about 0.01. Steps of its DCT grow with √frames."""


def heading_step(frames: int) -> int:
    """log₂ of the step of the heading's coefficients, radians, in 1/32 octave."""
    return HEADING_STEP + int(contexts.log2(np.array([frames]))[0]) // 2


def step_size(log: int | Integers) -> Floats:
    """Step, metres, of its log₂ in 1/32 octave."""
    return 2.0 ** (np.asarray(log) / contexts.OCTAVE)


def sizes(rows: int, frames: int, step: int) -> Floats:
    """The step of each row, metres or radians: (rows,)."""
    size = np.full(rows, float(step_size(step)))
    size[HEADING] = step_size(heading_step(frames))
    return size
