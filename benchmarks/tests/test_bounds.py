"""Fine hard maxima: records and tables."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import bounds
from mocodec.codecs.tempo import Tempo
from mocodec.testing import synthetic


def record(file: str, bound: float, ours: int, theirs: int) -> dict[str, object]:
    return {
        "file": file, "frames": 100, "points": 4, "raw_bytes": 4800, "max_error_m": bound,
        "tempo": {"bytes": ours, "error_m": bound}, "sz3": {"bytes": theirs, "error_m": bound},
        "transform": {"bytes": theirs, "error_m": bound},
    }  # fmt: skip


def test_the_bound_is_measured() -> None:
    motion = synthetic.markers(frames=60, seed=1)
    found = bounds.coded(Tempo(max_error=0.001), motion, 0.001)
    assert 0 < found["error_m"] <= 0.001
    with pytest.raises(ValueError, match="an error of"):
        bounds.coded(Tempo(max_error=0.001), motion, found["error_m"] / 2)
    gap = motion.positions.copy()
    gap[3, 2] = np.nan
    with pytest.raises(ValueError, match="gaps"):
        bounds.largest_distance(motion.positions, gap)


def test_the_tables() -> None:
    markers = [record(f, b, 100, t) for b in bounds.BOUNDS_M for f, t in (("a.c3d", 200), ("b.c3d", 800))]
    joints = [record("c.amc", b, 100, 110) for b in bounds.JOINT_BOUNDS_M]
    speed = [
        {"file": "a.c3d", "frames": 1000, "points": 4, "max_error_m": b, "bytes": 1, "encode_fps": 5000.4}
        for b in bounds.SPEED_BOUNDS_M
    ]
    text = bounds.tables({"markers": markers, "joints": joints, "speeds": {"before": speed, "now": speed}})
    assert "| a.c3d | 48.0 (2.00) |" in text
    assert "| geometric mean | **4.00** |" in text
    assert "| least | 2.00 |" in text
    assert "| c.amc | 48.0 (1.10) | 48.0 (1.10) |" in text
    assert "| a.c3d, before | 1,000 × 4 | 5,000 |" in text
