"""Recordings for the benchmarks: the one in the package, and larger ones from the folder MOCODEC_DATA if it exists."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import mocodec as mc
from mocodec import data

DATA = Path(os.environ.get("MOCODEC_DATA", Path(__file__).parents[2] / "shared" / "data"))
RECORDINGS = {
    "cmu_01_01": data.RECORDING,  # 38 joints
    "85_12": DATA / "cmu/c3d/85_12.c3d",  # 41 markers
    "01_02": DATA / "cmu/asfamc/01/01_02.amc",  # 31 joints
    "131_03": DATA / "cmu/bvh/131_03.bvh",
}


def path_of(name: str) -> Path:
    """The path of a recording; skips the benchmark if the file does not exist."""
    if not RECORDINGS[name].exists():
        pytest.skip(f"{RECORDINGS[name]} does not exist: set MOCODEC_DATA to a folder of recordings")
    return RECORDINGS[name]


@pytest.fixture(params=["cmu_01_01", "85_12"])
def motion(request: pytest.FixtureRequest) -> mc.Motion:
    recording = mc.read(path_of(request.param))
    assert isinstance(recording, mc.Motion)
    return recording
