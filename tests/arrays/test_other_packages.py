"""pyomeca and movement themselves take our arrays, and theirs come back. Skipped where they are not installed."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import arrays
from mocodec.testing import synthetic

MOTION = synthetic.joints(frames=120, rate=60.0, seed=1)


def test_pyomeca_takes_ours(tmp_path: Path) -> None:
    pyomeca = pytest.importorskip("pyomeca")
    ours = arrays.to_xarray(MOTION, style="pyomeca")
    theirs = pyomeca.Markers(ours.values[:3], channels=list(MOTION.names), time=ours.time.values)
    assert ours.equals(theirs)
    np.testing.assert_array_equal(arrays.from_xarray(theirs).positions, MOTION.positions)
    smooth = arrays.from_xarray(ours.meca.low_pass(freq=MOTION.rate, order=2, cutoff=10))
    assert (smooth.names, smooth.rate) == (MOTION.names, MOTION.rate)
    assert np.abs(smooth.positions - MOTION.positions).max() < 0.05
    slower = ours.meca.time_normalize(time_vector=np.arange(60) / 30)
    assert arrays.from_xarray(slower).rate == pytest.approx(30)
    assert ours.meca.norm(dim="axis").dims == ("channel", "time")
    assert ours.meca.to_wide_dataframe().shape == (120, 4 * MOTION.points)


def test_pyomeca_reads_our_c3d(tmp_path: Path) -> None:
    pyomeca = pytest.importorskip("pyomeca")
    mc.write(tmp_path / "walk.c3d", MOTION)
    read = pyomeca.Markers.from_c3d(str(tmp_path / "walk.c3d"))
    back = arrays.from_xarray(read)
    assert (back.names, back.rate) == (MOTION.names, 60.0)
    np.testing.assert_allclose(back.positions, MOTION.positions, atol=1e-6)


@pytest.fixture
def poses() -> Any:
    """The motion for the movement that is installed."""
    pytest.importorskip("movement")
    release = tuple(map(int, version("movement").split(".")[:2]))
    return arrays.to_xarray(MOTION, style="movement" if release >= (0, 17) else "movement_plural")


def test_movement_takes_ours(poses: Any) -> None:
    datasets = pytest.importorskip("movement.validators.datasets")
    datasets.ValidPosesInputs.validate(poses)
    load = pytest.importorskip("movement.io.load_poses")
    theirs = load.from_numpy(
        poses.position.values, poses.confidence.values, ["id_0"], list(MOTION.names), fps=MOTION.rate
    )
    assert poses.equals(theirs)
    back = arrays.from_xarray(theirs)
    assert (back.names, back.rate) == (MOTION.names, MOTION.rate)
    np.testing.assert_array_equal(back.positions, MOTION.positions)


def test_movement_computes_on_ours(poses: Any) -> None:
    kinematics = pytest.importorskip("movement.kinematics")
    filtering = pytest.importorskip("movement.filtering")
    velocity = kinematics.compute_velocity(poses.position).values[..., 0].transpose(0, 2, 1)
    np.testing.assert_allclose(velocity, np.gradient(MOTION.positions, 1 / MOTION.rate, axis=0), atol=1e-9)
    smooth = arrays.from_xarray(filtering.savgol_filter(poses.position, 9))
    assert (smooth.names, smooth.rate, smooth.up) == (MOTION.names, MOTION.rate, MOTION.up)
    assert arrays.from_xarray(filtering.filter_by_confidence(poses.position, poses.confidence)).points == MOTION.points
