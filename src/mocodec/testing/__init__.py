"""For authors of codecs: the tests that every codec must pass, and test data.

CodecTests    base class for the test class of a codec                        (needs pytest and hypothesis)
strategies    random motions for property tests                               (needs hypothesis)
synthetic     a walking figure, deterministic for a seed: markers, joints
actors        body models: skinned meshes, for synthetic point clouds
sequences     motions of an actor, with the true skeleton, and point clouds of them
poses         standing and seated poses of an actor
edge_cases    named motions at the limits of what codecs must handle
corruption    damaged copies of bytes
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .codec_tests import CodecTests

__all__ = ["CodecTests"]


def __getattr__(name: str) -> Any:
    """CodecTests on first use, so that the other modules work without pytest."""
    if name == "CodecTests":
        from .codec_tests import CodecTests

        return CodecTests
    raise AttributeError(name)
