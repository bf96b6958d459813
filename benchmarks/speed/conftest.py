"""Motions for the timing of codecs."""

from __future__ import annotations

import pytest

import mocodec as mc
from benchmarks.speed.recordings import path_of


@pytest.fixture(params=["cmu_01_01", "85_12"])
def motion(request: pytest.FixtureRequest) -> mc.Motion:
    """A recording with many frames."""
    recording = mc.read(path_of(request.param))
    assert isinstance(recording, mc.Motion)
    return recording
