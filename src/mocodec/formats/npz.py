"""NPZ: NumPy arrays by name.

    positions                     mocodec's own: (frames, points, 3) in metres, with rate | fps, names, up
    joints, jtr, Jtr, keypoints3d, joint_positions    the same under the names of machine-learning data sets
    markers, labels, frame_rate   marker files of AMASS and MoSh
    points, counts                point clouds: the points of all frames, (all, 3), and the count of each frame; colours
    poses, trans, betas           AMASS's body model parameters: `amass.py`

Arrays are read without pickle, and each is checked against the size of the archive first (`numpy_files.py`).
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..motion import Limits, Motion, Skeleton, reshape_hint
from ..pointcloud import PointClouds
from ..typing import Floats
from . import amass, smpl
from .blocks import Blocks, block_frames
from .conventions import guess_unit, guess_up, unit_option
from .npz_salvage import archive_of
from .numpy_files import GIVE_RATE, Archive, Rows, reading, save

HOLDS = frozenset({"skeleton", "joint rotations"})
"""What an NPZ stores beside the positions."""
LAYOUTS = ("amass", "mocodec")


def holds(motion: Motion) -> frozenset[str]:
    """What the NPZ of this motion stores: for body model parameters, what was beside them."""
    return HOLDS | {"amass"} if _layout_of(motion) == "amass" else HOLDS


def _layout_of(motion: Motion) -> str:
    return "amass" if motion.source.get("format") == "amass" and amass.can_write(motion) else "mocodec"


POSITIONS = (
    *("positions", "joints", "jtr", "Jtr", "keypoints3d", "joint_positions", "joints3d", "joints_3d", "keypoints_3d"),
    "markers",
)
RATES = ("rate", "fps", "frame_rate", "framerate", "mocap_framerate", "mocap_frame_rate")
NAMES = ("names", "labels", "joint_names", "marker_names")


def read(
    path: str | Path,
    rate: float | None = None,
    unit: str | float | None = None,
    up: str | None = None,
    smplx: str | None = None,
    salvage: bool = False,
) -> Motion | PointClouds:
    """Positions of an NPZ as a motion, its body model parameters as a skeletal motion, or points as point clouds.

    rate: hertz, by default the file's. unit: of the positions, by default the file's, else metres, or millimetres for
    frames that extend over more than 200 (a `markers` array: over more than 100). up: the vertical axis, by default the
    file's, else guessed. smplx: a model file (.npz) of the SMPL family, for the bones of body model parameters; by
    default a stock body's. A sample with NaN, or a sample of `markers` at exactly (0, 0, 0), is a gap. salvage:
    read the arrays and the complete frames of an archive that is cut off. Raises BadInput.
    """
    notes: list[str] = []
    with reading(path), archive_of(path, salvage, notes) as archive:
        recording = _recording(Archive(archive, path), rate, unit, up, smplx)
    if notes:
        source = {**recording.source, "notes": [*recording.source.get("notes", ()), *notes]}
        recording = replace(recording, source=source)
    return recording


def read_blocks(
    path: str | Path,
    rate: float | None = None,
    unit: str | float | None = None,
    up: str | None = None,
) -> Blocks:
    """Positions of an NPZ as a motion, as `read`, in pieces. Raises BadInput, also for archives of other data."""
    with reading(path), zipfile.ZipFile(path) as archive:
        arrays = Archive(archive, path)
        key = arrays.first(POSITIONS)
        is_body = amass.is_body_motion(arrays.names) and key in (None, "markers")
        if key is None or is_body or {"points", "counts"} <= arrays.names.keys():
            raise BadInput(f"{path}: only positions are read in pieces")
        shape = arrays.header(key).shape
        if len(shape) != 3:
            raise BadInput(
                f"{path}: {key!r} must be numbers (frames, points, 3), not {shape}{reshape_hint(shape, key)}"
            )
        by_frame = (key, "rotations") if "rotations" in arrays.names else (key,)
        each = block_frames(shape[1])
        head, unit_m = _motion_and_unit(Rows(archive, path, by_frame, each), rate, unit, up)

    def parts() -> Iterator[Motion]:
        with reading(path), zipfile.ZipFile(path) as archive:
            rows = Rows(archive, path, by_frame, each)
            for start in range(0, shape[0], each):
                block = _motion(rows, head.rate, unit_m, head.up)
                if len(block) != min(each, shape[0] - start):
                    raise BadInput(f"{path}: array {key!r} is cut off or damaged")
                yield replace(block, names=head.names, skeleton=head.skeleton, source=head.source)

    return Blocks(head[:0], shape[0], parts)


def _recording(
    arrays: Archive, rate: float | None, unit: str | float | None, up: str | None, smplx: str | None
) -> Motion | PointClouds:
    """What the arrays hold, by their names."""
    if {"points", "counts"} <= arrays.names.keys():
        return _clouds(arrays, rate, unit, up)
    if amass.is_body_motion(arrays.names) and arrays.first(POSITIONS) in (None, "markers"):
        return amass.read(arrays, rate, unit, up, smplx)
    if smplx is not None:
        raise BadInput(f"{arrays.path}: smplx= is for body model parameters (poses, trans), which this file lacks")
    return _motion(arrays, rate, unit, up)


def _motion(arrays: Archive, rate: float | None, unit: str | float | None, up: str | None) -> Motion:
    return _motion_and_unit(arrays, rate, unit, up)[0]


def _motion_and_unit(
    arrays: Archive, rate: float | None, unit: str | float | None, up: str | None
) -> tuple[Motion, float]:
    """The motion, and the metres of one unit of its array, which the source of another file does not say."""
    key, positions = _positions(arrays)
    rate = _rate(arrays) if rate is None else rate
    notes: list[str] = []
    names = _names(arrays, positions.shape[1], notes)
    gaps = np.isnan(positions).any(axis=2)
    if key == "markers":
        gaps |= (positions == 0).all(axis=2)
    positions[gaps] = np.nan
    units, unit_m = _unit(arrays, key, positions, unit)
    positions *= unit_m
    source: dict[str, Any] = {"format": "npz", "units": units, "unit_m": unit_m}
    source |= {"unit_guessed": True} if unit is None and "unit" not in arrays.names else {}
    if amass.is_body_motion(arrays.names):
        notes.append(f"positions are those of {key!r}; body model parameters beside them are left out")
    if up is None and "up" in arrays.names:
        up = arrays.word("up")
    if up is None:
        up = guess_up(positions)
        source["up_guessed"] = True
    skeleton, rotations = _skeleton(arrays, names, positions.shape[1])
    if skeleton is None and not names and (tree := smpl.tree_of(positions)) is not None:
        names, skeleton = tree.names, smpl.measured(tree, positions)
    if "source" in arrays.names:
        source = _stored_source(arrays)
    elif notes:
        source["notes"] = notes
    return Motion(positions, rate, names, up, skeleton, rotations, source), unit_m


def _positions(arrays: Archive) -> tuple[str, Floats]:
    """The name of the array of positions, and its numbers (frames, points, 3). Raises BadInput without one."""
    path, key = arrays.path, arrays.first(POSITIONS)
    if key is None:
        if "betas" in arrays.names:
            raise BadInput(f"{path}: has the shape of a body (betas) and no motion: no poses, no positions")
        present = ", ".join(arrays.names) or "none"
        raise BadInput(f"{path}: has none of the arrays {', '.join(POSITIONS)}; it has {present}")
    positions = arrays.load(key)
    if positions.ndim != 3 or positions.shape[2] != 3 or positions.dtype.kind not in "fiu":
        what = f"{positions.dtype} {positions.shape}{reshape_hint(positions.shape, key)}"
        raise BadInput(f"{path}: {key!r} must be numbers (frames, points, 3), not {what}")
    return key, positions.astype(np.float64)


def _rate(arrays: Archive) -> float:
    """The rate that the arrays declare, hertz. Raises BadInput without one."""
    key = arrays.first(RATES)
    if key is None:
        raise BadInput(f"{arrays.path}: has no frame rate{GIVE_RATE} or as {', '.join(RATES)}")
    return float(arrays.single(key, GIVE_RATE))


def _names(arrays: Archive, points: int, notes: list[str]) -> tuple[str, ...]:
    """The names of the points; none, with a note, where the array is no list of names."""
    key = arrays.first(NAMES)
    if key is None:
        return ()
    if arrays.header(key).dtype.hasobject:
        notes.append(f"{key!r} holds Python objects, which are not opened: it is left out")
        return ()
    texts = arrays.load(key).reshape(-1)
    if texts.dtype.kind not in "US" or len(texts) != points:
        notes.append(f"{key!r} is no list of {points} names: it is left out")
        return ()
    return tuple(t.decode("utf-8", "replace") if isinstance(t, bytes) else str(t) for t in texts.tolist())


def _skeleton(arrays: Archive, names: tuple[str, ...], points: int) -> tuple[Skeleton | None, Floats | None]:
    """The skeleton and the rotations (frames, joints, 4) that mocodec writes; None for each that is missing."""
    if not {"parents", "offsets"} <= arrays.names.keys():
        return None, None
    parents = arrays.load("parents").reshape(-1).astype(int).tolist()
    joint_names = names or tuple(f"P{i + 1}" for i in range(points))
    offsets = arrays.load("offsets").astype(np.float64)
    rotations = arrays.load("rotations").astype(np.float64) if "rotations" in arrays.names else None
    return Skeleton(joint_names, tuple(parents), offsets, _limits(arrays)), rotations


def _stored_source(arrays: Archive) -> dict[str, Any]:
    """The source that mocodec writes, checked. Raises BadInput."""
    source = json.loads(str(arrays.single("source")))
    if not isinstance(source, dict):
        raise BadInput(f"{arrays.path}: its 'source' is not a JSON object")
    return _checked_source(source)


def _checked_source(source: dict[str, Any]) -> dict[str, Any]:
    """The source without entries of types that mocodec never writes; a note names them."""
    types: dict[str, Any] = {"format": str, "units": str, "unit_m": int | float, "first_frame": int}
    types |= {"time_of_frame_1": int | float, "notes": list, "labels": dict}
    invalid = [key for key, type_ in types.items() if key in source and not isinstance(source[key], type_)]
    result = {key: value for key, value in source.items() if key not in invalid}
    if invalid:
        notes = result.get("notes", [])
        result["notes"] = [*notes, f"entries of its source that are not usable are left out: {', '.join(invalid)}"]
    return result


def _limits(arrays: Archive) -> Limits | None:
    if not {"limit_orders", "limit_axes", "limit_ranges"} <= arrays.names.keys():
        return None
    orders = tuple(str(order) for order in arrays.load("limit_orders").reshape(-1).tolist())
    return Limits(orders, *(arrays.load(f"limit_{name}").astype(np.float64) for name in ("axes", "ranges")))


def _clouds(arrays: Archive, rate: float | None, unit: str | float | None, up: str | None) -> PointClouds:
    """Point clouds of the arrays points (all, 3), counts (frames,) and optionally colours and normals (all, 3)."""
    points, counts = arrays.load("points"), arrays.load("counts").reshape(-1)
    if counts.dtype.kind not in "iu" or (counts < 0).any() or int(counts.sum()) != len(points):
        found = (
            f"the sum of 'counts' is {counts.sum():,}" if counts.dtype.kind in "iuf" else f"'counts' are {counts.dtype}"
        )
        raise BadInput(f"{arrays.path}: 'counts' must be whole numbers for {len(points):,} points; {found}")
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise BadInput(f"{arrays.path}: 'points' must be numbers (all, 3), not {points.dtype} {points.shape}")
    ends = np.cumsum(counts)[:-1]

    def split(name: str, dtype: Any) -> list[NDArray[Any]] | None:
        if name not in arrays.names:
            return None
        values = arrays.load(name)
        if values.shape != points.shape or (dtype == np.uint8 and values.dtype != np.uint8):
            raise BadInput(f"{arrays.path}: {name!r} must be {np.dtype(dtype)} {points.shape}, like the points")
        return np.split(values.astype(dtype), ends)

    rate = _rate(arrays) if rate is None else rate
    if unit is None:
        unit = str(arrays.single("unit")) if "unit" in arrays.names else "m"
    units, unit_m = unit_option(unit)
    positions = np.split(points.astype(np.float64) * unit_m, ends)
    up = up or (str(arrays.single("up")) if "up" in arrays.names else "y")
    source = {"format": "npz", "units": units, "unit_m": unit_m}
    return PointClouds(positions, rate, split("colours", np.uint8), split("normals", np.float64), up, source)


def _unit(arrays: Archive, key: str, positions: Floats, unit: str | float | None) -> tuple[str, float]:
    """The unit's name and its metres: as given, the file's, metres where mocodec wrote it, or guessed."""
    if unit is None and "unit" in arrays.names:
        unit = arrays.word("unit")
    if unit is None and key == "markers":
        finite = positions[~np.isnan(positions[:, :, 0])]
        unit = "mm" if finite.size and np.ptp(finite, axis=0).max() > 100 else "m"
    if unit is None:
        unit = "m" if "source" in arrays.names else guess_unit(positions)
    return unit_option(unit)


def write(path: str | Path, motion: Motion | PointClouds, layout: str | None = None) -> None:
    """Write positions (float64, metres, gaps NaN), rate, names, up and, if present, skeleton and rotations; of point
    clouds points, counts, colours and normals.

    `source` is stored as JSON; extras (analog channels, events, parameters) are left out. A motion that was read from
    body model parameters is written as these. layout: "amass" writes them for any motion of SMPL's joints (BadInput
    for others), "mocodec" never does.
    """
    if isinstance(motion, PointClouds):
        save(path, _cloud_arrays(motion))
        return
    if layout not in (None, *LAYOUTS):
        raise BadInput(f"{path}: layout is one of {', '.join(LAYOUTS)}, not {layout!r:.40}")
    if (layout or _layout_of(motion)) == "amass":
        save(path, amass.arrays_of(motion))
        return
    arrays: dict[str, NDArray[Any]] = {
        "positions": motion.positions,
        "rate": np.array(motion.rate),
        "names": np.array(motion.names, dtype=np.str_),
        "up": np.array(motion.up),
        "source": np.array(json.dumps(dict(motion.source), sort_keys=True)),
    }
    if motion.skeleton is not None:
        arrays |= {"parents": np.array(motion.skeleton.parents), "offsets": motion.skeleton.offsets}
        if motion.rotations is not None:
            arrays["rotations"] = motion.rotations
        if (limits := motion.skeleton.limits) is not None:
            arrays |= {
                "limit_orders": np.array(limits.orders),
                "limit_axes": limits.axes,
                "limit_ranges": limits.ranges,
            }
    save(path, arrays)


def _cloud_arrays(clouds: PointClouds) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {
        "points": np.concatenate([np.zeros((0, 3)), *clouds.positions]),
        "counts": np.array([len(p) for p in clouds.positions], np.int64),
        "rate": np.array(clouds.rate),
        "up": np.array(clouds.up),
    }
    if clouds.colours is not None:
        arrays["colours"] = np.concatenate([np.zeros((0, 3), np.uint8), *clouds.colours])
    if clouds.normals is not None:
        arrays["normals"] = np.concatenate([np.zeros((0, 3)), *clouds.normals])
    return arrays
