"""Frames at which a codec begins something, for the timeline: clips of hou2014, segments and key frames of liu2006."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np

from .. import api
from ..codecs.hou2014.decoding import clip_starts
from ..codecs.liu2006.decoding import key_frames
from ..encoded import Chunk, Encoded
from ..errors import Corrupt, Truncated
from ..typing import Integers
from .recording import Shown

MOST_MARKS = 5_000
"""More would fill the timeline from end to end."""


def chunk_starts(_: Encoded[Any]) -> Callable[[Chunk], Integers]:
    """A function from a chunk to its first frame, (1,)."""
    return lambda chunk: np.array([chunk.start])


MARKS: dict[str, dict[str, Callable[[Encoded[Any]], Callable[[Chunk], Integers]]]] = {
    "hou2014": {"clip": clip_starts},
    "liu2006": {"segment": chunk_starts, "key frame": key_frames},
}
"""For each codec: what its marks are, and a function from the file to one from a chunk to the marks' frames."""


def marks(shown: Shown) -> list[dict[str, Any]]:
    """Kinds of marks of a compressed file, each with its frames; damaged chunks have none."""
    if not isinstance(shown.recording, api.File) or shown.codec not in MARKS:
        return []
    encoded = shown.recording.encoded
    if not encoded.shared:
        return []
    found: list[dict[str, Any]] = []
    for label, reader in MARKS[shown.codec].items():
        frames, frames_of = list[int](), reader(encoded)
        for chunk in encoded.chunks:
            with contextlib.suppress(Corrupt, Truncated):
                frames += frames_of(chunk).tolist()
            if len(frames) > MOST_MARKS:
                break
        else:
            found.append({"label": label, "frames": frames})
    return found
