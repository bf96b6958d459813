"""Constant costs of a recording are separated from costs of each frame."""

from __future__ import annotations

from benchmarks.cloud import speed


def test_time_is_split_into_what_is_spent_once_and_for_each_frame() -> None:
    short, long = ({"frames": n, "encode_s": 2.0 + 0.05 * n} for n in (20, 60))
    assert speed.frames_a_second(short, long, "encode_s") == ["6.67", "12", "20", "2.0 s"]
