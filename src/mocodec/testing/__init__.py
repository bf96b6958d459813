"""For authors of codecs: tests that every codec must pass, and data to test it on.

CodecTests    a class of tests that a codec's own test class inherits       (needs pytest and hypothesis)
strategies    motions for property tests                                    (needs hypothesis)
synthetic     a walking figure, the same for the same seed: markers, joints
actors        body models: skinned meshes, for synthetic point clouds
sequences     motions of an actor, with the true skeleton, and point clouds of them
poses         standing poses of an actor
odd           named motions with something odd about each
corruption    damaged copies of bytes
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .codec_tests import CodecTests

__all__ = ["CodecTests"]


def __getattr__(name: str) -> Any:
    """CodecTests, without pytest for those who only want motions."""
    if name == "CodecTests":
        from .codec_tests import CodecTests

        return CodecTests
    raise AttributeError(name)
