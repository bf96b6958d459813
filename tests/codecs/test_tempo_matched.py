"""Limbs under names that the prior does not know are matched to its own, whatever is merged, missing or added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from mocodec import metrics, native
from mocodec.codecs.tempo import Tempo, limbs, matched, prior, tempo
from mocodec.codecs.tempo.model import HEADING, Model, step_size
from mocodec.errors import Corrupt, MocodecError
from mocodec.motion import Floats, Motion, Skeleton

KNOWING = prior.of_limbs()
assert KNOWING is not None
POINTS = KNOWING.sets[0]
assert POINTS.limbs is not None
LIKE = POINTS.limbs
NAMES = POINTS.names
LEAVES = ("ltoes", "rtoes", "lfingers", "rfingers", "lthumb", "rthumb", "head")


def person(frames: int = 150, rate: float = 30.0, seed: int = 0) -> Floats:
    """Positions (frames, points, 3) of somebody who moves as the prior expects, on a build of their own."""
    rng = np.random.default_rng(seed)
    built = LIKE.built(LIKE.vectors * rng.uniform(0.9, 1.12, (len(NAMES), 1)))
    assert KNOWING is not None
    model = Model(replace(POINTS, limbs=built), KNOWING, rate)
    usual = step_size(model.expected(frames, 0))
    usual[:, : HEADING + 1] = 0.0
    return model.synthesise(0.7 * rng.normal(size=usual.shape) * usual, frames)


def stranger(
    gone: Sequence[str] = (), frames: int = 150, rate: float = 30.0, with_skeleton: bool = True, seed: int = 0
) -> Motion:
    """The person under other names, without some joints; those before and after them are linked then."""
    kept = [i for i, name in enumerate(NAMES) if name not in gone]
    parents = []
    for i in kept:
        above = LIKE.parents[i]
        while above >= 0 and above not in kept:
            above = LIKE.parents[above]
        parents.append(kept.index(above) if above >= 0 else -1)
    positions = person(frames, rate, seed)[:, kept]
    names = tuple(f"Bone {i}" for i in range(len(kept)))
    offsets = positions[0] - positions[0, np.maximum(parents, 0)]
    return Motion(positions, rate, names, "y", Skeleton(names, tuple(parents), offsets) if with_skeleton else None)


def kind(encoded: tempo.Encoded[Motion]) -> int:
    return encoded.shared[0][0]


@pytest.mark.parametrize("with_skeleton", [True, False])
@pytest.mark.parametrize("gone", [(), LEAVES])
def test_limbs_of_other_names_are_matched_and_keep_their_promise(gone: Sequence[str], with_skeleton: bool) -> None:
    motion = stranger(gone, with_skeleton=with_skeleton)
    encoded = Tempo(max_error=0.004).in_chunks(motion)
    assert kind(encoded) == tempo.MATCHED_LIMBS
    decoded = Tempo.decode(encoded).positions
    assert metrics.distances(motion.positions, decoded).max() <= 0.004
    assert Tempo.decode(encoded, slice(70, 80)).positions == pytest.approx(decoded[70:80], abs=1e-9)


def test_joints_in_any_order_and_from_any_root() -> None:
    motion = stranger(LEAVES, with_skeleton=False)
    order = np.random.default_rng(1).permutation(motion.points)
    encoded = Tempo(max_error=0.004).in_chunks(replace(motion, positions=motion.positions[:, order], names=()))
    assert kind(encoded) == tempo.MATCHED_LIMBS
    assert metrics.distances(motion.positions[:, order], Tempo.decode(encoded).positions).max() <= 0.004


def test_matched_limbs_take_fewer_bytes() -> None:
    motion = stranger(LEAVES)
    with prior.installed(prior.packaged_bytes(), prior.packaged_bytes(prior.BONES_FILE)):
        without = Tempo(max_error=0.004).in_chunks(motion).payload_bytes
    assert Tempo(max_error=0.004).in_chunks(motion).payload_bytes < 0.9 * without


@pytest.mark.parametrize("up", ["z", "x"])
def test_another_axis_up_and_another_way_to_face(up: str) -> None:
    motion = stranger(LEAVES, with_skeleton=False)
    x, y, z = np.moveaxis(motion.positions, -1, 0)
    x, z = 0.6 * x + 0.8 * z, 0.6 * z - 0.8 * x
    axes = (z, x, y) if up == "z" else (y, z, x)
    turned = Motion(np.stack(axes, axis=-1), motion.rate, motion.names, up)
    encoded = Tempo(max_error=0.004).in_chunks(turned)
    assert kind(encoded) == tempo.MATCHED_LIMBS
    assert metrics.distances(turned.positions, Tempo.decode(encoded).positions).max() <= 0.004


def rig(frames: int = 120) -> Motion:
    """The person with merged bones, a back in other pieces, and three fingers a hand."""
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
        built = limbs.Limbs(tuple(parents), vectors, none, none)
        turns = rng.normal(0, 0.3, built.dimensions) * np.sin(t + rng.uniform(0, 6, built.dimensions))
        return Motion(built.inverse(turns), 30.0, tuple(f"p{i}" for i in range(len(parents))), "y")

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
def test_any_tree_keeps_its_promise(name: str) -> None:
    motion = odd_trees()[name]
    for bound in (0.001, 0.01):
        encoded = Tempo(max_error=bound).in_chunks(motion)
        assert metrics.distances(motion.positions, Tempo.decode(encoded).positions).max() <= bound


@pytest.mark.skipif(not native.available(), reason="no compiled module")
def test_numpy_and_the_compiled_module_write_the_same() -> None:
    motion = stranger(LEAVES)
    with native.without():
        plain = Tempo(max_error=0.004).in_chunks(motion)
    compiled = Tempo(max_error=0.004).in_chunks(motion)
    assert kind(plain) == tempo.MATCHED_LIMBS
    assert plain.shared == compiled.shared
    assert [c.payload for c in plain.chunks] == [c.payload for c in compiled.chunks]


def test_damage_is_refused() -> None:
    for with_skeleton in (True, False):
        encoded = Tempo(max_error=0.004).in_chunks(stranger(LEAVES, 60, with_skeleton=with_skeleton))
        assert kind(encoded) == tempo.MATCHED_LIMBS
        shared = encoded.shared[0]
        for at in range(1, len(shared)):
            for damaged in (shared[:at], shared[:at] + bytes([shared[at] ^ 0x55]) + shared[at + 1 :]):
                try:
                    found = Tempo.decode(replace(encoded, shared=(damaged,)))
                except MocodecError:
                    continue
                assert found.positions.shape == (60, encoded.about.points, 3)
    about = replace(encoded.about, skeleton=None)
    with_one = Tempo(max_error=0.004).in_chunks(stranger(LEAVES, 60))
    with pytest.raises(Corrupt, match="skeleton"):
        Tempo.decode(replace(with_one, about=about))


# ------------------------------------------------------------------------------------ the arithmetic in a written order


def merged(gone: Sequence[int]) -> tuple[limbs.Limbs, matched.Stored, list[int]]:
    kept = [i for i in range(len(NAMES)) if i not in gone]
    parents = []
    for i in kept:
        above = LIKE.parents[i]
        while above in gone:
            above = LIKE.parents[above]
        parents.append(kept.index(above) if above >= 0 else -1)
    where = np.array(kept)
    marks = matched.usual_marks(where, LIKE)
    stored = matched.Stored(
        10, tuple(parents), where, marks, np.zeros((len(kept), 3), int), np.array(matched.USUAL_LEVELS)
    )
    rest, columns = matched.at_rest(stored, LIKE, None)
    return rest, stored, [kept[c] for c in columns]


def test_what_is_stored_comes_back() -> None:
    _, stored, _ = merged([12, 15])
    rng = np.random.default_rng(4)
    stored = replace(stored, bones=np.where(stored.told, rng.integers(-300, 300, stored.bones.shape), 0))
    found = matched.Stored.unpack(stored.pack(LIKE), len(stored.where), LIKE)
    assert (found.digits, found.parents) == (stored.digits, stored.parents)
    for name in ("where", "marks", "bones", "levels"):
        assert (getattr(found, name) == getattr(stored, name)).all()


def test_the_metric_is_that_of_the_limbs() -> None:
    rest, _, _ = merged([])
    known = rest.metric(np.zeros((1, rest.dimensions)))
    assert matched._metric(rest) == pytest.approx(known, abs=2e-6 * known.max())
    factor = matched._cholesky(known + 1e-6 * np.eye(len(known)))
    assert factor @ factor.T == pytest.approx(known + 1e-6 * np.eye(len(known)), abs=1e-12)
    assert POINTS.reach is not None
    assert matched._unweighed(POINTS.bases[0], POINTS.reach) == pytest.approx(POINTS.unweighed_bases[0], abs=1e-9)


@pytest.mark.parametrize("gone", [[], [15], [12, 15, 20, 27], [1, 6, 20]])
def test_small_turns_of_the_priors_are_small_turns_of_the_files(gone: list[int]) -> None:
    rest, stored, kept = merged(gone)
    paths = matched.paths(np.array(kept), rest.parents, LIKE)
    onto = matched._onto(rest, paths, LIKE)
    turns = np.random.default_rng(5).normal(0, 1e-4, (4, LIKE.dimensions))
    poses = LIKE.inverse(turns)[:, kept]
    poses = poses - poses.mean(axis=1, keepdims=True)
    still = [b for i, b in enumerate(rest.plan.bones) if rest.parents[b] >= 0 and len(paths[b]) > 0]
    assert len(still) == len(rest.plan.bones)
    assert rest.forward(poses) == pytest.approx(turns @ onto, abs=1e-6)
    assert len(stored.where) == len(kept)
