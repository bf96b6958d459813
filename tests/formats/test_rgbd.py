"""Depth and colour images of one camera: points, intrinsics, names, and what is wrong with a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import cli, formats
from mocodec.errors import BadInput
from mocodec.formats import rgbd
from mocodec.pointcloud import PointClouds

image = pytest.importorskip("PIL.Image")

CAMERA = {"fx": 100.0, "fy": 50.0, "cx": 3.0, "cy": 2.0, "depth_scale": 500, "rate": 15}
NAMES = ("frame2", "frame10")


def write(folder: Path, camera: Any = CAMERA, colours: bool = True, scale: int = 1) -> np.ndarray:
    """Two frames of 6 × 8 pixels; colours `scale` times as large. Returns the depth."""
    depth = np.zeros((6, 8), np.uint16)
    depth[2, 3], depth[4, 5] = 1000, 60_000
    (folder / "depth").mkdir(parents=True)
    (folder / "camera.json").write_text(json.dumps(camera))
    for k, name in enumerate(NAMES):
        image.fromarray((depth + k * (depth > 0)).astype(np.uint16)).save(folder / "depth" / f"{name}.png")
        if colours:
            (folder / "rgb").mkdir(exist_ok=True)
            pixels = np.zeros((6, 8, 3), np.uint8)
            pixels[2, 3], pixels[4, 5] = (10 + k, 20, 30), (200, 100, 50)
            image.fromarray(np.kron(pixels, np.ones((scale, scale, 1), np.uint8))).save(folder / "rgb" / f"{name}.png")
    return depth


def read(folder: Path, **options: Any) -> PointClouds:
    clouds = mc.read(folder, **options)
    assert isinstance(clouds, PointClouds)
    return clouds


@pytest.mark.parametrize("scale", [1, 3])
def test_pixels_become_points_with_y_up(tmp_path, scale):
    write(tmp_path, scale=scale)
    clouds = read(tmp_path)
    assert (clouds.rate, clouds.up, len(clouds)) == (15.0, "y", 2)
    wanted = [[0, 0, -2.0], [2 * 120 / 100, -2 * 120 / 50, -120.0]]
    np.testing.assert_allclose(clouds.positions[0], wanted, rtol=1e-6)
    assert clouds.positions[1][0, 2] == pytest.approx(-2.002)  # frame10 comes after frame2
    assert clouds.colours is not None
    assert clouds.colours[0].tolist() == [[10, 20, 30], [200, 100, 50]]
    assert clouds.colours[1][0].tolist() == [11, 20, 30]


@pytest.mark.parametrize(
    "matrix", [[100.0, 0, 0, 0, 50.0, 0, 3.0, 2.0, 1], [[100.0, 0, 3.0], [0, 50.0, 2.0], [0, 0, 1]]]
)
def test_an_intrinsic_matrix_a_pose_and_no_colours(tmp_path, matrix):
    pose = np.eye(4)
    pose[:3, 3] = 1, 2, 3
    write(tmp_path, {"intrinsic_matrix": matrix, "pose": pose.tolist()}, colours=False)
    clouds = read(tmp_path, fps=30, unit="cm")
    assert clouds.colours is None
    np.testing.assert_allclose(clouds.positions[0][0], [1, 2, 13])
    assert clouds.rate == 30


def test_images_of_other_names_belong_by_number(tmp_path):
    write(tmp_path)
    for k, name in enumerate(NAMES):
        (tmp_path / "rgb" / f"{name}.png").rename(tmp_path / "rgb" / f"{k:04}.png")
    assert read(tmp_path).colours is not None
    (tmp_path / "rgb" / "0001.png").unlink()
    with pytest.raises(BadInput, match="2 depth images and 1 colour"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("camera", "problem"),
    [
        ({"fx": 1, "fy": 1, "cx": 0}, "no 'cy'"),
        ([1], "not an object"),
        ({**CAMERA, "fx": 0}, "above zero"),
        ({**CAMERA, "fy": "wide"}, "intrinsics"),
        ({**CAMERA, "pose": [1, 2]}, "intrinsics"),
        ({k: v for k, v in CAMERA.items() if k != "rate"}, "fps=15"),
    ],
)
def test_unusable_intrinsics_are_one_line(tmp_path, camera, problem):
    write(tmp_path, camera)
    with pytest.raises(BadInput, match=problem) as caught:
        read(tmp_path)
    assert "\n" not in str(caught.value)


def test_damaged_and_colour_images_as_depth_are_refused(tmp_path):
    write(tmp_path)
    depth = tmp_path / "depth" / "frame2.png"
    depth.write_bytes(depth.read_bytes()[:40])
    with pytest.raises(BadInput, match="frame2"):
        read(tmp_path)
    image.fromarray(np.zeros((6, 8, 3), np.uint8)).save(depth)
    with pytest.raises(BadInput, match="one channel"):
        read(tmp_path)


def test_options_and_the_command_line(tmp_path):
    folder = tmp_path / "scene"
    write(folder)
    assert formats.is_images(folder)
    assert not formats.is_images(tmp_path)
    assert {"fps", "unit", "up"} <= formats.read_options(folder)
    output = tmp_path / "scene.mocz"
    assert cli.run(["encode", str(folder), "-o", str(output), "--max-error", "1mm", "--quiet"]) == 0
    decoded = mc.decode(output)
    assert isinstance(decoded, PointClouds)
    assert len(decoded) == 2


def test_more_points_than_the_bytes_of_images_can_show_are_refused(tmp_path, monkeypatch):
    write(tmp_path)
    monkeypatch.setattr(rgbd, "MAX_POINTS", 3)
    assert len(read(tmp_path)) == 2
    monkeypatch.setattr(rgbd, "POINTS_PER_BYTE", 0)
    with pytest.raises(BadInput, match=r"frame10\.png: 2 points are too many"):
        read(tmp_path)
