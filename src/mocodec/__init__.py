# pyright: strict
"""mocodec stores and streams human motion, with an error that is measured and guaranteed.

import mocodec as mc
m = mc.read("walk.c3d", mc.Motion)
blob = mc.encode(m, max_error=0.002)
m2 = mc.decode(blob, mc.Motion)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .api import File, compare, decode, encode, encode_blocks, not_kept, open, read, read_blocks, write
from .errors import (
    BadInput,
    CannotEncode,
    Corrupt,
    FrameOutOfRange,
    MissingExtra,
    MocodecError,
    TooNew,
    Truncated,
    UnknownCodec,
)
from .motion import Limits, Motion, Signal, Skeleton
from .pointcloud import PointClouds

if TYPE_CHECKING:
    from .archive import Archive, open_archive
    from .codecs import tempo
    from .codecs.bodycast import Bodycast
    from .codecs.hou2014 import Hou2014, Hou2014Database
    from .codecs.lien2006 import Lien2006
    from .codecs.liu2006 import Liu2006
    from .codecs.lossless import Lossless
    from .codecs.tempo import Tempo
    from .viewer import view

__version__ = "0.1.0"

IMPORTED_ON_FIRST_USE = {
    "Archive": "archive",
    "Bodycast": "codecs.bodycast",
    "Hou2014": "codecs.hou2014",
    "Hou2014Database": "codecs.hou2014",
    "Lien2006": "codecs.lien2006",
    "Liu2006": "codecs.liu2006",
    "Lossless": "codecs.lossless",
    "Tempo": "codecs.tempo",
    "open_archive": "archive",
}
"""Classes and functions, and the module that each is in."""


if not TYPE_CHECKING:  # or type checkers would accept any name

    def __getattr__(name: str) -> Any:
        """The classes of the codecs, archives, `view`, and `tempo` with its streaming Encoder and Decoder."""
        if name == "tempo":
            return import_module(f"{__name__}.codecs.tempo")
        if name == "view":
            return import_module(f"{__name__}.viewer").view
        if name in IMPORTED_ON_FIRST_USE:
            return getattr(import_module(f"{__name__}.{IMPORTED_ON_FIRST_USE[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *IMPORTED_ON_FIRST_USE, "tempo", "view"})


__all__ = [
    "Archive", "BadInput", "Bodycast", "CannotEncode", "Corrupt", "File", "FrameOutOfRange", "Hou2014",
    "Hou2014Database", "Lien2006", "Limits", "Liu2006", "Lossless", "MissingExtra", "MocodecError", "Motion",
    "PointClouds", "Signal", "Skeleton", "Tempo", "TooNew", "Truncated", "UnknownCodec", "compare", "decode", "encode",
    "encode_blocks", "not_kept", "open", "open_archive", "read", "read_blocks", "tempo", "view", "write",
]  # fmt: skip
