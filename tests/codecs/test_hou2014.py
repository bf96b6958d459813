"""hou2014: the contract of every codec, the paper's numbers, targets, transforms learned elsewhere."""

from __future__ import annotations

from mocodec.codecs.hou2014 import Hou2014
from mocodec.testing.codec_tests import CodecTests


class TestHou2014(CodecTests):
    codec = staticmethod(lambda **settings: Hou2014(**settings))
    can_bound = True


class TestHou2014AsPublished(CodecTests):
    codec = staticmethod(lambda **settings: Hou2014.as_published(**settings))
    qualities = ({"components": 10}, {"components": 30}, {"components": 60})
    refuses = frozenset()
