"""The small real recording inside the package: Carnegie Mellon motion capture, subject 1, trial 1, as a .mocz."""

from __future__ import annotations

from pathlib import Path

RECORDING = Path(__file__).parent / "cmu_01_01.mocz"

ACKNOWLEDGEMENT = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217."
)
