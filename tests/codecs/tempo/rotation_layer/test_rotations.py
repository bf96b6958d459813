"""Rotations come back within the bound, at joints and shell points, whatever the skeleton."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import mocodec
from mocodec import BadInput, Lossless, Motion, Skeleton, Tempo, metrics, native
from mocodec.codecs.tempo import Decoder, Encoder
from mocodec.codecs.tempo.rotation_layer import choose, shell, solve
from mocodec.codecs.tempo.rotation_layer import rules as r
from mocodec.encoded import Chunk
from mocodec.geometry import kinematics, rigid
from mocodec.testing import CodecTests, hinged_figures
from mocodec.testing.codec_tests import FEW
from mocodec.typing import Floats


class TestTempoWithRotations(CodecTests):
    codec = staticmethod(lambda **settings: Tempo(**{"max_error": 0.005, **settings}))
    can_bound = True
    refuses = frozenset()

    def figure(self) -> Motion:
        return hinged_figures.figure(240)

    def small(self) -> Motion:
        return hinged_figures.figure(24)


def rotations_of(motion: Motion) -> Floats:
    assert motion.rotations is not None
    return motion.rotations


def skeleton_of(motion: Motion) -> Skeleton:
    assert motion.skeleton is not None
    return motion.skeleton


def errors(motion: Motion, decoded: Motion) -> metrics.SkeletalErrors:
    found = metrics.compare(motion, decoded).skeletal
    assert found is not None
    return found


@pytest.mark.parametrize("own_frame", [False, True])
@pytest.mark.parametrize("bound", [0.02, 0.002, 2e-5])
def test_joints_and_shell_points_keep_the_bound(own_frame: bool, bound: float) -> None:
    motion = hinged_figures.figure(own_frame=own_frame)
    decoded = mocodec.decode(mocodec.encode(motion, max_error=bound), Motion)
    assert errors(motion, decoded).joints_and_shell.largest <= bound


@pytest.mark.parametrize("target", [0.004, 0.0005])
def test_the_mean_of_joints_and_shell_points_is_near_the_target(target: float) -> None:
    motion = hinged_figures.figure(240)
    decoded = mocodec.decode(mocodec.encode(motion, mean_error=target), Motion)
    assert 0.9 * target <= errors(motion, decoded).joints_and_shell.mean <= target


@pytest.mark.parametrize("own_frame", [False, True])
def test_a_mean_error_bounds_single_frames(own_frame: bool) -> None:
    """Frames whose rotations jump for an instant are no farther off than twelve times the mean."""
    motion = hinged_figures.figure(480, own_frame=own_frame)
    rotations = rotations_of(motion).copy()
    jump = np.array([np.cos(1.0), 0.0, np.sin(1.0), 0.0])
    for frame, joint in ((100, 2), (101, 2), (250, 4), (400, 1)):
        rotations[frame, joint] = rigid.multiply(rotations[frame, joint], jump)
    tree = skeleton_of(motion)
    positions = kinematics.forward(tree, rotations, motion.positions[:, 0] - tree.offsets[0], own_frame=own_frame)
    glitched = replace(motion, positions=positions, rotations=rotations)
    decoded = mocodec.decode(mocodec.encode(glitched, mean_error=0.002), Motion)
    found = errors(glitched, decoded).joints_and_shell
    assert found.mean <= 0.002
    assert found.largest <= 12 * 0.002


def test_a_size_and_a_ratio_are_met() -> None:
    motion = hinged_figures.figure(600)
    assert len(mocodec.encode(motion, size=3000)) <= 3000
    blob = mocodec.encode(motion, ratio=40)
    assert motion.raw_bytes / len(blob) >= 40
    assert errors(motion, mocodec.decode(blob, Motion)).joints_and_shell.mean < 0.05


@pytest.mark.parametrize("codec", [Tempo(max_error=0.05, max_rotation=1.5), Tempo(mean_error=0.01, max_rotation=1.5)])
def test_a_bound_of_angles_is_kept_beside_a_target(codec: Tempo) -> None:
    motion = hinged_figures.figure()
    decoded = mocodec.decode(mocodec.encode(motion, codec), Motion)
    found = errors(motion, decoded)
    assert max(found.world_degrees.largest, found.local_degrees.largest) <= 1.5


def test_locked_angles_stay_locked() -> None:
    for own_frame in (False, True):
        motion = hinged_figures.figure(own_frame=own_frame)
        decoded = mocodec.decode(mocodec.encode(motion, max_error=0.01), Motion)
        for joint, axis in hinged_figures.HINGES.items():
            others = [1 + "xyz".index(other) for other in "xyz" if other != axis]
            assert np.abs(rotations_of(decoded)[:, joint, others]).max() < 1e-12
        if not own_frame:
            assert_allclose(
                rotations_of(decoded)[:, hinged_figures.LEAVES], [[[1, 0, 0, 0]] * 4] * len(motion), atol=1e-15
            )


def test_translation_channels_and_changing_lengths_come_back() -> None:
    motion = hinged_figures.with_translations()
    decoded = mocodec.decode(mocodec.encode(motion, max_error=0.003), Motion)
    assert errors(motion, decoded).joints_and_shell.largest <= 0.003


def test_limits_come_back_with_rotations_only() -> None:
    motion = hinged_figures.figure(own_frame=True)
    limits = skeleton_of(motion).limits
    assert limits is not None
    back = mocodec.decode(mocodec.encode(motion), Motion).skeleton
    assert back is not None
    assert back.limits is not None
    assert back.limits.orders == limits.orders
    assert_allclose(back.limits.axes, limits.axes, atol=1e-12)
    assert_allclose(back.limits.ranges, limits.ranges, atol=1e-12)
    plain = mocodec.decode(mocodec.encode(replace(motion, rotations=None)), Motion).skeleton
    assert plain is not None
    assert plain.limits is None


def test_slices_and_streams_decode_like_the_whole() -> None:
    motion = hinged_figures.figure(600)
    with mocodec.open(mocodec.encode(motion, chunk_seconds=1.0), Motion) as file:
        whole = file[:]
        assert file.info["rotations"]
        for part in (slice(0, 1), slice(57, 63), slice(119, 242), slice(599, 600)):
            assert_allclose(file[part].positions, whole.positions[part], atol=1e-9)
            assert_allclose(rotations_of(file[part]), rotations_of(whole)[part], atol=1e-9)


def test_positions_alone_are_coded_as_before() -> None:
    motion = replace(hinged_figures.figure(), rotations=None)
    assert len(Tempo().encode(motion).shared) == 1


def test_compiled_and_numpy_decoders_agree() -> None:
    if not native.available():
        pytest.skip("the compiled module is not built")
    for own_frame in (False, True):
        motion = hinged_figures.figure(own_frame=own_frame)
        blob = mocodec.encode(motion, mean_error=0.004, model="transform")  # lattices are encoded by the module alone
        compiled = mocodec.decode(blob, Motion)
        with native.without():
            pure = mocodec.decode(blob, Motion)
            assert mocodec.encode(motion, mean_error=0.004, model="transform") == blob
        assert_allclose(compiled.positions, pure.positions, atol=1e-9)
        assert_allclose(rotations_of(compiled), rotations_of(pure), atol=1e-9)


def test_kinematics_and_shell_errors_are_the_same_without_the_compiled_module() -> None:
    motion, other = hinged_figures.figure(seed=1), hinged_figures.figure(seed=2)
    results = []
    for context in (native.without(), None):
        if context is not None:
            with context:
                results.append(_measured(motion, other))
        else:
            results.append(_measured(motion, other))
    for a, b in zip(*results, strict=True):
        assert_allclose(a, b, atol=1e-12)


def _measured(motion: Motion, other: Motion) -> list[np.ndarray]:
    world = shell.world_rotations(skeleton_of(motion), rotations_of(motion))
    world_2 = shell.world_rotations(skeleton_of(motion), rotations_of(other))
    found = shell.errors(motion.positions, world, other.positions, world_2, 0.03)
    forward = kinematics.forward(skeleton_of(motion), rotations_of(motion), motion.positions[:, 0])
    return [world, found.joints, found.shell, np.array(found.total), forward]


def test_quaternion_signs_and_full_turns_cost_nothing() -> None:
    motion = hinged_figures.figure(240)
    rng = np.random.default_rng(5)
    flipped = rotations_of(motion) * rng.choice([-1.0, 1.0], (*rotations_of(motion).shape[:2], 1))
    assert mocodec.encode(replace(motion, rotations=flipped)) == mocodec.encode(motion)


def test_rules_follow_from_what_positions_show() -> None:
    motion = hinged_figures.figure()
    found = choose.choose(skeleton_of(motion), False, motion.positions, rotations_of(motion))
    rules = {name: rule.rule for name, rule in zip(motion.names, found.joints, strict=True)}
    assert rules["hips"] == rules["chest"] == r.HUB
    assert rules["l_knee"] == r.HINGE
    assert rules["l_hip"] == r.SWING
    assert rules["l_foot"] == r.FIXED
    assert [h.child for h in found.hinges[1]] == [2]
    local, positions = solve.solve(
        found, motion.positions, choose.side_values(found, motion.positions, rotations_of(motion))
    )
    assert_allclose(positions, motion.positions, atol=1e-6)
    assert shell.angles(local, rotations_of(motion)).max() < 1e-5


def test_a_joint_rarely_near_its_singular_direction_has_no_side_values() -> None:
    """Two angles follow from positions but in a few frames, which corrections mend."""
    angles = hinged_figures.curves(240, 9, 5, 0.3).reshape(240, 3, 3)
    angles[:, 2, 2] = 0.0
    angles[:, 2, 1] = 0.3 + 1.24 * np.exp(-(((np.arange(240) - 100) / 2.0) ** 2))
    motion = hinged_figures.tree((-1, 0, 1), np.array([[0, 1, 0], [0, -0.4, 0.1], [0, -0.15, 0]]), angles, True)
    found = choose.choose(skeleton_of(motion), True, motion.positions, rotations_of(motion))
    assert found.joints[2].rule == r.UNIVERSAL
    decoded = mocodec.decode(mocodec.encode(motion, max_error=0.002), Motion)
    assert errors(motion, decoded).joints_and_shell.largest <= 0.002


def test_missing_rotations_are_one_clear_error() -> None:
    motion = hinged_figures.figure()
    broken = rotations_of(motion).copy()
    broken[3, 2] = np.nan
    with pytest.raises(BadInput, match="rotation of l_knee at frame 3 is missing"):
        mocodec.encode(replace(motion, rotations=broken))
    with pytest.raises(BadInput, match="no unit quaternion"):
        mocodec.encode(replace(motion, rotations=2 * rotations_of(motion)))


def test_what_is_not_kept_is_known_before() -> None:
    motion = hinged_figures.figure(own_frame=True)
    assert mocodec.not_kept(motion) == []
    assert mocodec.not_kept(motion, "lossless") == []
    assert "positions only" in mocodec.not_kept(motion, "hou2014")[0]
    positions = motion.positions.copy()
    positions[4, 2] = np.nan
    gapped = replace(motion, positions=positions)
    assert "gaps" in mocodec.not_kept(gapped)[0]
    assert mocodec.decode(mocodec.encode(gapped), Motion).rotations is None


def test_lossless_keeps_every_bit() -> None:
    motion = hinged_figures.figure(240)
    blob = mocodec.encode(motion, Lossless(chunk_seconds=1.0))
    decoded = mocodec.decode(blob, Motion)
    assert rotations_of(decoded).tobytes() == rotations_of(motion).tobytes()
    with mocodec.open(blob, Motion) as file:
        part = file[57:131].rotations
        assert part is not None
        assert part.tobytes() == rotations_of(motion)[57:131].tobytes()


class TestLosslessWithRotations(CodecTests):
    codec = staticmethod(lambda **settings: Lossless(**settings))

    def test_round_trip(self) -> None:
        """Rotations are float64: they count beside the positions."""
        motion = self.figure()
        encoded = Lossless().encode(motion)
        assert encoded.payload_bytes < motion.raw_bytes + rotations_of(motion).nbytes
        assert_allclose(Lossless.decode(encoded).positions, motion.positions, atol=1e-6)

    def figure(self) -> Motion:
        return hinged_figures.figure(240)

    def small(self) -> Motion:
        return hinged_figures.figure(24)


def test_a_stream_keeps_rotations() -> None:
    earlier, motion = hinged_figures.figure(120, seed=1), hinged_figures.figure(120, seed=2)
    stream = Encoder(motion[:0], max_error=0.01, latency_seconds=0.5, like=earlier, rotations=True)
    chunks: list[Chunk] = []
    for start in range(0, 120, 7):
        part = motion[start : start + 7]
        chunks += stream.push(part.positions, part.rotations)
    chunks += stream.finish()
    decoder = Decoder(stream.shared, motion[:0])
    parts = [decoder.motion(c) for c in chunks]
    decoded = replace(
        motion,
        positions=np.concatenate([p.positions for p in parts]),
        rotations=np.concatenate([p.rotations for p in parts if p.rotations is not None]),
    )
    assert errors(motion, decoded).joints_and_shell.largest <= 0.01
    with pytest.raises(BadInput, match="rotations"):
        stream.push(motion.positions)
    with pytest.raises(BadInput, match="earlier recording"):
        Encoder(motion[:0], rotations=True)


@st.composite
def trees(draw: st.DrawFn) -> Motion:
    """Trees of 1 to 9 joints, some offsets zero, some joints still or hinges, several roots."""
    joints = draw(st.integers(1, 9))
    parents = tuple(draw(st.integers(-1, j - 1)) if j else -1 for j in range(joints))
    seed = draw(st.integers(0, 1000))
    rng = np.random.default_rng(seed)
    offsets = rng.normal(0, 0.2, (joints, 3))
    offsets[draw(st.lists(st.integers(0, joints - 1), max_size=3))] = 0.0
    frames = draw(st.sampled_from([1, 2, 30]))
    angles = hinged_figures.curves(frames, 3 * joints, seed, draw(st.sampled_from([0.1, 0.7, 2.5]))).reshape(
        -1, joints, 3
    )
    for joint, kind in enumerate(draw(st.lists(st.integers(0, 6), min_size=joints, max_size=joints))):
        angles[:, joint, : min(kind, 3)] = 0.3 * (kind > 3)
    return hinged_figures.tree(parents, offsets, angles, own_frame=draw(st.booleans()))


@settings(FEW, max_examples=40)
@given(motion=trees())
def test_any_skeleton_keeps_its_bound(motion: Motion) -> None:
    decoded = mocodec.decode(mocodec.encode(motion, max_error=0.004), Motion)
    assert errors(motion, decoded).joints_and_shell.largest <= 0.004 * (1 + 1e-9)


def test_several_roots_and_many_joints() -> None:
    joints = 300  # more than a byte counts
    parents = tuple(-1 if j % 100 == 0 else j - 1 - j % 2 * (j % 100 > 1) for j in range(joints))
    angles = hinged_figures.curves(12, 3 * joints, 4, 0.2).reshape(12, joints, 3)
    motion = hinged_figures.tree(parents, np.random.default_rng(2).normal(0, 0.1, (joints, 3)), angles)
    decoded = mocodec.decode(mocodec.encode(motion, max_error=0.01), Motion)
    assert errors(motion, decoded).joints_and_shell.largest <= 0.01


def test_a_single_still_joint() -> None:
    skeleton = Skeleton(("a",), (-1,), np.zeros((1, 3)))
    turn = rigid.about_axis("x", np.full((5, 1), 0.4))
    motion = Motion(np.zeros((5, 1, 3)), 30.0, ("a",), "y", skeleton, turn)
    decoded = mocodec.decode(mocodec.encode(motion, max_error=0.001), Motion)
    assert_allclose(rotations_of(decoded), turn, atol=1e-12)


@pytest.mark.parametrize("target", ["max_error", "mean_error"])
def test_rotations_of_a_single_frame_are_not_stored_exactly(target: str) -> None:
    motion = hinged_figures.figure(96)[50:51]
    with mocodec.open(mocodec.encode(motion, **{target: 0.005}), Motion) as file:
        decoded, payload_bytes = file[:], file.encoded.payload_bytes
    found = errors(motion, decoded).joints_and_shell
    assert (found.largest if target == "max_error" else found.mean) <= 0.005
    exact_bytes = rotations_of(motion).shape[1] * 3 * 8
    assert payload_bytes < exact_bytes
