"""NPY: one array of joint positions, (frames, joints, 3), or HumanML3D's feature vectors.

An .npy has neither names nor a rate. 22 joints are HumanML3D's, at its 20 Hz; their names are given if the bones of
that tree keep their lengths, and otherwise y is up, as in that data set. Feature vectors (frames, 263) are decoded to
joints, as that data set defines them:

    [0]       half the angle about y from this frame to the next      ─► sum ─► heading
    [1:3]     velocity of the root along x and z, seen in the heading ─► turned, summed ─► root
    [3]       height of the root
    [4:67]    21 joints from the root's place on the floor, seen in the heading ─► turned
    [67:263]  rotations, velocities and foot contacts, which follow from these
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..motion import Motion, reshape_hint
from ..typing import Floats
from . import replace_whole, smpl
from .blocks import Blocks, block_frames, of_ranges
from .conventions import guess_unit, guess_up, unit_option
from .numpy_files import MAX_ARRAY_BYTES, MAX_HEADER_BYTES, array_of, bytes_of, header_of, reading

LACKS = ("frame rate", "names", "vertical axis")
"""What an NPY never stores."""
HUMANML_JOINTS, HUMANML_FEATURES, HUMANML_RATE = 22, 263, 20.0
MOST_FEATURE = 1e6
"""Features are metres, metres a frame and half angles: larger ones are no data."""
OTHER_FEATURES = {251: "KIT-ML feature vectors", 322: "Motion-X parameters", 135: "6-D rotations", 148: "6-D rotations"}
MAX_BONE_CHANGE = 0.02
"""Bones of decoded feature vectors change by a share below this; those of normalised vectors by far more."""


def read(path: str | Path, rate: float | None = None, unit: str | float | None = None, up: str | None = None) -> Motion:
    """Joints of an NPY as a motion. unit: of the positions, by default guessed. A sample with NaN is a gap.

    rate: hertz; 20 by default for 22 joints and for feature vectors (HumanML3D's), a guess; others need it. Raises
    BadInput.
    """
    path = Path(path)
    if path.stat().st_size > MAX_ARRAY_BYTES:
        raise BadInput(f"{path}: larger than the {MAX_ARRAY_BYTES >> 30} GiB that are read at once")
    with reading(path, "an NPY"):
        values = array_of(path.read_bytes(), f"{path}: its array")
    if values.ndim and not len(values):
        raise BadInput(f"{path}: has no frames: its array is {values.shape}")
    if values.dtype.kind not in "fiu" or values.size == 0:
        raise BadInput(f"{path}: must be numbers (frames, joints, 3), not {values.dtype} {values.shape}")
    return _motion_of(values, path, rate, unit, up)


def read_blocks(
    path: str | Path, rate: float | None = None, unit: str | float | None = None, up: str | None = None
) -> Blocks:
    """As `read`, in pieces. Raises BadInput, also for feature vectors, whose root is a sum over all frames."""
    path = Path(path)
    with reading(path, "an NPY"), path.open("rb") as file:
        header = header_of(file.read(MAX_HEADER_BYTES))
    shape, dtype = header.shape, header.dtype
    if shape and not shape[0]:
        raise BadInput(f"{path}: has no frames: its array is {shape}")
    if len(shape) != 3 or shape[2] != 3 or dtype.kind not in "fiu" or header.is_fortran:
        raise BadInput(f"{path}: only numbers (frames, joints, 3) in C order are read in pieces")
    size = header.size + math.prod(shape) * dtype.itemsize
    if path.stat().st_size != size:
        raise BadInput(f"{path}: its array is cut off or damaged")
    row_bytes, each = shape[1] * 3 * dtype.itemsize, block_frames(shape[1])

    def rows(start: int, stop: int) -> NDArray[Any]:
        with path.open("rb") as file:
            file.seek(header.size + start * row_bytes)
            return np.frombuffer(file.read((stop - start) * row_bytes), dtype).reshape(-1, shape[1], 3)

    head = _motion_of(rows(0, min(each, shape[0])), path, rate, unit, up)

    def between(start: int, stop: int) -> Motion:
        positions = rows(start, stop) * float(head.source["unit_m"])
        positions[np.isnan(positions).any(axis=2)] = np.nan
        return replace(head, positions=positions)

    return of_ranges(head[:0], shape[0], between, each)


def _motion_of(
    values: NDArray[Any], path: Path, rate: float | None, unit: str | float | None, up: str | None
) -> Motion:
    """The motion of an array of joints or feature vectors. Raises BadInput."""
    source: dict[str, Any] = {"format": "npy"}
    if values.ndim == 2 and values.shape[1] == HUMANML_FEATURES:
        if not np.abs(values).max(initial=0.0) < MOST_FEATURE:
            raise BadInput(f"{path}: HumanML3D feature vectors that are not numbers below {MOST_FEATURE:g}")
        positions = joints_of_features(values.astype(np.float64))
        require_rigid(path, positions)
        source["notes"] = ["joints are decoded from HumanML3D feature vectors"]
    elif values.ndim == 3 and values.shape[2] == 3:
        positions = values.astype(np.float64)
    else:
        what = OTHER_FEATURES.get(values.shape[-1]) if values.ndim == 2 else None
        hint = f": these look like {what}" if what else reshape_hint(values.shape, "array")
        raise BadInput(f"{path}: must be joints (frames, joints, 3), not {values.shape}{hint}")
    if rate is None and positions.shape[1] == HUMANML_JOINTS:
        rate, source["rate_guessed"] = HUMANML_RATE, True
    if rate is None:
        raise BadInput(f"{path}: an NPY has no frame rate; give it with rate= (--rate)")
    positions[np.isnan(positions).any(axis=2)] = np.nan
    units, unit_m = unit_option(guess_unit(positions) if unit is None else unit)
    source |= {"unit_guessed": True} if unit is None else {}
    positions *= unit_m
    source |= {"units": units, "unit_m": unit_m}
    tree = smpl.tree_of(positions)
    if up is None:
        is_unknown = tree is None and "rate_guessed" in source
        up, source["up_guessed"] = "y" if is_unknown else guess_up(positions), True
    if tree is None:
        return Motion(positions, rate, (), up, source=source)
    return Motion(positions, rate, tree.names, up, smpl.measured(tree, positions), source=source)


def joints_of_features(features: Floats) -> Floats:
    """Positions (frames, 22, 3), metres, y up, of HumanML3D's feature vectors (frames, 263).

    Its rotations about y are q⁻¹ with q = (cos a, 0, sin a, 0), where a sums up the first feature.
    """
    angle = np.concatenate([[0.0], np.cumsum(features[:-1, 0])])
    velocity = np.zeros((len(features), 3))
    velocity[1:, [0, 2]] = features[:-1, 1:3]
    root = np.cumsum(turned_back(velocity, angle), axis=0)
    root[:, 1] = features[:, 3]
    others = turned_back(features[:, 4 : 4 + 63].reshape(-1, HUMANML_JOINTS - 1, 3), angle[:, None])
    others += root[:, None] * [1.0, 0.0, 1.0]
    return np.concatenate([root[:, None], others], axis=1)


def turned_back(vectors: Floats, half_angle: Floats) -> Floats:
    """Vectors (…, 3) turned about y by −2 · half_angle (…)."""
    cos, sin = np.cos(2 * half_angle), np.sin(2 * half_angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1)


def require_rigid(path: Path, positions: Floats) -> None:
    """Raises BadInput if decoded joints have no bones of constant length, as with normalised feature vectors."""
    tree = smpl.trees()[HUMANML_JOINTS]
    bones = np.linalg.norm(positions[:, 1:] - positions[:, list(tree.parents[1:])], axis=-1)
    mean = bones.mean(axis=0)
    if not (np.isfinite(bones).all() and (mean > 0).all() and (bones.std(axis=0) < MAX_BONE_CHANGE * mean).all()):
        raise BadInput(
            f"{path}: HumanML3D feature vectors whose bones change length: normalised? "
            "Multiply by its Std.npy and add its Mean.npy first"
        )


def write(path: str | Path, motion: Motion) -> None:
    """Write positions (frames, points, 3) as float32, metres; gaps are NaN."""
    replace_whole(path, bytes_of(motion.positions.astype(np.float32)))
