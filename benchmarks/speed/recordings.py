"""Recordings to time: the one inside the package, and larger ones in a folder of recordings."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mocodec import data

DATA = Path(os.environ.get("MOCODEC_DATA", "../shared/data"))
RECORDINGS = {
    "cmu_01_01": data.RECORDING,  # 38 joints
    "85_12": DATA / "cmu/c3d/85_12.c3d",  # 41 markers
    "01_02": DATA / "cmu/asfamc/01/01_02.amc",  # 31 joints
    "131_03": DATA / "cmu/bvh/131_03.bvh",
}


def path_of(name: str) -> Path:
    """The file of a recording. Skips the benchmark if it does not exist."""
    if not RECORDINGS[name].exists():
        pytest.skip(f"{RECORDINGS[name]} does not exist; name a folder of recordings with MOCODEC_DATA")
    return RECORDINGS[name]
