"""A synthetic walking figure: deterministic for a seed, human enough to test codecs, free of any licence.

gait phase, smooth noise ─► joint angles ─► forward kinematics ─► joints (21)
                                                       └─► markers on the bones (41, Plug-in-Gait and the feet)
"""

from __future__ import annotations

import numpy as np

from ..geometry import kinematics, rigid
from ..motion import Motion, Skeleton
from ..typing import Floats

# joint: (parent, offset from the parent in metres; x forward, y left, z up)
_JOINTS: dict[str, tuple[str, tuple[float, float, float]]] = {
    "Hips": ("", (0.0, 0.0, 0.0)),
    "Spine": ("Hips", (-0.01, 0.0, 0.10)),
    "Chest": ("Spine", (-0.01, 0.0, 0.18)),
    "Neck": ("Chest", (0.0, 0.0, 0.22)),
    "Head": ("Neck", (0.02, 0.0, 0.12)),
    "LeftShoulder": ("Chest", (0.0, 0.17, 0.17)),
    "LeftElbow": ("LeftShoulder", (0.0, 0.02, -0.29)),
    "LeftWrist": ("LeftElbow", (0.0, 0.0, -0.26)),
    "LeftHand": ("LeftWrist", (0.0, 0.0, -0.09)),
    "RightShoulder": ("Chest", (0.0, -0.17, 0.17)),
    "RightElbow": ("RightShoulder", (0.0, -0.02, -0.29)),
    "RightWrist": ("RightElbow", (0.0, 0.0, -0.26)),
    "RightHand": ("RightWrist", (0.0, 0.0, -0.09)),
    "LeftHip": ("Hips", (0.0, 0.09, -0.03)),
    "LeftKnee": ("LeftHip", (0.0, 0.0, -0.42)),
    "LeftAnkle": ("LeftKnee", (0.0, 0.0, -0.41)),
    "LeftToe": ("LeftAnkle", (0.16, 0.0, -0.06)),
    "RightHip": ("Hips", (0.0, -0.09, -0.03)),
    "RightKnee": ("RightHip", (0.0, 0.0, -0.42)),
    "RightAnkle": ("RightKnee", (0.0, 0.0, -0.41)),
    "RightToe": ("RightAnkle", (0.16, 0.0, -0.06)),
}

# marker: (joint that it moves with, offset in the frame of that joint); _SIDE is the left side, mirrored for the right
_MIDDLE: dict[str, tuple[str, tuple[float, float, float]]] = {
    "C7": ("Chest", (-0.07, 0.0, 0.21)),
    "T10": ("Chest", (-0.11, 0.0, 0.02)),
    "CLAV": ("Chest", (0.08, 0.0, 0.17)),
    "STRN": ("Chest", (0.11, 0.0, 0.03)),
    "RBAC": ("Chest", (-0.10, -0.07, 0.10)),
}
_SIDE: dict[str, tuple[str, tuple[float, float, float]]] = {
    "FHD": ("Head", (0.09, 0.06, 0.08)),
    "BHD": ("Head", (-0.08, 0.06, 0.08)),
    "SHO": ("Shoulder", (0.0, 0.0, 0.05)),
    "UPA": ("Shoulder", (0.01, 0.06, -0.15)),
    "ELB": ("Elbow", (-0.01, 0.05, 0.0)),
    "FRM": ("Elbow", (0.02, 0.04, -0.13)),
    "WRA": ("Wrist", (0.03, 0.0, 0.0)),
    "WRB": ("Wrist", (-0.03, 0.0, 0.0)),
    "FIN": ("Hand", (0.0, 0.02, 0.0)),
    "FWT": ("Hips", (0.10, 0.13, 0.04)),
    "BWT": ("Hips", (-0.10, 0.06, 0.05)),
    "THI": ("Hip", (0.02, 0.09, -0.22)),
    "KNE": ("Knee", (0.0, 0.06, 0.0)),
    "SHN": ("Knee", (0.03, 0.05, -0.20)),
    "ANK": ("Ankle", (0.0, 0.05, 0.0)),
    "HEE": ("Ankle", (-0.06, 0.0, -0.05)),
    "MT5": ("Ankle", (0.11, 0.05, -0.05)),
    "TOE": ("Toe", (0.0, 0.0, 0.01)),
}

# joint: (axis, mean angle, amplitude and phase at the gait frequency, amplitude and phase at twice that) of the left
# side; angles in degrees, phases in periods
_GAIT: dict[str, tuple[tuple[str, float, float, float, float, float], ...]] = {
    "Hip": (("y", -10, 24, 0.0, 3, 0.2), ("x", 0, 4, 0.3, 0, 0.0)),
    "Knee": (("y", 30, 24, 0.62, 14, 0.1),),
    "Ankle": (("y", 2, 12, 0.25, 6, 0.5),),
    "Shoulder": (("y", 5, 20, 0.5, 2, 0.0), ("x", 6, 2, 0.1, 0, 0.0)),
    "Elbow": (("y", -25, 12, 0.55, 0, 0.0),),
    "Hips": (("z", 0, 5, 0.1, 0, 0.0), ("x", 0, 3, 0.35, 0, 0.0)),
    "Spine": (("z", 0, -6, 0.1, 0, 0.0), ("y", 4, 0, 0.0, 2, 0.3)),
    "Chest": (("z", 0, -5, 0.15, 0, 0.0),),
    "Neck": (("y", 2, 0, 0.0, 2, 0.6),),
}


def joints(frames: int = 600, rate: float = 120.0, seed: int = 0) -> Motion:
    """The joints of a walking figure (frames, 21, 3), with skeleton and rotations; z up."""
    skeleton, rotations, positions, _ = _walk(frames, rate, seed)
    return Motion(positions, rate, skeleton.names, "z", skeleton, rotations, source={"format": "synthetic"})


def markers(frames: int = 600, rate: float = 120.0, seed: int = 0, noise: float = 1e-4) -> Motion:
    """Markers on a walking figure (frames, 41, 3), named as in Plug-in-Gait; z up.

    noise: standard deviation of the measurement error in metres. Markers also slide on the skin by millimetres.
    """
    skeleton, rotations, positions, random = _walk(frames, rate, seed)
    world = kinematics.world_rotations(skeleton, rotations)
    carried_by: dict[str, tuple[str, tuple[float, float, float]]] = dict(_MIDDLE)
    for name, (joint, (x, y, z)) in _SIDE.items():
        for side, sign in (("Left", 1), ("Right", -1)):
            carried_by[side[0] + name] = (joint if joint in _JOINTS else side + joint, (x, sign * y, z))
    placed = np.empty((frames, len(carried_by), 3))
    seconds = np.arange(frames) / rate
    for column, (joint, offset) in enumerate(carried_by.values()):
        at = skeleton.names.index(joint)
        skin = np.array(offset) + 0.002 * _smooth_noise(random, seconds, 3, 1.5)
        placed[:, column] = positions[:, at] + rigid.rotate(world[:, at], skin)
    placed += random.normal(scale=noise, size=placed.shape)
    return Motion(placed, rate, tuple(carried_by), "z", source={"format": "synthetic", "units": "mm", "unit_m": 0.001})


def _walk(frames: int, rate: float, seed: int) -> tuple[Skeleton, Floats, Floats, np.random.Generator]:
    random = np.random.default_rng(seed)
    names = tuple(_JOINTS)
    size = random.normal(1.0, 0.05)
    offsets = size * np.array([offset for _, offset in _JOINTS.values()])
    skeleton = Skeleton(names, tuple(names.index(parent) if parent else -1 for parent, _ in _JOINTS.values()), offsets)
    seconds = np.arange(frames) / rate
    cadence = random.normal(0.9, 0.08)
    phase = 2 * np.pi * (cadence * seconds + 0.08 * _smooth_noise(random, seconds, 1, 0.2)[:, 0])
    effort = 1 + 0.12 * _smooth_noise(random, seconds, 1, 0.3)[:, 0]

    rotations = np.empty((frames, len(names), 4))
    for column, name in enumerate(names):
        side = 0.5 if name.startswith("Right") else 0.0
        gait = _GAIT.get(name.removeprefix("Left").removeprefix("Right"), ())
        angles = np.radians(3.0) * _smooth_noise(random, seconds, 3, 0.8)
        for axis, mean, swing, lag, double, double_lag in gait:
            sign = -1 if side and axis != "y" else 1
            wave = swing * np.sin(phase + 2 * np.pi * (lag + side))
            wave = wave + double * np.sin(2 * phase + 2 * np.pi * (double_lag + 2 * side))
            angles[:, "xyz".index(axis)] += sign * np.radians(mean + effort * wave)
        rotations[:, column] = rigid.from_euler("zyx", angles[:, ::-1])

    heading = 0.9 * _smooth_noise(random, seconds, 1, 0.05)[:, 0]
    speed = 1.25 * size * effort * cadence / 0.9
    root = np.empty((frames, 3))
    root[:, 0] = np.cumsum(speed * np.cos(heading)) / rate
    root[:, 1] = np.cumsum(speed * np.sin(heading)) / rate + 0.02 * np.sin(phase)
    root[:, 2] = 0.93 * size + 0.02 * np.cos(2 * phase)
    rotations[:, 0] = rigid.multiply(rigid.about_axis("z", heading), rotations[:, 0])
    return skeleton, rotations, kinematics.forward(skeleton, rotations, root), random


def _smooth_noise(random: np.random.Generator, seconds: Floats, columns: int, hertz: float) -> Floats:
    """Noise (frames, columns) of unit size: sines of random phases around `hertz`, the faster the smaller."""
    rates = hertz * np.array([0.31, 0.57, 1.0, 1.73, 2.9, 4.7]) * random.uniform(0.9, 1.1, 6)
    sizes = 1 / (1 + (rates / hertz) ** 2)
    phases = random.uniform(0, 2 * np.pi, (6, columns))
    waves = np.sin(2 * np.pi * rates[:, None, None] * seconds[None, :, None] + phases[:, None])
    return np.einsum("k,ktl->tl", sizes * random.choice([-1, 1], 6), waves)
