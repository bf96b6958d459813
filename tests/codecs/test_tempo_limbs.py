"""Joints of a skeleton are coded as where its bones point, on its own build."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mocodec
from mocodec import metrics, native
from mocodec.codecs.tempo import Decoder, Encoder, Tempo, limbs, prior, skeletal, tempo, training
from mocodec.errors import Corrupt, MocodecError
from mocodec.motion import Floats, Motion, Skeleton

KNOWING = prior.of_limbs()
assert KNOWING is not None
POINTS = KNOWING.sets[0]


def smooth(frames: int, columns: int, seed: int) -> Floats:
    """Curves (frames, columns) of slow waves, about as large as people's turns."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / 120
    waves = rng.normal(0, 0.15, (columns, 4)) * np.sin(2 * np.pi * rng.uniform(0.1, 2.5, (columns, 4)) * t)
    return np.asarray(waves.sum(axis=2))


def body(seed: int = 0) -> limbs.Limbs:
    """The prior's limbs on somebody else's build."""
    assert POINTS.limbs is not None
    scale = np.random.default_rng(seed).uniform(0.85, 1.15, (len(POINTS.names), 1))
    return POINTS.limbs.built(POINTS.limbs.vectors * scale)


def moving(frames: int = 400, seed: int = 0, with_skeleton: bool = True) -> Motion:
    built = body(seed)
    poses = built.inverse(smooth(frames, built.dimensions, seed))
    place = np.cumsum(smooth(frames, 3, seed + 1), axis=0)[:, None] / 60
    skeleton = Skeleton(POINTS.names, built.parents, built.vectors) if with_skeleton else None
    return Motion(poses + place, 120.0, POINTS.names, "y", skeleton)


def kind(encoded: tempo.Encoded[Motion]) -> int:
    return encoded.shared[0][0]


def refuses_or_decodes_damage(encoded: tempo.Encoded[Motion], every: int) -> None:
    """Shared bytes cut off or changed behind the prior's name are an error, or decode to a motion of the same shape."""
    shared = encoded.shared[0]
    for at in range(5, len(shared), every):
        for damaged in (shared[:at], shared[:at] + bytes([shared[at] ^ 0x55]) + shared[at + 1 :]):
            try:
                found = Tempo.decode(replace(encoded, shared=(damaged,)))
            except MocodecError:
                continue
            assert found.positions.shape == (encoded.frames, 31, 3)


# ------------------------------------------------------------------------------------------------------ the coordinates


def test_poses_come_back_from_their_coordinates() -> None:
    built = body()
    given = smooth(300, built.dimensions, 3)
    poses = built.inverse(given)
    assert built.forward(poses) == pytest.approx(given, abs=1e-9)
    assert built.inverse(built.forward(poses)) == pytest.approx(poses, abs=1e-12)


def test_a_full_turn_goes_on_instead_of_jumping_back() -> None:
    built = body()
    given = np.zeros((200, built.dimensions))
    given[:, 0] = np.linspace(0, 1.5 * np.pi, 200)
    given[:, -3] = np.linspace(0, 1.5 * np.pi, 200)
    found = built.forward(built.inverse(given))
    assert np.abs(np.diff(found, axis=0)).max() < 0.1
    assert built.inverse(found) == pytest.approx(built.inverse(given), abs=1e-9)


def test_the_metric_says_how_far_points_move() -> None:
    built = body()
    given = smooth(20, built.dimensions, 4)
    small = 1e-5 * np.random.default_rng(5).normal(size=given.shape)
    moved = ((built.inverse(given + small) - built.inverse(given)) ** 2).sum()
    metric = sum(s @ built.metric(g[None]) @ s for s, g in zip(small, given, strict=True))
    assert metric == pytest.approx(moved, rel=1e-3)


def test_limbs_are_found_in_poses() -> None:
    built = body()
    poses = built.inverse(smooth(400, built.dimensions, 6))
    found = limbs.fit([poses[:200], poses[200:]], built.parents)
    assert (found.hub == built.hub).all()
    assert found.lengths == pytest.approx(built.lengths, abs=1e-9)
    assert found.inverse(found.forward(poses)) == pytest.approx(poses, abs=1e-9)


def test_points_that_stay_with_their_parent_have_no_coordinates() -> None:
    vectors = np.array([[0, 0, 0], [0, 0.4, 0], [0, 0, 0], [0, 0.3, 0.0]], float)
    chain = limbs.Limbs((-1, 0, 1, 2), vectors, np.zeros(4, bool), np.array([False, False, False, True]))
    assert chain.dimensions == 4
    given = smooth(50, 4, 7)
    poses = chain.inverse(given)
    assert poses[:, 1] == pytest.approx(poses[:, 2])
    assert chain.forward(poses) == pytest.approx(given, abs=1e-9)


def with_a_carried_hub() -> limbs.Limbs:
    """A chest and its two shoulders, carried by the spine, and arms that the hub and each other carry."""
    vectors = np.array(
        [[0, 0, 0], [0, 0.5, 0], [-0.2, 0.1, 0], [0.2, 0.1, 0.02], [-0.3, 0, 0], [0.3, 0, 0], [0.2, 0, 0.1]], float
    )
    hub, carried = np.array([0, 0, 1, 1, 0, 0, 0], bool), np.array([0, 0, 1, 1, 1, 1, 1], bool)
    return limbs.Limbs((-1, 0, 1, 1, 2, 3, 5), vectors, hub, carried)


def test_a_hub_may_be_carried_and_carry() -> None:
    built = with_a_carried_hub()
    assert built.dimensions == 2 * 4 + 3
    assert built.inverse(np.zeros((1, 11)))[0, 6] - built.inverse(np.zeros((1, 11)))[0, 0] == pytest.approx(
        built.vectors[[1, 3, 5, 6]].sum(axis=0)
    )
    given = smooth(300, 11, 8)
    poses = built.inverse(given)
    offsets = poses[:, [2, 3, 4, 5, 6]] - poses[:, [1, 1, 2, 3, 5]]
    assert np.sqrt((offsets**2).sum(axis=2)) == pytest.approx(np.tile(built.lengths[2:], (300, 1)))
    assert built.forward(poses) == pytest.approx(given, abs=1e-9)
    still = given * (np.arange(11) < 2)  # the spine alone: all that it carries turns with it
    turned = built.inverse(still)
    chest = turned[:, [2, 3, 4, 5, 6]] - turned[:, [1]]
    assert np.linalg.norm(chest[:, :, None] - chest[:, None], axis=-1) == pytest.approx(
        np.tile(np.linalg.norm(chest[0, :, None] - chest[0, None], axis=-1), (300, 1, 1))
    )
    with native.without():
        np.testing.assert_array_equal(built.inverse(given), poses)


def test_turns_by_series_are_those_by_sines() -> None:
    built = body()
    given = smooth(1, built.dimensions, 9)
    given[0, 0] = 1.0
    large = given.copy()
    large[0, 0] = 1.0 + 2 * np.pi  # about the same axis, if the other number is zero
    given[0, 1] = large[0, 1] = 0.0
    assert built.inverse(large) == pytest.approx(built.inverse(given), abs=1e-12)


# ------------------------------------------------------------------------------------------------------------ the codec


@pytest.mark.parametrize("with_skeleton", [True, False])
@pytest.mark.parametrize("target", [{"max_error": 0.004}, {"mean_error": 0.002}])
def test_joints_are_coded_as_limbs_and_keep_their_promise(with_skeleton: bool, target: dict[str, float]) -> None:
    motion = moving(with_skeleton=with_skeleton)
    encoded = Tempo(**target).in_chunks(motion)
    assert kind(encoded) == tempo.LIMBS
    error = metrics.distances(motion.positions, Tempo.decode(encoded).positions)
    if "max_error" in target:
        assert error.max() <= target["max_error"]
    else:
        assert error.mean() == pytest.approx(target["mean_error"], rel=0.02)


@pytest.mark.parametrize("names", ["known", "unknown"])
def test_the_promise_holds_for_what_a_file_keeps_of_the_skeleton(names: str) -> None:
    motion = moving(seed=11) if names == "known" else stranger(True, 300)
    for bound in (0.0003, 0.004):
        blob = mocodec.encode(motion, max_error=bound)
        assert metrics.distances(motion.positions, mocodec.decode(blob).positions).max() <= bound


def test_limbs_take_fewer_bytes_than_points() -> None:
    motion = moving()
    with prior.installed(prior.packaged_bytes()):
        points = Tempo().in_chunks(motion).payload_bytes
    assert Tempo().in_chunks(motion).payload_bytes < 0.9 * points


def test_a_skeleton_beside_the_motion_saves_its_build() -> None:
    with_one, without = (len(Tempo().in_chunks(moving(with_skeleton=w)).shared[0]) for w in (True, False))
    assert with_one < 10 < without < 120


def test_points_in_another_order_and_another_axis_up() -> None:
    motion = moving(with_skeleton=False)
    order = np.random.default_rng(8).permutation(motion.points)
    turned = motion.positions[:, order][..., [2, 0, 1]]
    other = Motion(turned, motion.rate, tuple(motion.names[i] for i in order), "z")
    encoded = Tempo(max_error=0.004).in_chunks(other)
    assert kind(encoded) == tempo.LIMBS
    assert metrics.distances(turned, Tempo.decode(encoded).positions).max() <= 0.004
    assert abs(encoded.payload_bytes / Tempo(max_error=0.004).in_chunks(motion).payload_bytes - 1) < 0.03


def test_bones_that_stretch_are_no_limbs() -> None:
    motion = moving()
    stretched = motion.positions * (1 + 0.1 * np.sin(np.arange(len(motion)) / 20))[:, None, None]
    assert kind(Tempo().in_chunks(replace(motion, positions=stretched))) != tempo.LIMBS


def test_a_skeleton_of_another_build_is_not_believed() -> None:
    motion = moving()
    assert motion.skeleton is not None
    other = Skeleton(motion.names, motion.skeleton.parents, motion.skeleton.offsets * 1.05)
    encoded = Tempo(max_error=0.004).in_chunks(replace(motion, skeleton=other))
    assert metrics.distances(motion.positions, Tempo.decode(encoded).positions).max() <= 0.004


def test_damaged_builds_are_refused() -> None:
    encoded = Tempo().in_chunks(moving(with_skeleton=False))
    refuses_or_decodes_damage(encoded, 1)
    with_one = Tempo().in_chunks(moving())
    with pytest.raises(Corrupt, match="skeleton"):
        Tempo.decode(replace(with_one, about=replace(with_one.about, skeleton=None)))


def test_a_prior_of_limbs_can_be_trained() -> None:
    people = {"a": [moving(240, 1), moving(240, 2)], "b": [moving(240, 3)]}
    data = training.train(people, with_limbs=True)
    with prior.installed(prior.packaged_bytes(), data) as first:
        assert first.sets[0].limbs is None
        encoded = Tempo().in_chunks(moving(seed=4))
        assert kind(encoded) == tempo.LIMBS
        assert np.isfinite(Tempo.decode(encoded).positions).all()


# ------------------------------------------------------------------------------------- a body whose names nobody knows


def stranger(with_skeleton: bool, frames: int = 600, rate: float = 60.0) -> Motion:
    """A body of other names, in no order of its own where it has no skeleton."""
    motion = moving(frames, 5)
    assert motion.skeleton is not None
    names = tuple(f"Bone {i}" for i in range(motion.points))
    skeleton = Skeleton(names, motion.skeleton.parents, motion.skeleton.offsets) if with_skeleton else None
    order = np.arange(motion.points) if with_skeleton else np.random.default_rng(9).permutation(motion.points)
    return Motion(motion.positions[:, order], rate, names, "y", skeleton)


@pytest.mark.parametrize("with_skeleton", [True, False])
def test_bones_are_found_among_points_that_no_prior_knows(with_skeleton: bool) -> None:
    motion = stranger(with_skeleton)
    encoded = Tempo(max_error=0.004).in_chunks(motion)
    assert kind(encoded) == tempo.OWN_LIMBS
    assert metrics.distances(motion.positions, Tempo.decode(encoded).positions).max() <= 0.004
    part = Tempo.decode(encoded, slice(250, 260))
    assert part.positions == pytest.approx(Tempo.decode(encoded).positions[250:260], abs=1e-9)


def test_a_stream_with_a_skeleton_is_one_of_limbs() -> None:
    motion = moving(240)
    sizes = []
    for about in (motion[:0], replace(motion[:0], skeleton=None)):
        stream = Encoder(about, latency_seconds=0.5)
        chunks = [*stream.push(motion.positions), *stream.finish()]
        decoder = Decoder(stream.shared, about)
        decoded = np.concatenate([decoder.push(c) for c in chunks])
        assert metrics.distances(motion.positions, decoded).max() <= 0.005
        sizes.append(sum(len(c.payload) for c in chunks))
    assert sizes[0] < 0.9 * sizes[1]


def test_a_stream_of_a_stranger_needs_nothing_earlier() -> None:
    motion = stranger(True, 60)
    stream = Encoder(motion[:0], latency_seconds=0.5)
    chunks = [*stream.push(motion.positions), *stream.finish()]
    decoder = Decoder(stream.shared, motion[:0])
    decoded = np.concatenate([decoder.push(c) for c in chunks])
    assert metrics.distances(motion.positions, decoded).max() <= 0.005


def test_points_that_are_no_body_are_no_limbs() -> None:
    rng = np.random.default_rng(2)
    free = Motion(np.cumsum(rng.normal(0, 0.002, (300, 12, 3)), axis=0), 100.0)
    assert kind(Tempo().in_chunks(free)) != tempo.OWN_LIMBS


def test_two_bodies_and_a_loop_are_no_tree() -> None:
    assert skeletal.ordered((-1, 0, -1, 2)) is None
    assert skeletal.ordered((2, 0, 1)) is None
    assert skeletal.ordered((-1, 0, 5)) is None
    assert list(np.asarray(skeletal.ordered((1, -1, 0)))) == [1, 0, 2]


def test_damaged_limbs_are_refused() -> None:
    encoded = Tempo(max_error=0.004).in_chunks(stranger(False))
    assert kind(encoded) == tempo.OWN_LIMBS
    refuses_or_decodes_damage(encoded, 29)
