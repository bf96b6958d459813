"""The paper's rules for its parameters: equations (12) and (13)."""

from __future__ import annotations

import pytest

from mocodec.codecs.hou2014 import parameters


@pytest.mark.parametrize(
    ("components", "bits"),
    [(1, 0), (30, 0), (31, 1), (40, 1), (41, 2), (93, 7)],
)
def test_fraction_bits_follow_equation_13(components: int, bits: int):
    assert parameters.fraction_bits(components) == bits


@pytest.mark.parametrize(
    ("components", "clip_frames", "frequencies"),
    [(30, 280, 18), (30, 50, 3), (15, 350, 11), (30, 7, 3), (60, 4, 4)],
)
def test_frequencies_follow_equation_12(components: int, clip_frames: int, frequencies: int):
    assert parameters.frequencies(components, clip_frames) == frequencies
