"""Tempo without one part at a time."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import tempo, tempo_parts
from mocodec.codecs.tempo.pose import heading
from mocodec.motion import Motion
from mocodec.testing import synthetic

MARKERS = ["C7", "LSHO", "RSHO", "LFWT", "RFWT", "LKNE", "LHEE", "RTOE"]


def turning_person() -> Motion:
    """Eight markers, y up, which rotate half a turn about the vertical axis."""
    motion = synthetic.markers(frames=96, seed=4).select(MARKERS)
    turned = heading.rotate(heading.to_y_up(motion.positions, motion.up), np.linspace(0, np.pi, 96))
    return Motion(turned, motion.rate, motion.names, "y")


MOTION = turning_person()


@pytest.mark.parametrize("name", tempo_parts.PARTS)
def test_every_part_can_be_taken_out(name: str) -> None:
    target = {"max_error": 0.003}
    value = tempo_parts.ratio(name, MOTION, target)
    if name in ("directions-prior only", "directions-stored only"):
        assert value is None
    else:
        assert value is not None
        assert value > 1


def test_parts_are_patched_only_within_the_row() -> None:
    target = {"max_error": 0.003}
    before = tempo_parts.ratio(tempo_parts.CHUNKS, MOTION, target)
    changed = [
        tempo_parts.ratio(name, MOTION, target)
        for name in ("no heading", "numbers rounded to the nearest", "no groups of frequencies")
    ]
    assert before not in changed
    assert tempo_parts.ratio(tempo_parts.CHUNKS, MOTION, target) == before


def test_a_part_without_which_a_recording_cannot_be_coded_is_compared_on_the_others() -> None:
    rows = [
        {"file": file, "without": name, "against": "whole", "mean_error": 0.001, "ratio": ratio}
        for file, name, ratio in (("a", "whole", 10.0), ("b", "whole", 20.0), ("a", "part", 9.0))
    ]
    assert "| part | -10.0 % (1 of 2) | – | – | – |" in tempo.parts_markdown(rows)
