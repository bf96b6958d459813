"""The paper's rules for its parameters (section VI-A): how many DCT frequencies to keep, how many fraction bits."""

from __future__ import annotations

import math

COMPONENTS = 30
"""k"""

CLIP_FRAMES = 280
"""L"""

UNIT_M = 0.01
"""Unit of the quantiser: the paper's centimetre."""


def frequencies(components: int, clip_frames: int) -> int:
    """l = r k with r = 0.1 ⌈L / 50⌉, equation (12): the number of DCT frequencies to keep in a clip of L frames.

    Our choice where the paper is silent: r k is rounded up, and l lies in [1, L].
    """
    tenths = math.ceil(clip_frames / 50)
    return max(1, min(clip_frames, -(-tenths * components // 10)))


def fraction_bits(components: int) -> int:
    """Q, equation (13): bits of a coefficient's fractional part. The formula goes on beyond the paper's k = 93."""
    return max(0, math.ceil((components - 30) / 10))
