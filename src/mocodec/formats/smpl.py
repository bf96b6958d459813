"""The joint trees of the SMPL family: names, parents, and rest offsets of a stock body or of a user's own model file.

The parameters of a body model (AMASS) are rotations of these joints; where the joints are depends on a body. The models
are licensed, so none is here: the stock body is an average adult whose segments are fractions of the stature by Drillis
and Contini (1966), hands by eye. Its axes are those of the models at rest: y up, x to the left, facing z.
"""

from __future__ import annotations

import zipfile
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..motion import Skeleton
from ..typing import Floats
from . import PICKLES
from .numpy_files import Archive, reading

BODY = (
    *("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle"),
    *("spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder"),
    *("right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
)
"""The 22 joints that all models share, in their order."""
BODY_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
FACE = ("jaw", "left_eye_smplhf", "right_eye_smplhf")
FINGERS = tuple(f"{finger}{i}" for finger in ("index", "middle", "pinky", "ring", "thumb") for i in (1, 2, 3))
LEFT_WRIST, RIGHT_WRIST, HEAD = 20, 21, 15

LEFT_OFFSETS_CM: dict[str, tuple[float, float, float]] = {
    "pelvis": (0, 0, 0), "spine1": (0, 11, -2), "spine2": (0, 13, 0), "spine3": (0, 6, 1), "neck": (0, 21, -3),
    "head": (0, 9, 3), "left_hip": (8.5, -7, 0), "left_knee": (2, -40.5, 0), "left_ankle": (-1, -41, -3),
    "left_foot": (1.5, -5.5, 13), "left_collar": (7.5, 12, -1), "left_shoulder": (11, 4, -1),
    "left_elbow": (28.5, 0, 0), "left_wrist": (25, 0, 0), "left_hand": (8.5, -1, 0), "jaw": (0, -0.5, 3),
    "left_eye_smplhf": (3.2, 6.5, 8),
    "left_index1": (10, 0, 2.5), "left_index2": (3.8, 0, 0), "left_index3": (2.2, 0, 0),
    "left_middle1": (10, 0, 0.3), "left_middle2": (4.3, 0, 0), "left_middle3": (2.6, 0, 0),
    "left_pinky1": (8.2, -0.5, -4.2), "left_pinky2": (2.8, 0, 0), "left_pinky3": (1.8, 0, 0),
    "left_ring1": (9.2, -0.2, -2), "left_ring2": (4, 0, 0), "left_ring3": (2.4, 0, 0),
    "left_thumb1": (2.5, -1, 3), "left_thumb2": (3, -0.5, 2), "left_thumb3": (2.2, 0, 1.3),
}  # fmt: skip
"""From the parent, centimetres; joints of the right side are mirrored."""


class BodyTree(NamedTuple):
    """The joints of a model. model: its name: "body" has the shared joints only."""

    model: str
    names: tuple[str, ...]
    parents: tuple[int, ...]

    @property
    def stock(self) -> Skeleton:
        """The tree with the stock body's offsets."""
        return Skeleton(self.names, self.parents, stock_offsets(self.names))


@cache
def trees() -> dict[int, BodyTree]:
    """The models by their number of joints."""
    hands = tuple(f"{side}_{finger}" for side in ("left", "right") for finger in FINGERS)
    with_face = len(BODY) + len(FACE)
    found = (
        BodyTree("body", BODY, BODY_PARENTS),
        BodyTree("smpl", (*BODY, "left_hand", "right_hand"), (*BODY_PARENTS, LEFT_WRIST, RIGHT_WRIST)),
        BodyTree("smplh", (*BODY, *hands), (*BODY_PARENTS, *_hand_parents(len(BODY)))),
        BodyTree("smplx", (*BODY, *FACE, *hands), (*BODY_PARENTS, *[HEAD] * 3, *_hand_parents(with_face))),
    )
    return {len(tree.names): tree for tree in found}


def _hand_parents(first: int) -> list[int]:
    """Parents of the finger joints of both hands, whose first joint has this number."""
    wrists = [LEFT_WRIST] * len(FINGERS) + [RIGHT_WRIST] * len(FINGERS)
    return [wrist if i % 3 == 0 else first + i - 1 for i, wrist in enumerate(wrists)]


def stock_offsets(names: tuple[str, ...]) -> Floats:
    """Offsets (joints, 3) of the stock body, metres; multiples of 10 µm, which a .mocz stores exactly."""
    mirrored = {name.replace("left", "right"): (-x, y, z) for name, (x, y, z) in LEFT_OFFSETS_CM.items()}
    offsets = mirrored | LEFT_OFFSETS_CM
    return np.round(np.array([offsets[name] for name in names], np.float64) / 100, 5)


def body_of(path: str | Path, tree: BodyTree, betas: NDArray[Any] | None) -> Skeleton:
    """The tree with the rest offsets of a user's model file (.npz) for these shape parameters.

    Joints are J (v + S β) with the file's J_regressor (joints, vertices), v_template (vertices, 3) and shapedirs
    (vertices, 3, shapes); the offset of the root is its joint, as the models place it. betas: (shapes,), or (frames,
    shapes), whose mean is taken; None for the template. Raises BadInput for a file of another model.
    """
    path = Path(path)
    if path.suffix.lower() in PICKLES:
        raise BadInput(f"{path}: a model file must be an .npz; a pickle runs code when it is opened")
    if not path.exists():
        raise BadInput(f"{path}: no such file (smplx=)")
    with reading(path), zipfile.ZipFile(path) as archive:
        arrays = Archive(archive, path)
        missing = [name for name in ("J_regressor", "v_template", "kintree_table") if name not in arrays.names]
        if missing:
            raise BadInput(f"{path}: not a model of the SMPL family: it has no array {missing[0]!r}")
        parents = arrays.load("kintree_table")[0].astype(np.int64)
        n = len(tree.names)
        same_size = len(parents) == n or (tree.model == "body" and len(parents) > n)
        if not same_size or parents[1:n].tolist() != list(tree.parents[1:]):
            raise BadInput(f"{path}: a model of {len(parents)} joints, while the motion has {n} of {tree.model}")
        vertices = arrays.load("v_template").astype(np.float64)
        if betas is not None and "shapedirs" in arrays.names:
            shape = betas.reshape(-1, betas.shape[-1]).mean(axis=0)
            directions = arrays.load("shapedirs")[:, :, : len(shape)].astype(np.float64)
            vertices = vertices + directions @ shape[: directions.shape[2]]
        joints = (arrays.load("J_regressor")[:n] @ vertices).astype(np.float64)
    if joints.shape != (n, 3) or not np.isfinite(joints).all():
        raise BadInput(f"{path}: its J_regressor does not give {n} joints")
    offsets = joints - joints[[0, *tree.parents[1:]]]
    offsets[0] = joints[0]
    return Skeleton(tree.names, tree.parents, offsets)


def tree_of(positions: Floats) -> BodyTree | None:
    """The tree of the shared joints and their hands if the positions (frames, joints, 3) have rigid bones along it.

    Positions of these data sets have no names; the lengths of their bones are the evidence. None without it.
    """
    tree = trees().get(positions.shape[1])
    if tree is None or not len(positions) or not np.isfinite(positions).all():
        return None
    sample = positions[:: max(1, len(positions) // 500)]
    bones = np.linalg.norm(sample[:, 1:] - sample[:, list(tree.parents[1:])], axis=-1)
    length = bones.mean(axis=0)
    left = [j for j, name in enumerate(tree.names) if name.startswith("left")]
    right = [tree.names.index(tree.names[j].replace("left", "right")) for j in left]
    ratios = length[np.array(left) - 1] / np.maximum(length[np.array(right) - 1], 1e-12)
    is_rigid = (bones.std(axis=0) <= 0.03 * length + 1e-4 * length.max()).all() and (length > 0).all()
    is_symmetric = bool(((ratios > 0.7) & (ratios < 1.4)).all())
    return tree if is_rigid and is_symmetric else None


def measured(tree: BodyTree, positions: Floats) -> Skeleton:
    """The tree with the stock body's directions and the mean bone lengths of the positions (frames, joints, 3)."""
    offsets = stock_offsets(tree.names)
    bones = np.linalg.norm(positions[:, 1:] - positions[:, list(tree.parents[1:])], axis=-1).mean(axis=0)
    offsets[1:] *= (bones / np.linalg.norm(offsets[1:], axis=1))[:, None]
    return Skeleton(tree.names, tree.parents, offsets)
