# pyright: strict
"""Codecs: recordings to Encoded and back. `CODECS` is the table of names on disk: never change a released one."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..errors import UnknownCodec
from .base import Codec

CODECS = {
    "liu2006": "mocodec.codecs.liu2006:Liu2006",
    "hou2014": "mocodec.codecs.hou2014:Hou2014",
    "tempo": "mocodec.codecs.tempo:Tempo",
    "lossless": "mocodec.codecs.lossless:Lossless",
    "lien2006": "mocodec.codecs.lien2006:Lien2006",
    "bodycast": "mocodec.codecs.bodycast:Bodycast",
}


CLOUD_CODECS = ("lien2006", "bodycast")
"""The codecs of CODECS that code point clouds; the others code motion."""


def codec_class(name: str) -> type[Codec[Any]]:
    """The class of a codec, by its name on disk. Raises UnknownCodec."""
    if name not in CODECS:
        raise UnknownCodec(f"no codec named {name!r}; this version of mocodec has: {', '.join(CODECS)}")
    module, attribute = CODECS[name].split(":")
    return getattr(import_module(module), attribute)
