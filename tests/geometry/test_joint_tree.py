"""The tree of a skeleton as text and as facts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import Motion, Skeleton
from mocodec.cli import run
from mocodec.formats import smpl
from mocodec.geometry import joint_tree
from mocodec.motion import Limits
from mocodec.testing import synthetic


def motion_of(parents: list[int], names: list[str] | None = None, **source: object) -> Motion:
    """A motion whose bones are 10 cm, 20 cm, … long by joint number."""
    n = len(parents)
    offsets = np.zeros((n, 3))
    offsets[:, 1] = 0.1 * np.arange(n)
    skeleton = Skeleton(tuple(names or [f"j{i}" for i in range(n)]), tuple(parents), offsets)
    return Motion(np.zeros((1, n, 3)), 30, skeleton.names, "y", skeleton, source=source)


def drawn(motion: Motion) -> list[str]:
    return joint_tree.lines_of(joint_tree.facts(motion))


def test_chains_stand_in_one_line_and_brothers_below_each_other() -> None:
    motion = motion_of([-1, 0, 1, 0, 3, 3, 5, -1], ["root", "a", "b", "c", "d", "e\x1b", "f", "second"])
    assert drawn(motion) == [
        "root",
        "├─ a 10.0 · b 20.0",
        "└─ c 30.0",
        "   ├─ d 40.0",
        "   └─ e� 50.0 · f 60.0",
        "second",
    ]
    assert joint_tree.facts(motion)[6] == {"name": "f", "parent": 5, "length_m": pytest.approx(0.6)}


def test_free_axes_of_limits_and_of_channels() -> None:
    tree = motion_of([-1, 0, 1, 2, 3])
    assert tree.skeleton is not None
    ranges = np.tile([-np.inf, np.inf], (5, 3, 1))
    ranges[1], ranges[2, :2], ranges[4, 1] = 0, 0, 0
    limits = Limits(("zyx",) * 5, np.tile([1.0, 0, 0, 0], (5, 1)), ranges)
    limited = Skeleton(tree.skeleton.names, tree.skeleton.parents, tree.skeleton.offsets, limits)
    motion = Motion(tree.positions, 30, tree.names, "y", limited)
    assert drawn(motion) == ["j0 · j1 10.0 (locked) · j2 20.0 (x) · j3 30.0 · j4 40.0 (xz)"]
    assert joint_tree.facts(motion)[2]["rotates"] == "x"
    channels = motion_of([-1, 0, 1, 2, 3], channels=["XYZzyx", "zyx", "YZXx", ""])
    assert drawn(channels) == ["j0 · j1 10.0 · j2 20.0 (x, moves xyz) · j3 30.0 (locked) · j4 40.0"]
    assert "rotates" not in joint_tree.facts(channels)[4]


@pytest.mark.parametrize("runs", [5, [5], ["zyx*3", "q"], ["zyx*999999"], ["zyx"], []])
def test_channels_that_do_not_fit_say_nothing(runs: object) -> None:
    assert drawn(motion_of([-1, 0, 1], channels=runs)) == ["j0 · j1 10.0 · j2 20.0"]


@pytest.mark.parametrize(
    "parents",
    [
        [-1] + [0] * 300,
        list(range(-1, 4999)),
        [-1] * 500,
        [-1, *np.random.default_rng(0).integers(0, np.arange(1, 400)).tolist()],
    ],
)
def test_large_trees_fold(parents: list[int]) -> None:
    text = drawn(motion_of(parents))
    assert len(text) <= joint_tree.MAX_LINES + 40
    assert max(map(len, text)) <= joint_tree.WIDTH
    hidden = [int(line.split("… ")[1].split()[0]) for line in text if "joints more" in line or "joints …" in line]
    named = sum(line.count("j") - line.count("joints") for line in text)
    assert sum(hidden) + named == len(parents)


def test_common_skeletons_have_a_name() -> None:
    for tree, name in zip(smpl.trees().values(), ("SMPL body", "SMPL", "SMPL+H", "SMPL-X"), strict=True):
        assert joint_tree.known_name(motion_of(list(tree.parents), list(tree.names))) == name
    assert joint_tree.known_name(motion_of([-1, 0])) is None
    assert joint_tree.described(Motion(np.zeros((1, 2, 3)), 30)) == {}


def test_info_shows_the_tree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motion = synthetic.joints(frames=20, rate=60.0, seed=1)
    for name in ("walk.bvh", "walk.mocz"):
        path = str(tmp_path / name)
        mc.write(path, motion, **({"max_error": 0.01} if name.endswith("mocz") else {}))
        assert run(["info", path]) == 0
        text = capsys.readouterr().out
        assert "bones in cm" in text
        assert "└─ " in text
        assert "names" not in text.split("source")[0]
        assert run(["info", "--json", path]) == 0
        facts = json.loads(capsys.readouterr().out)
        assert facts["skeleton"] is True
        assert [joint["name"] for joint in facts["tree"]] == facts["names"]
    plain = Motion(np.zeros((2, 200, 3)), 30)
    mc.write(tmp_path / "a.npz", plain)
    assert run(["info", str(tmp_path / "a.npz")]) == 0
    assert "and 140 more" in capsys.readouterr().out
