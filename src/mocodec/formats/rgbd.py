"""Depth and colour images of one camera as point clouds: a folder with intrinsics as JSON and two folders of images.

    camera.json · depth/*.png (16 bits) · color/*.png or *.jpg ──read──► PointClouds, y up

A pixel (column u, row v) of depth z is the point ((u − cx) z / fx, (v − cy) z / fy, z) of the camera, x to the right, y
down; the world is (x, −y, −z) of it, or what a pose in the JSON says. Depth 0 is no point.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadInput, MissingExtra
from ..pointcloud import PointClouds
from ..typing import Bytes, Floats
from .conventions import unit_option

DEPTH_FOLDERS, COLOUR_FOLDERS = ("depth",), ("color", "colour", "rgb")
INTRINSICS = ("camera.json", "intrinsics.json", "intrinsic.json", "camera_intrinsic.json")
COLOUR_SUFFIXES = (".png", ".jpg", ".jpeg")
MILLIMETRES = 1000.0  # steps of a metre, if the JSON does not say it
MAX_IMAGE_PIXELS = 1 << 26
MAX_POINTS, POINTS_PER_BYTE = 1 << 22, 64
"""Most points of all frames: MAX_POINTS, and so many for each byte of the depth images; more is damage or malice."""
MAX_JSON_BYTES = 1 << 20
Y_UP = np.diag([1.0, -1.0, -1.0, 1.0])


class Camera(NamedTuple):
    """fx, fy, cx, cy: pixels. per_metre: steps of depth. world_from_camera (4, 4). rate: hertz, if it is known."""

    fx: float
    fy: float
    cx: float
    cy: float
    per_metre: float
    world_from_camera: Floats
    rate: float | None


def is_sequence(path: str | PathLike[str]) -> bool:
    """Whether a folder has intrinsics and depth images as `read` expects them."""
    folder = Path(path)
    return folder.is_dir() and _first(folder, INTRINSICS) is not None and _first(folder, DEPTH_FOLDERS) is not None


def hint(names: Collection[str]) -> str:
    """What a folder with these names in it lacks for `read`, in words; "" where it has no images."""
    if set(names) & set(DEPTH_FOLDERS):
        return f"depth images need their intrinsics beside them: a {INTRINSICS[0]} with fx, fy, cx, cy and rate"
    if any(name.lower().endswith(".png") for name in names):
        return (
            f"depth images are read from a folder with {INTRINSICS[0]} and {DEPTH_FOLDERS[0]}/*.png: name that folder"
        )
    return ""


def read(
    path: str | PathLike[str],
    *,
    fps: float | None = None,
    rate: float | None = None,
    unit: str | float | None = None,
    up: str | None = None,
) -> PointClouds:
    """The frames of a folder, in natural order of the names of the depth images.

    fps or rate: hertz, if the JSON has none. unit: of one step of depth in place of that of the JSON, such as "mm". up:
    the vertical axis, by default "y". Colour images belong to the depth images of the same name, or, if no names
    agree, to those of the same number. An image of another size is taken to show the same view. Raises BadInput, and
    MissingExtra without Pillow.
    """
    folder = Path(path)
    if not is_sequence(folder):
        raise BadInput(f"{folder}: no folder with camera.json and depth/*.png")
    camera = read_camera(folder)
    hertz = next((given for given in (fps, rate, camera.rate) if given is not None), None)
    if hertz is None:
        raise BadInput(f"{folder}: the images have no frame rate; give it, for instance fps=15 (--fps 15)")
    step_m = 1 / camera.per_metre if unit is None else unit_option(unit)[1]
    depths = _images(folder, DEPTH_FOLDERS, (".png",))
    if not depths:
        raise BadInput(f"{folder}: depth has no .png")
    colours = _colour_images(folder, depths)
    positions, frames_of_colours = list[Floats](), list[Bytes]()
    room = MAX_POINTS + POINTS_PER_BYTE * sum(depth.stat().st_size for depth in depths)
    for depth, colour in zip(depths, colours or [None] * len(depths), strict=True):
        points, own = _frame(depth, colour, camera, step_m, room)
        room -= len(points)
        positions.append(points)
        if own is not None:
            frames_of_colours.append(own)
    source = {"format": "rgbd", "units": "m", "unit_m": 1.0, "double": False}
    try:
        return PointClouds(positions, float(hertz), frames_of_colours if colours else None, up=up or "y", source=source)
    except ValueError as error:
        raise BadInput(f"{folder}: {error}") from None


def read_camera(folder: Path) -> Camera:
    """The intrinsics of a folder. Raises BadInput."""
    path = _first(folder, INTRINSICS)
    if path is None:
        raise BadInput(f"{folder}: no {', '.join(INTRINSICS)}")
    try:
        if path.stat().st_size > MAX_JSON_BYTES:
            raise ValueError("too large for intrinsics")
        given = json.loads(path.read_text())
        camera = _camera(given)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise BadInput(f"{path}: {_problem(error)}") from None
    numbers = [*camera[:5], *camera.world_from_camera.ravel().tolist()]
    if not all(map(math.isfinite, numbers)) or min(camera.fx, camera.fy, camera.per_metre) <= 0:
        raise BadInput(f"{path}: focal lengths and depth_scale must be above zero, and all numbers finite")
    return camera


def _problem(error: Exception) -> str:
    return f"no {error.args[0]!r}" if isinstance(error, KeyError) else f"no intrinsics: {error}"[:200]


def _camera(given: Any) -> Camera:
    """From fx, fy, cx, cy, or an intrinsic matrix: 3 × 3, or its nine numbers column by column."""
    if not isinstance(given, dict):
        raise ValueError("not an object")
    inner = given.get("intrinsics", given)
    if "intrinsic_matrix" in inner:
        matrix = np.array(inner["intrinsic_matrix"], float)
        matrix = matrix.reshape(3, 3).T if matrix.ndim == 1 else matrix.reshape(3, 3)
        fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    else:
        fx, fy, cx, cy = (float(inner[name]) for name in ("fx", "fy", "cx", "cy"))
    pose = given.get("world_from_camera", given.get("pose"))
    world = Y_UP if pose is None else np.array(pose, float).reshape(4, 4)
    rate = next((float(given[name]) for name in ("rate", "fps") if given.get(name) is not None), None)
    per_metre = float(given.get("depth_scale", MILLIMETRES))
    return Camera(fx, fy, cx, cy, per_metre, world, rate)


def _first(folder: Path, names: tuple[str, ...]) -> Path | None:
    return next((folder / name for name in names if (folder / name).exists()), None)


def _images(folder: Path, names: tuple[str, ...], suffixes: tuple[str, ...]) -> list[Path]:
    """The images of the first of these folders, in natural order of names."""
    inner = _first(folder, names)
    found = [] if inner is None or not inner.is_dir() else [p for p in inner.iterdir() if p.suffix.lower() in suffixes]
    found = [p for p in found if not p.name.startswith(".")]
    return sorted(found, key=lambda p: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", p.stem)])


def _colour_images(folder: Path, depths: list[Path]) -> list[Path] | None:
    """The colour image of each depth image; None without colour images. Raises BadInput if they do not belong."""
    images = _images(folder, COLOUR_FOLDERS, COLOUR_SUFFIXES)
    if not images:
        return None
    by_name = {image.stem: image for image in images}
    if all(depth.stem in by_name for depth in depths):
        return [by_name[depth.stem] for depth in depths]
    if len(images) != len(depths):
        raise BadInput(f"{folder}: {len(depths)} depth images and {len(images)} colour images, of other names")
    return images


def _frame(depth: Path, colour: Path | None, camera: Camera, step_m: float, room: int) -> tuple[Floats, Bytes | None]:
    """The points (n, 3), float32 precision, and colours (n, 3) of an image. Raises BadInput for more than `room`."""
    values = _pixels(depth, None)
    if values.ndim != 2 or values.dtype.kind not in "ui":
        raise BadInput(f"{depth}: depth is one channel of integers, not {values.shape} of {values.dtype}")
    if (count := int(np.count_nonzero(values))) > room:
        raise BadInput(f"{depth}: {count:,} points are too many for images of so few bytes")
    v, u = np.nonzero(values)
    z = values[v, u].astype(float) * step_m
    seen = np.stack([(u - camera.cx) * z / camera.fx, (v - camera.cy) * z / camera.fy, z, np.ones(len(z))], axis=1)
    points = (seen @ camera.world_from_camera.T)[:, :3].astype(np.float32).astype(np.float64)
    if colour is None:
        return points, None
    image = _pixels(colour, "RGB")
    rows, columns = v * image.shape[0] // values.shape[0], u * image.shape[1] // values.shape[1]
    return points, np.ascontiguousarray(image[rows, columns])


def _pixels(path: Path, mode: str | None) -> Any:
    """An image as an array, in a mode of Pillow. Raises BadInput, MissingExtra."""
    try:
        image = import_module("PIL.Image")
    except ImportError:
        raise MissingExtra("reading depth images", "cloud") from None
    try:
        with image.open(path) as opened:
            if opened.width * opened.height > MAX_IMAGE_PIXELS:
                raise BadInput(f"{path}: {opened.width} × {opened.height} pixels are too many")
            return np.asarray(opened if mode is None else opened.convert(mode))
    except (OSError, ValueError, SyntaxError, EOFError, image.DecompressionBombError) as error:
        raise BadInput(f"{path}: no image that can be read ({error})") from None
