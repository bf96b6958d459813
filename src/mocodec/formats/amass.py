"""Body model parameters in an .npz, as AMASS stores them: rotation vectors of the joints, and the root's translation.

    poses (frames, 3 · joints)   or its parts: root_orient, pose_body, pose_jaw, pose_eye, pose_hand   ─► rotations
    trans (frames, 3)                                                                                 ─► root
    mocap_framerate | mocap_frame_rate | fps                                                          ─► rate
    betas, gender, dmpls and whatever else there is                                   ─► extras["amass"], as it is

72 numbers a frame are SMPL's 24 joints, 156 SMPL+H's 52, 165 SMPL-X's 55, and 66 the 22 that all share (`smpl`). The
writer gives back the same arrays in the same order, with their types. Rotation vectors get back the length that they
had: v and the vector that turns the other way round are the same rotation (`geometry.rotation_vectors`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..geometry import kinematics, rotation_vectors
from ..motion import Motion, Signal
from ..typing import Floats, Integers
from . import smpl
from .conventions import unit_of, unit_option
from .numpy_files import GIVE_RATE, Archive

POSES = ("poses", "smpl_poses", "fullpose")
TRANS = ("trans", "smpl_trans", "transl")
RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "rate", "frame_rate", "framerate")
SCALING = "smpl_scaling"
"""AIST++: translations are in units of the body, whose scale this is."""
AIST_RATE = 60.0
PARTS: dict[str, dict[str, tuple[int, int]]] = {
    "body": {},
    "smpl": {"pose_body": (3, 72), "body_pose": (3, 72)},
    "smplh": {"pose_hand": (66, 156), "left_hand_pose": (66, 111), "right_hand_pose": (111, 156)},
    "smplx": {
        "pose_jaw": (66, 69), "jaw_pose": (66, 69), "pose_eye": (69, 75), "leye_pose": (69, 72), "reye_pose": (72, 75),
        "pose_hand": (75, 165), "left_hand_pose": (75, 120), "right_hand_pose": (120, 165),
    },
}  # fmt: skip
"""The columns of `poses` that each array of a part holds, beside those of SHARED_PARTS."""
SHARED_PARTS = {"root_orient": (0, 3), "global_orient": (0, 3), "pose_body": (3, 66), "body_pose": (3, 66)}
NOT_PER_FRAME = frozenset({"betas", "markers_latent", "latent_labels", "v_template"})
"""Arrays whose first axis is never time, even if it is as long as the motion."""
MAX_RADIANS = 100 * np.pi
"""Rotation vectors beyond fifty turns are no radians."""
STORABLE_KINDS = "biufcSU"
NUMBER_TYPE = re.compile(r"[<>|=](f[248]|[iu][1248])")
MAX_NUMBERS = 200
"""Numbers a frame of any array that the motion itself holds."""


def is_body_motion(names: Mapping[str, object]) -> bool:
    """Whether an archive with these arrays has rotations of a body model."""
    return any(name in names for name in POSES) or _roots(names) is not None


def _roots(names: Mapping[str, object]) -> tuple[str, str] | None:
    """The arrays of the root's and the body's rotations, where these are apart."""
    for pair in (("root_orient", "pose_body"), ("global_orient", "body_pose")):
        if all(name in names for name in pair):
            return pair
    return None


def parts_of(model: str) -> dict[str, tuple[int, int]]:
    """The columns of each array that holds a part of the rotations of a model."""
    width = 3 * next(n for n, tree in smpl.trees().items() if tree.model == model)
    return {**SHARED_PARTS, **PARTS[model], **dict.fromkeys(POSES, (0, width))}


def read(
    arrays: Archive, rate: float | None, unit: str | float | None, up: str | None, body: str | None = None
) -> Motion:
    """The motion of an archive that `is_body_motion`. body: a model file, for its bones. Raises BadInput."""
    poses, coded = _poses(arrays)
    frames = len(poses)
    tree = smpl.trees()[poses.shape[1] // 3]
    units, unit_m = unit_option("m" if unit is None else unit)
    source: dict[str, Any] = {"format": "amass", "units": units, "unit_m": unit_m, "model": tree.model}
    trans_key, rate_key = arrays.first(TRANS), arrays.first(RATES)
    root = np.zeros((frames, 3))
    if trans_key is None:
        source["notes"] = ["has no translation (trans): the root stays at the origin"]
    else:
        root = _numbers(arrays, trans_key, frames, 3) * unit_m * _scaling(arrays)
    if rate is None and rate_key is not None:
        value = arrays.single(rate_key, GIVE_RATE)
        rate = float(np.nan if np.iscomplexobj(value) else value)
    elif rate is None and "smpl_poses" in arrays.names:
        rate, source["rate_guessed"] = AIST_RATE, True
    elif rate is None:
        raise BadInput(f"{arrays.path}: has no frame rate{GIVE_RATE} or as {', '.join(RATES)}")
    if not 0 < rate < np.inf:
        raise BadInput(f"{arrays.path}: the frame rate must be positive, not {rate}")
    if up is None and "up" in arrays.names:
        up = arrays.word("up")
    vectors = poses.reshape(frames, -1, 3)
    rest, objects = {}, list[str]()
    for name in arrays.names:
        if name not in coded and name not in (trans_key, rate_key, "up"):
            rest[name] = _kept(arrays, name, frames, rate)
            objects += [name] if isinstance(rest[name], bytes) else []
    if objects:
        words = f"arrays of Python objects are never opened, their bytes are kept: {', '.join(objects)}"
        source["notes"] = [*source.get("notes", []), words]
    layout = [_entry(arrays, name) if name not in rest else name for name in arrays.names if name != "up"]
    source["layout"] = layout
    extras: dict[str, Any] = {"amass": {"arrays": rest}}
    if (codes := rotation_vectors.branches(vectors)) is not None:
        columns = np.flatnonzero(codes.any(axis=0))
        labels = tuple(tree.names[column] for column in columns)
        extras["amass"]["branches"] = Signal(codes[:, columns], rate, labels)
    betas = rest.get("betas")
    betas = betas.values if isinstance(betas, Signal) else betas
    shape = betas if isinstance(betas, np.ndarray) and betas.dtype.kind == "f" and betas.size else None
    skeleton = tree.stock if body is None else smpl.body_of(body, tree, shape)
    rotations = rotation_vectors.to_quaternions(vectors)
    positions = kinematics.forward(skeleton, rotations, root)
    usual_up = "y" if "smpl_poses" in arrays.names else "z"
    return Motion(positions, rate, tree.names, up or usual_up, skeleton, rotations, source, extras)


def _poses(arrays: Archive) -> tuple[Floats, list[str]]:
    """Rotation vectors (frames, 3 · joints) in the order of the model, and the names of the arrays that they are in."""
    key, roots = arrays.first(POSES), _roots(arrays.names)
    if key is None:
        assert roots is not None
        return _joined(arrays, roots)
    poses = _numbers(arrays, key)
    if poses.shape[1] % 3 or poses.shape[1] // 3 not in smpl.trees():
        known = ", ".join(f"{3 * n} ({tree.model})" for n, tree in smpl.trees().items())
        raise BadInput(f"{arrays.path}: {key!r} has {poses.shape[1]} numbers a frame; known are {known}")
    coded = [key]
    for name, (start, stop) in parts_of(smpl.trees()[poses.shape[1] // 3].model).items():
        if name in arrays.names and name != key and _is_number(arrays, name):
            part = arrays.load(name)
            columns = poses[:, start:stop]
            if part.size == columns.size and np.array_equal(part.reshape(columns.shape).astype(np.float64), columns):
                coded.append(name)
    return poses, coded


def _joined(arrays: Archive, roots: tuple[str, str]) -> tuple[Floats, list[str]]:
    """The same from the arrays of the parts; parts that are missing are at rest."""
    body = _numbers(arrays, roots[1])
    frames = len(body)
    hands = [name for name in ("pose_hand", "left_hand_pose", "right_hand_pose") if name in arrays.names]
    faces = [name for name in ("pose_jaw", "jaw_pose", "pose_eye", "leye_pose", "reye_pose") if name in arrays.names]
    joints = 24 if body.shape[1] == 69 else 55 if faces else 52 if hands else 22
    parts, poses, coded = parts_of(smpl.trees()[joints].model), np.zeros((frames, 3 * joints)), list[str]()
    for name in (*roots, *faces, *hands):
        start, stop = parts.get(name, (0, 0))
        values = _numbers(arrays, name)
        if values.shape == (frames, stop - start):
            poses[:, start:stop] = values
            coded.append(name)
        elif name in roots:
            raise BadInput(f"{arrays.path}: {name!r} has the shape {values.shape}, not {(frames, stop - start)}")
    return poses, coded


def _is_number(arrays: Archive, name: str) -> bool:
    return arrays.header(name).dtype.kind in "fiu"


def _numbers(arrays: Archive, name: str, frames: int | None = None, width: int | None = None) -> Floats:
    """An array as (frames, …) of finite numbers. Raises BadInput for others."""
    values = arrays.load(name)
    if values.ndim < 2 or values.dtype.kind not in "fiu" or values.size == 0 or frames not in (None, len(values)):
        raise BadInput(f"{arrays.path}: {name!r} must be numbers for each frame, not {values.dtype} {values.shape}")
    flat = values.reshape(len(values), -1).astype(np.float64)
    if width not in (None, flat.shape[1]):
        raise BadInput(f"{arrays.path}: {name!r} must have {width} numbers a frame, not {flat.shape[1]}")
    invalid = ~np.isfinite(flat).all(axis=1)
    if invalid.any():
        raise BadInput(f"{arrays.path}: {name!r} is not finite at frame {int(invalid.argmax())}")
    if name not in TRANS and np.abs(flat).max() > MAX_RADIANS:
        raise BadInput(f"{arrays.path}: {name!r} reaches {np.abs(flat).max():.4g}; rotation vectors are in radians")
    return flat


def _scaling(arrays: Archive) -> float:
    """Metres in a unit of the translations."""
    if SCALING not in arrays.names:
        return 1.0
    scaling = float(arrays.single(SCALING))
    if not 0 < scaling < np.inf:
        raise BadInput(f"{arrays.path}: {SCALING!r} must be positive, not {scaling}")
    return 1 / scaling


def _kept(arrays: Archive, name: str, frames: int, rate: float) -> NDArray[Any] | Signal | bytes:
    """An array as extras store it: a Signal if it has a row for each frame; its own bytes if it is an object."""
    dtype = arrays.header(name).dtype
    if dtype.kind not in STORABLE_KINDS or dtype.itemsize == 0 or dtype.str[1:] in ("f16", "c32"):
        return arrays.raw(name)
    values = arrays.load(name)
    per_frame = values.ndim >= 2 and len(values) == frames > 1 and name not in NOT_PER_FRAME
    return Signal(values, rate) if per_frame or (name == "betas" and values.shape[:-1] == (frames,)) else values


def _entry(arrays: Archive, name: str) -> list[Any]:
    """Name, type and shape of an array that the motion itself holds; without the frames, for those that have them."""
    header = arrays.header(name)
    return [name, header.dtype.str, list(header.shape if name in RATES else header.shape[1:])]


def can_write(motion: Motion) -> bool:
    """Whether a motion has what `arrays_of` needs: the rotations of a body model's joints."""
    tree = smpl.trees().get(motion.points)
    skeleton = motion.skeleton
    fits = (
        tree is not None and skeleton is not None and (skeleton.names, skeleton.parents) == (tree.names, tree.parents)
    )
    return fits and motion.rotations is not None and not motion.gaps.any()


def arrays_of(motion: Motion) -> dict[str, NDArray[Any] | bytes]:
    """The arrays that a motion was read from, in their order; AMASS's, for one from another format.

    Raises BadInput unless the motion `can_write`.
    """
    if not can_write(motion):
        raise BadInput("body model parameters need rotations of the joints of SMPL, SMPL+H or SMPL-X, without gaps")
    assert motion.skeleton is not None
    model = smpl.trees()[motion.points].model
    kept = _mapping(motion.extras.get("amass"))
    rest = _mapping(kept.get("arrays"))
    vectors = _vectors(motion, kept.get("branches"))
    scaling = rest.get(SCALING)
    scale = float(np.asarray(scaling).reshape(-1)[0]) if isinstance(scaling, np.ndarray) and scaling.size else 1.0
    root = motion.positions[:, 0] - motion.skeleton.offsets[0]
    root = root * scale / (unit_of(motion.source) if "unit_m" in motion.source else 1.0)
    result: dict[str, NDArray[Any] | bytes] = {}
    parts = parts_of(model)
    for entry in _layout(motion, model):
        if isinstance(entry, str):
            if (value := rest.get(entry)) is not None:
                result[entry] = per_frame(value, motion) if isinstance(value, Signal) else value
            continue
        name, dtype, shape = entry
        if name in parts:
            start, stop = parts[name]
            shape = shape if math.prod(shape) == stop - start else [stop - start]
            result[name] = vectors[:, start:stop].reshape(len(motion), *shape).astype(dtype)
        elif name in TRANS:
            result[name] = root.astype(dtype)
        elif name in RATES:
            result[name] = np.full(shape, motion.rate).astype(dtype)
    usual_up = "y" if "smpl_poses" in result else "z"
    return result if motion.up == usual_up else result | {"up": np.array(motion.up)}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _vectors(motion: Motion, branches: Any) -> Floats:
    """Rotation vectors (frames, 3 · joints) of the motion, on the branches of the original."""
    assert motion.rotations is not None
    codes: Integers | None = None
    if isinstance(branches, Signal) and branches.values.ndim == 2:
        codes = np.zeros(motion.rotations.shape[:2], np.int64)
        codes[:, [motion.names.index(name) for name in branches.labels]] = per_frame(branches, motion)
    return rotation_vectors.with_branches(motion.rotations, codes).reshape(len(motion), -1)


def per_frame(signal: Signal, motion: Motion) -> NDArray[Any]:
    """The samples of a signal at the frames of a motion; the nearest ones, if their rate has become another."""
    if len(signal.values) == len(motion) or not len(signal.values):
        return signal.values
    rows = np.rint(np.arange(len(motion)) * signal.rate / motion.rate).astype(np.int64)
    return signal.values[np.minimum(rows, len(signal.values) - 1)]


def _layout(motion: Motion, model: str) -> list[Any]:
    """The arrays to write, in order: names of kept ones; name, type and shape of those that the motion holds."""
    layout = motion.source.get("layout")
    is_same_body = motion.source.get("format") == "amass" and motion.source.get("model") == model
    if is_same_body and isinstance(layout, list | tuple) and all(map(_is_entry, layout)):
        return list(layout)
    rate = "mocap_frame_rate" if model == "smplx" else "mocap_framerate"
    return [["trans", "<f8", [3]], [rate, "<f8", []], ["poses", "<f8", [3 * motion.points]]]


def _is_entry(entry: Any) -> bool:
    """Whether an entry of a layout is one that `read` makes: sources come from files."""
    if isinstance(entry, str):
        return True
    if not (isinstance(entry, list | tuple) and len(entry) == 3 and all(isinstance(text, str) for text in entry[:2])):
        return False
    shape = entry[2]
    is_shape = isinstance(shape, list | tuple) and all(type(n) is int and 0 <= n <= MAX_NUMBERS for n in shape)
    return (
        is_shape and len(shape) <= 4 and math.prod(shape) <= MAX_NUMBERS and NUMBER_TYPE.fullmatch(entry[1]) is not None
    )
