"""The paper's settings by number: how many frequencies, how many bits (Hou 2014, section VI-A)."""

from __future__ import annotations

import math

COMPONENTS = 30
CLIP_FRAMES = 280
UNIT_M = 0.01


def frequencies(components: int, clip_frames: int) -> int:
    """l = r k with r = 0.1 ⌈L / 50⌉, equation (12): the number of DCT frequencies kept of a clip of L frames.

    At least one, at most L; r k is rounded up.
    """
    tenths = math.ceil(clip_frames / 50)
    return max(1, min(clip_frames, -(-tenths * components // 10)))


def fraction_bits(components: int) -> int:
    """Q, equation (13): bits of a coefficient's fractional part. It goes on beyond k = 93, where the paper stops."""
    return max(0, math.ceil((components - 30) / 10))
