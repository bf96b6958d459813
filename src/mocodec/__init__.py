"""mocodec stores, ships and streams human motion with an error that it measures and guarantees.

import mocodec as mc
m = mc.read("walk.c3d")
blob = mc.encode(m, max_error=0.002)
m2 = mc.decode(blob)
"""

from __future__ import annotations

from typing import Any

from .api import File, compare, decode, encode, open, read, write
from .errors import BadInput, CannotEncode, Corrupt, MocodecError, TooNew, Truncated, UnknownCodec
from .motion import Motion, Signal, Skeleton
from .pointcloud import PointClouds

__version__ = "0.1.0"

CODEC_CLASSES = {
    "Liu2006": "liu2006",
    "Hou2014": "hou2014",
    "Tempo": "tempo",
    "Lossless": "lossless",
    "Lien2006": "lien2006",
    "Bodycast": "bodycast",
}


def __getattr__(name: str) -> Any:
    """The codecs' classes, imported when first used."""
    if name in CODEC_CLASSES:
        from .codecs import codec_class

        return codec_class(CODEC_CLASSES[name])
    raise AttributeError(f"module 'mocodec' has no attribute {name!r}")


__all__ = [
    "BadInput", "CannotEncode", "Corrupt", "File", "MocodecError", "Motion", "PointClouds", "Signal", "Skeleton",
    "TooNew", "Truncated", "UnknownCodec", "compare", "decode", "encode", "open", "read", "write",
]  # fmt: skip
