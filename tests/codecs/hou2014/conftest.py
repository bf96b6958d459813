"""Motions that several tests of hou2014 share."""

from __future__ import annotations

import pytest

from mocodec.motion import Motion
from mocodec.testing import synthetic


@pytest.fixture(scope="session")
def walk() -> Motion:
    return synthetic.markers(frames=900, seed=7)
