"""Motions as xarray datasets in four conventions, and back.

plain             Dataset: positions (time, point, axis), rotations (time, point, quaternion), skeleton as coordinates
pyomeca           DataArray (axis, channel, time) with a row of ones, as pyomeca's Markers
movement          Dataset: position (time, space, keypoint, individual), confidence, as poses of movement 0.17 and later
movement_plural   the same for movement before 0.17, which calls the dimensions keypoints and individuals
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..motion import Motion, Skeleton, source_from
from ..typing import Floats
from . import times
from .libraries import library

AXES = ["x", "y", "z"]
MOVEMENT_DIMENSIONS: Mapping[str, tuple[str, str]] = {
    "movement": ("keypoint", "individual"), "movement_plural": ("keypoints", "individuals"),
}  # fmt: skip
"""What movement calls the dimensions of points and people: 0.17 and later, and earlier versions."""
UNITS_M: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}


def to_xarray(motion: Motion, style: str = "plain", individual: str = "id_0") -> Any:
    """The motion for xarray: positions in metres, NaN in gaps; the attributes rate (Hz), up and units.

    style "plain": a Dataset with `positions` (time, point, axis), `rotations` (time, point, quaternion; w first) if
    the motion has them, and for a skeleton the coordinates `parent` (point; "" for a root) and `offset` (point, axis).
    The attribute `source` is that of the motion, as JSON; extras are left out.
    "pyomeca": a DataArray (axis, channel, time), the axis "ones" last. "movement": a Dataset with `position`
    (time, space, keypoint, individual) and `confidence`, 1 or 0 in gaps; `individual` names the only one.
    "movement_plural": the same with the dimensions keypoints and individuals, which movement before 0.17 needs.
    Raises BadInput for another style, MissingExtra without xarray.
    """
    if style not in STYLES:
        raise BadInput(f"a style of xarray is one of {', '.join(STYLES)}, not {style!r}")
    xarray = library("xarray", "mocodec.arrays.to_xarray", "xarray")
    if style in MOVEMENT_DIMENSIONS:
        return _movement(xarray, motion, individual, *MOVEMENT_DIMENSIONS[style])
    return _pyomeca(xarray, motion) if style == "pyomeca" else plain(motion, motion.positions, motion.rotations)


def from_xarray(data: Any) -> Motion:
    """The motion of a dataset in any style of `to_xarray`, also one that pyomeca or movement made or a part of one.

    The rate is that of the times, seconds; lengths are in the attribute units (m, cm or mm), metres without it. Of
    several individuals, points are named "individual:keypoint". A skeleton is kept if the parents of all its points
    are there, before them. Raises BadInput for other dimensions and uneven times, MissingExtra without xarray.
    """
    library("xarray", "mocodec.arrays.from_xarray", "xarray")
    dims = set(data.dims)
    for style, needed in DIMENSIONS.items():
        if dims >= needed:
            return STYLES[style](data)
    raise BadInput(
        f"a dataset needs the dimensions {' or '.join(', '.join(sorted(d)) for d in DIMENSIONS.values())}, "
        f"not {', '.join(sorted(map(str, dims)))}"
    )


def plain(about: Motion, positions: Any, rotations: Any, attributes: Mapping[str, Any] | None = None) -> Any:
    """The plain dataset. about: names, rate, skeleton. positions, rotations: arrays, or what xarray loads later."""
    xarray = library("xarray", "mocodec.arrays.to_xarray", "xarray")
    variables = {"positions": xarray.Variable(("time", "point", "axis"), positions, {"units": "m"})}
    if rotations is not None:
        variables["rotations"] = xarray.Variable(("time", "point", "quaternion"), rotations)
    coordinates: dict[str, Any] = {
        "time": ("time", times.seconds(positions.shape[0], about.rate), {"units": "s"}),
        "point": list(about.names),
        "axis": AXES,
    }
    if rotations is not None:
        coordinates["quaternion"] = ["w", "x", "y", "z"]
    if about.skeleton is not None:
        parents = [about.names[parent] if parent >= 0 else "" for parent in about.skeleton.parents]
        coordinates["parent"] = ("point", np.array(parents, dtype=str))
        coordinates["offset"] = (("point", "axis"), about.skeleton.offsets, {"units": "m"})
    stored = {"rate": about.rate, "up": about.up, "units": "m", **(attributes or {})}
    if about.source:
        stored["source"] = json.dumps(about.source)
    return xarray.Dataset(variables, coordinates, stored)


def _from_plain(data: Any) -> Motion:
    dataset = data if hasattr(data, "data_vars") else data.to_dataset(name="positions")
    positions = _variable(dataset, "positions", ("time", "point", "axis"), "axis", AXES)
    names = [str(name) for name in dataset["point"].values]
    rate = times.rate_of(dataset["time"].values, dataset.attrs)
    skeleton = _skeleton(dataset, names)
    rotations = None
    if skeleton is not None and "rotations" in dataset:
        rotations = _variable(dataset, "rotations", ("time", "point", "quaternion"), "quaternion", ["w", "x", "y", "z"])
    source = json.loads(dataset.attrs.get("source", "{}"))
    first = float(dataset["time"].values[0]) * rate if len(positions) else 0.0
    if "rate" in dataset.attrs and rate != dataset.attrs["rate"]:  # thinned out: the numbers of frames do not apply
        source.pop("first_frame", None)
    up = dataset.attrs.get("up", "z")
    scaled = positions * _unit(dataset.attrs)
    return Motion(scaled, rate, names, up, skeleton, rotations, source_from(source, round(first)))


def _skeleton(dataset: Any, names: list[str]) -> Skeleton | None:
    """The skeleton in the coordinates `parent` and `offset`; None without them, or if a parent follows its child."""
    if "parent" not in dataset.coords or "offset" not in dataset.coords or len(set(names)) < len(names):
        return None
    numbers = {"": -1, **{name: i for i, name in enumerate(names)}}
    parents = [numbers.get(str(parent), len(names)) for parent in dataset["parent"].values]
    if any(parent >= joint for joint, parent in enumerate(parents)):
        return None
    offsets = _variable(dataset, "offset", ("point", "axis"), "axis", AXES)
    return Skeleton(tuple(names), tuple(parents), offsets)


def _pyomeca(xarray: Any, motion: Motion) -> Any:
    rows = np.ones((4, motion.points, len(motion)))
    rows[:3] = motion.positions.transpose(2, 1, 0)
    first = motion.source.get("first_frame", 0)
    attributes = {
        "first_frame": first, "last_frame": first + len(motion) - 1, "rate": motion.rate, "units": "m", "up": motion.up,
    }  # fmt: skip
    coordinates = {
        "axis": [*AXES, "ones"],
        "channel": list(motion.names),
        "time": times.seconds(len(motion), motion.rate),
    }
    return xarray.DataArray(rows, coordinates, ("axis", "channel", "time"), "markers", attributes)


def _from_pyomeca(data: Any) -> Motion:
    positions = _variable(_array(data, ("markers",)), None, ("time", "channel", "axis"), "axis", AXES)
    names = [str(name) for name in data["channel"].values]
    rate = times.rate_of(data["time"].values, data.attrs)
    return Motion(positions * _unit(data.attrs), rate, names, data.attrs.get("up", "z"))


def _movement(xarray: Any, motion: Motion, name: str, keypoint: str, individual: str) -> Any:
    dims = ("time", "space", keypoint, individual)
    coordinates = {
        "time": times.seconds(len(motion), motion.rate), "space": AXES, keypoint: list(motion.names),
        individual: [name],
    }  # fmt: skip
    about = {"units": "m", "up": motion.up}
    variables = {
        "position": (dims, motion.positions.transpose(0, 2, 1)[..., None].copy(), about),
        "confidence": (("time", keypoint, individual), np.where(motion.gaps, 0.0, 1.0)[..., None]),
    }
    attributes = {"source_software": "mocodec", "ds_type": "poses", "fps": motion.rate, "time_unit": "seconds", **about}
    return xarray.Dataset(variables, coordinates, attributes)


def _from_movement(data: Any, keypoint: str, individual: str) -> Motion:
    position = _array(data, ("position",))
    attributes = {**position.attrs, **data.attrs}
    positions = _variable(position, None, ("time", individual, keypoint, "space"), "space", AXES)
    individuals, keypoints = data[individual].values, data[keypoint].values
    names = [f"{person}:{point}" for person in individuals for point in keypoints]
    names = [str(point) for point in keypoints] if len(individuals) == 1 else names
    if attributes.get("time_unit", "seconds") != "seconds":
        raise BadInput("the times of the dataset are frames: set its fps and times in seconds")
    rate = times.rate_of(data["time"].values, attributes)
    flat = positions.reshape(len(positions), len(names), 3)
    return Motion(flat * _unit(attributes), rate, names, attributes.get("up", "z"))


def _from_singular(data: Any) -> Motion:
    return _from_movement(data, *MOVEMENT_DIMENSIONS["movement"])


def _from_plural(data: Any) -> Motion:
    return _from_movement(data, *MOVEMENT_DIMENSIONS["movement_plural"])


STYLES: Mapping[str, Callable[[Any], Motion]] = {
    "plain": _from_plain, "pyomeca": _from_pyomeca, "movement": _from_singular, "movement_plural": _from_plural,
}  # fmt: skip
"""The inverse of each style."""
DIMENSIONS: Mapping[str, set[str]] = {
    **{style: {"time", "space", *names} for style, names in MOVEMENT_DIMENSIONS.items()},
    "pyomeca": {"axis", "channel", "time"},
    "plain": {"time", "point", "axis"},
}
"""The dimensions that a style is known by."""


def _array(data: Any, names: tuple[str, ...]) -> Any:
    """The variable of one of these names of a dataset, or the array itself."""
    if not hasattr(data, "data_vars"):
        return data
    found = [name for name in names if name in data]
    if not found:
        raise BadInput(f"the dataset has no variable {' or '.join(names)}")
    return data[found[0]]


def _variable(data: Any, name: str | None, dims: tuple[str, ...], axis: str, labels: list[str]) -> Floats:
    """A variable with its dimensions in this order, and along `axis` these labels. Raises BadInput without them."""
    array = data if name is None else _array(data, (name,))
    if axis not in array.coords or not set(labels) <= set(array[axis].values.tolist()):
        raise BadInput(f"the dimension {axis} needs the labels {', '.join(labels)}")
    values = cast("NDArray[Any]", array.sel({axis: labels}).transpose(*dims).values)
    return np.asarray(values, np.float64)


def _unit(attributes: Mapping[str, Any]) -> float:
    """Metres per unit. Raises BadInput for units that are no lengths known here."""
    units = str(attributes.get("units") or "m")
    if units not in UNITS_M:
        raise BadInput(
            f"units are one of {', '.join(UNITS_M)}, not {units!r}: convert the data and set the attribute units"
        )
    return UNITS_M[units]
