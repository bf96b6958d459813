"""Records of the point cloud benchmark: one coder at one setting on one sequence."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from mocodec.typing import Bytes

LONG = 1000
"""Number of frames for `CloudRecord.ratio_1000`."""


@dataclass
class CloudRecord:
    """One coder at one setting on one sequence. Lengths in metres, times in seconds.

    bytes: the whole stream of all `frames` frames. once_bytes: bytes that do not grow with the number of frames (body
    model, header, index). quality: measures of `point_clouds.compare` between original and decoded, means over
    `measured_frames` frames. floor: the measures of a second perfect sample of the surface.
    """

    sequence: str
    coder: str
    ours: bool
    setting: str
    frames: int
    actor: str = ""
    rate: float = 0.0
    points: float = 0.0
    raw_bytes: int = 0
    counted: str = ""
    bytes: int = 0
    once_bytes: int = 0
    bytes_per_frame: float = 0.0
    ratio: float = 0.0
    ratio_1000: float = 0.0
    decoded_points: float = 0.0
    measured_frames: int = 0
    quality: dict[str, float] = field(default_factory=dict)
    floor: dict[str, float] = field(default_factory=dict)
    encode_fps: float = 0.0
    decode_fps: float = 0.0
    version: str = ""
    problem: str = ""

    @property
    def label(self) -> str:
        """Coder and setting."""
        return f"{self.coder} {self.setting}".strip()


class Measured(NamedTuple):
    """A record with images of the middle frame, original and decoded (None after a failure), each from two sides."""

    record: CloudRecord
    original: Bytes
    decoded: Bytes | None
