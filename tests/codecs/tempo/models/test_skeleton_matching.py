"""Skeletons under other names are matched to the prior's, whatever is merged, missing or added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from mocodec import metrics, native
from mocodec.codecs.tempo import Tempo
from mocodec.codecs.tempo.pose import bone_directions
from mocodec.codecs.tempo.pose.bone_tree import BoneTree
from mocodec.errors import Corrupt, MocodecError
from mocodec.motion import Motion, Skeleton

from ..motions import LEAVES, header, stranger


def is_matched(encoded: object) -> bool:
    found = header(encoded)  # type: ignore[arg-type]
    return found.model == "directions-prior"


@pytest.mark.parametrize("with_skeleton", [True, False])
@pytest.mark.parametrize("gone", [(), LEAVES])
def test_skeletons_of_other_names_are_matched_and_keep_their_bound(gone: Sequence[str], with_skeleton: bool) -> None:
    motion = stranger(gone, with_skeleton=with_skeleton)
    encoded = Tempo(max_error=0.004, model="transform").encode_chunks(motion)
    assert is_matched(encoded)
    decoded = Tempo.decode(encoded).positions
    assert metrics.distances(motion.positions, decoded).max() <= 0.004
    assert Tempo.decode(encoded, slice(70, 80)).positions == pytest.approx(decoded[70:80], abs=1e-9)


def test_joints_in_any_order_and_from_any_root() -> None:
    motion = stranger(LEAVES, with_skeleton=False)
    order = np.random.default_rng(1).permutation(motion.points)
    encoded = Tempo(max_error=0.004, model="transform").encode_chunks(
        replace(motion, positions=motion.positions[:, order], names=())
    )
    assert is_matched(encoded)
    assert metrics.distances(motion.positions[:, order], Tempo.decode(encoded).positions).max() <= 0.004


def test_a_matched_skeleton_takes_fewer_bytes() -> None:
    motion = stranger(LEAVES)
    others = (Tempo(max_error=0.004, model=m) for m in ("points-prior", "points-stored", "directions-stored"))
    without = min(o.encode_chunks(motion).payload_bytes for o in others)
    assert Tempo(max_error=0.004, model="transform").encode_chunks(motion).payload_bytes < 0.9 * without


@pytest.mark.parametrize("up", ["z", "x"])
def test_another_axis_up_and_another_heading(up: str) -> None:
    motion = stranger(LEAVES, with_skeleton=False)
    x, y, z = np.moveaxis(motion.positions, -1, 0)
    x, z = 0.6 * x + 0.8 * z, 0.6 * z - 0.8 * x
    axes = (z, x, y) if up == "z" else (y, z, x)
    turned = Motion(np.stack(axes, axis=-1), motion.rate, motion.names, up)
    encoded = Tempo(max_error=0.004, model="transform").encode_chunks(turned)
    assert is_matched(encoded)
    assert metrics.distances(turned.positions, Tempo.decode(encoded).positions).max() <= 0.004


def rig(frames: int = 120) -> Motion:
    """The person with merged bones, a spine of other joints, and three fingers a hand."""
    whole = stranger((*LEAVES, "lhipjoint", "rhipjoint", "upperneck"), frames)
    assert whole.skeleton is not None
    hands = [j for j in range(whole.points) if j not in whole.skeleton.parents][-2:]
    parents, positions = list(whole.skeleton.parents), [whole.positions]
    for hand in hands:
        along = whole.positions[:, hand] - whole.positions[:, parents[hand]]
        for bend in (0.3, 0.6, 0.9):
            positions.append((whole.positions[:, hand] + bend * along)[:, None])
            parents.append(hand)
    together = np.concatenate(positions, axis=1)
    names = tuple(f"J{i}" for i in range(together.shape[1]))
    offsets = together[0] - together[0, np.maximum(parents, 0)]
    return Motion(together, whole.rate, names, "y", Skeleton(names, tuple(parents), offsets))


def odd_trees() -> dict[str, Motion]:
    rng = np.random.default_rng(3)
    t = np.arange(90)[:, None] / 30

    def swinging(parents: Sequence[int]) -> Motion:
        vectors = rng.normal(0, 0.2, (len(parents), 3))
        none = np.zeros(len(parents), bool)
        tree = BoneTree(tuple(parents), vectors, none, none)
        angles = rng.normal(0, 0.3, tree.dimensions) * np.sin(t + rng.uniform(0, 6, tree.dimensions))
        names = tuple(f"p{i}" for i in range(len(parents)))
        return Motion(bone_directions.inverse(tree, angles), 30.0, names, "y")

    centipede = [-1, *(k for i in range(8) for k in (3 * i, 3 * i, 3 * i))]
    return {
        "one bone": swinging([-1, 0]),
        "two bones": swinging([-1, 0, 1]),
        "a chain": swinging([-1, *range(100)]),
        "a star": swinging([-1, *[0] * 9]),
        "a centipede": swinging(centipede),
        "a rig": rig(),
    }


@pytest.mark.parametrize("name", list(odd_trees()))
def test_any_tree_keeps_its_bound(name: str) -> None:
    motion = odd_trees()[name]
    for bound in (0.001, 0.01):
        encoded = Tempo(max_error=bound, model="transform").encode_chunks(motion)
        assert metrics.distances(motion.positions, Tempo.decode(encoded).positions).max() <= bound


@pytest.mark.skipif(not native.available(), reason="no compiled module")
def test_numpy_and_the_compiled_module_write_the_same() -> None:
    motion = stranger(LEAVES)
    with native.without():
        plain = Tempo(max_error=0.004, model="transform").encode_chunks(motion)
    compiled = Tempo(max_error=0.004, model="transform").encode_chunks(motion)
    assert is_matched(plain)
    assert plain.shared == compiled.shared
    assert [c.payload for c in plain.chunks] == [c.payload for c in compiled.chunks]


def test_damage_is_refused() -> None:
    for with_skeleton in (True, False):
        encoded = Tempo(max_error=0.004, model="transform").encode_chunks(
            stranger(LEAVES, 60, with_skeleton=with_skeleton)
        )
        assert is_matched(encoded)
        shared = encoded.shared[0]
        for at in range(1, len(shared)):
            for damaged in (shared[:at], shared[:at] + bytes([shared[at] ^ 0x55]) + shared[at + 1 :]):
                try:
                    found = Tempo.decode(replace(encoded, shared=(damaged,)))
                except MocodecError:
                    continue
                assert found.positions.shape == (60, encoded.about.points, 3)
    with_one = Tempo(max_error=0.004, model="transform").encode_chunks(stranger(LEAVES, 60))
    with pytest.raises(Corrupt, match="skeleton"):
        Tempo.decode(replace(with_one, about=replace(with_one.about, skeleton=None)))
