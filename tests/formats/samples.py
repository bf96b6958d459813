"""Small files that the tests of formats write and read; nothing here needs ../shared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocodec import Motion, Signal

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the real recordings in ../shared/data are not here")


def markers(frames: int = 20, points: int = 5, seed: int = 1) -> Motion:
    """Markers in millimetres that a C3D's 32-bit floats hold exactly, with gaps."""
    rng = np.random.default_rng(seed)
    positions = rng.integers(-8000, 8000, (frames, points, 3)) / 8 * 1e-3
    positions[3:6, 1] = np.nan
    positions[0, 0] = np.nan
    return Motion(positions, 120.0, tuple(f"Subject:M{i:03}" for i in range(points)), "z")


def capture() -> Motion:
    """Markers with all that a C3D may have beside them."""
    motion = markers()
    counts = np.random.default_rng(2).integers(-2000, 2000, (200, 3)).astype(np.int16)
    extras = {
        "analog": Signal(counts, 1200.0, ("Fx", "Fy", "EMG"), ("N", "N", "V")),
        "events": [
            {"label": "Foot Strike", "time_s": 0.05, "context": "Left", "icon_id": 1},
            {"label": "Foot Off", "time_s": 0.1, "context": "Right", "minutes": 0},
        ],
        "parameters": {
            "POINT": {"DESCRIPTIONS": ["first", "second", "", "", ""], "MOVIE_DELAY": np.zeros(1, np.float32)},
            "ANALOG": {"SCALE": np.array([0.5, 0.25, 2.0], np.float32), "OFFSET": np.array([4, 0, 12], np.int16)},
            "FORCE_PLATFORM": {
                "USED": np.ones(1, np.int16),
                "CORNERS": np.arange(12, dtype=np.float32).reshape(3, 4, 1),
                "ORIGIN": np.ones((3, 1), np.float32),
            },
            "Own Group": {
                "bytes": np.array([[1, -2], [3, 4]], np.int8),
                "text": "Grüße",
                "table": [["a", "b"], ["c", ""]],
            },
        },
        "parameter_notes": {"ANALOG:SCALE": "newtons a count"},
        "parameters_locked": ["FORCE_PLATFORM"],
    }
    source = {"format": "c3d", "units": "mm", "unit_m": 0.001, "first_frame": 31}
    return Motion(motion.positions, 120.0, motion.names, "z", source=source, extras=extras)


def same_tree(a: object, b: object) -> bool:
    """Dicts, lists, arrays, signals and plain values, equal in type and content."""
    if isinstance(a, Signal) and isinstance(b, Signal):
        return (a.rate, a.labels, a.units) == (b.rate, b.labels, b.units) and same_tree(a.values, b.values)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same_tree(a[k], b[k]) for k in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same_tree, a, b))
    return a == b


BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 1.0 2.0 3.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Chest {
    OFFSET 0.0 50.0 0.0
    CHANNELS 3 Yrotation Xrotation Zrotation
    JOINT Left Arm
    {
      OFFSET 20.0 10.0 0.0
      CHANNELS 1 Xrotation
      End Site
      {
        OFFSET 60.0 0.0 0.0
      }
    }
    JOINT Head
    {
      OFFSET 0.0 30.0 0.0
      CHANNELS 6 Zposition Yposition Xposition Xrotation Yrotation Zrotation
      End Site
      {
        OFFSET 0.0 20.0 0.0
      }
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.0083333
0 90 0 0 0 0   0 0 0  0    0 30 0 0 0 0
5 91 1 90 0 0  0 0 0  90   1 31 2 0 0 0
9 92 2 10 -20 170  -30 40 100 -45  2 29 3 10 20 30
"""

ASF = """# a skeleton of four bones
:version 1.10
:name tiny
:units
  mass 1.0
  length 0.45
  angle deg
:documentation
  none
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name spine
    direction 0 1 0
    length 9
    axis 0 0 0 XYZ
    dof rx ry rz
    limits (-20 20)
           (-20 20)
           (-20 20)
  end
  begin
    id 2
    name femur
    direction 0 -1 0
    length 7
    axis 0 0 20 XYZ
    dof rx ry rz
  end
  begin
    id 3
    name tibia
    direction 0 -1 0
    length 8
    axis 0 0 20 XYZ
    dof rx
  end
  begin
    id 4
    name foot
    direction 0 0 1
    length 2
    axis -90 0 20 XYZ
    dof rx rz
  end
:hierarchy
  begin
    root spine femur
    femur tibia
    tibia foot
  end
"""

AMC = """# made for a test
:FULLY-SPECIFIED
:DEGREES
7
root 0 17 0 0 0 0
spine 0 0 0
femur 0 0 0
tibia 0
foot 0 0
8
root 1 17 2 10 -20 100
spine 1 2 3
femur -50 5 1e-3
tibia 90
foot -100 20
"""
