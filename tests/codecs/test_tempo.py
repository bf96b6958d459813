"""Tempo keeps the contract of every codec, and its own promises."""

from __future__ import annotations

from typing import Any

from mocodec.codecs.tempo import Tempo
from mocodec.testing import CodecTests


class TestTempo(CodecTests):
    codec = staticmethod(lambda **settings: Tempo(**settings))
    can_bound = True
    quick: Any = {"max_error": 0.02}
