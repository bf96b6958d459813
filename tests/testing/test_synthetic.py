"""The walking figure is always the same, and walks like one; importing mocodec.testing needs no test tools."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from mocodec.testing import corruption, edge_cases, synthetic


def test_the_same_for_the_same_seed():
    first, again, other = (synthetic.markers(frames=60, seed=s).positions for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


def test_markers_are_those_of_the_field():
    motion = synthetic.markers(frames=240)
    assert motion.points == 41
    assert {"C7", "LSHO", "RSHO", "LHEE", "RHEE", "LTOE", "RTOE", "LMT5", "RMT5", "LKNE"} <= set(motion.names)
    height = motion.positions[:, :, 2]
    assert 1.4 < height.max() < 2.1
    assert -0.2 < height.min() < 0.1


def test_joints_have_a_skeleton_with_rigid_bones():
    motion = synthetic.joints(frames=90, rate=60.0)
    assert motion.skeleton is not None
    for joint, parent in enumerate(motion.skeleton.parents):
        if parent >= 0:
            length = np.linalg.norm(motion.positions[:, joint] - motion.positions[:, parent], axis=1)
            assert np.ptp(length) < 1e-9


@pytest.mark.parametrize("name", edge_cases.MOTIONS)
def test_edge_cases_have_at_least_one_sample(name: str):
    assert not edge_cases.motion(name).gaps.all()


def test_damaged_copies_differ():
    data = bytes(range(50))
    assert [len(cut) for cut in corruption.prefixes(data)] == list(range(50))
    assert all(broken != data for _, broken in corruption.flips(data))
    assert list(corruption.damaged(data, 9)) == list(corruption.damaged(data, 9))


def test_no_test_tools_at_import():
    program = "import sys, mocodec.testing.synthetic; assert not {'pytest', 'hypothesis'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)
