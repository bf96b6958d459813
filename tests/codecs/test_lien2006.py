"""lien2006: point clouds of a person through a model of cylinder links, from whole sequences to hopeless ones."""

from __future__ import annotations

import numpy as np
import pytest

import mocodec as mc
from mocodec.codecs.lien2006 import Lien2006
from mocodec.encoded import Chunk, Encoded
from mocodec.errors import BadInput, CannotEncode, Corrupt, MocodecError
from mocodec.metrics import point_clouds as measures
from mocodec.motion import Motion
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

pytest.importorskip("PIL")


@pytest.fixture(scope="module")
def performance() -> sequences.Performance:
    return sequences.jumping_jacks(actors.capsules(), 8)


@pytest.fixture(scope="module")
def clouds(performance) -> PointClouds:
    return sequences.record(performance, 2000, seed=1)


@pytest.fixture(scope="module")
def encoded(performance, clouds) -> dict[float, Encoded[PointClouds]]:
    skeleton = performance.skeleton()
    return {r: Lien2006(residual=r, skeleton=skeleton, chunk_frames=4).encode(clouds) for r in (0, 25, 100)}


def test_more_residual_less_error(clouds, encoded):
    d1 = {r: np.mean([measures.d1(clouds, Lien2006.decode(e), f) for f in (3, 7)]) for r, e in encoded.items()}
    sizes = [encoded[r].payload_bytes for r in (0, 25, 100)]
    assert sizes == sorted(sizes)
    assert d1[100] < d1[0] < 0.06


def test_same_bytes_twice(performance, clouds, encoded):
    again = Lien2006(residual=25, skeleton=performance.skeleton(), chunk_frames=4).encode(clouds)
    assert again.shared == encoded[25].shared
    assert [c.payload for c in again.chunks] == [c.payload for c in encoded[25].chunks]


@pytest.mark.parametrize("frames", [slice(0, 4), slice(3, 6), slice(7, 8), slice(5, 5)])
def test_slice_of_decode_is_decode_of_slice(encoded, frames):
    whole, part = Lien2006.decode(encoded[25]), Lien2006.decode(encoded[25], frames)
    assert len(part) == frames.stop - frames.start
    for i, frame in enumerate(range(frames.start, frames.stop)):
        np.testing.assert_array_equal(part.positions[i], whole.positions[frame])
        assert part.colours is not None
        assert whole.colours is not None
        np.testing.assert_array_equal(part.colours[i], whole.colours[frame])


def test_through_a_file_and_as_motion(encoded, performance, tmp_path):
    from mocodec import container

    blob = container.pack(encoded[0])
    with mc.open(blob) as f:
        assert f.shape == (8,)
        assert len(f[2:5]) == 3
    decoded = mc.decode(blob)
    assert isinstance(decoded, PointClouds)
    assert decoded.rate == 15.0
    motion = Lien2006.track(encoded[0], slice(2, 6))
    assert isinstance(motion, Motion)
    assert len(motion) == 4
    mc.write(tmp_path / "motion.bvh", motion)
    joints = mc.read(tmp_path / "motion.bvh")
    assert isinstance(joints, Motion)
    truth = performance.joints[2:6, performance.actor.names.index("LeftForeArm")]
    found = joints.positions[:, joints.names.index("LeftForeArm")]
    assert np.linalg.norm(found - truth, axis=1).mean() < 0.12


def test_odd_frames(performance, clouds):
    assert clouds.colours is not None
    positions, colours = list(clouds.positions), list(clouds.colours)
    for frame, few in ((2, 0), (4, 3)):
        positions[frame], colours[frame] = positions[frame][:few], colours[frame][:few]
    positions[6] = positions[6].copy()
    positions[6][::7] = np.nan
    odd = PointClouds(positions, 15.0, colours)
    decoded = Lien2006.decode(Lien2006(residual=25, skeleton=performance.skeleton()).encode(odd))
    assert [len(decoded.positions[f]) for f in (2, 4)] == [0, 3]
    np.testing.assert_allclose(decoded.positions[4], positions[4], atol=1e-6)
    assert len(decoded.positions[6]) > 100
    assert measures.d1(clouds, decoded, 7) < 0.06


def test_without_colours(performance, clouds):
    grey = PointClouds(clouds.positions[:4], 15.0)
    decoded = Lien2006.decode(Lien2006(residual=50, skeleton=performance.skeleton()).encode(grey))
    assert decoded.colours is None
    assert measures.d1(grey, decoded, 3) < 0.06


def test_without_a_skeleton(clouds):
    decoded = Lien2006.decode(Lien2006().encode(clouds[0:2]))
    assert measures.d1(clouds[0:2], decoded, 1) < 0.06


def test_what_cannot_be_coded(performance, clouds):
    nothing = PointClouds([np.zeros((0, 3))] * 3, 15.0)
    with pytest.raises(CannotEncode, match="no body"):
        Lien2006().encode(nothing)
    wall = PointClouds([np.random.default_rng(0).uniform(0, 0.2, (500, 3))], 15.0)
    with pytest.raises(CannotEncode, match="give a skeleton"):
        Lien2006().encode(wall)
    far = performance.skeleton()
    far = Motion(far.positions + 5.0, far.rate, far.names, skeleton=far.skeleton, rotations=far.rotations)
    with pytest.raises(BadInput, match="its place, pose and unit"):
        Lien2006(skeleton=far).encode(clouds)
    with pytest.raises(BadInput, match="percentage"):
        Lien2006(residual=120).encode(clouds)


def test_damage_raises_corrupt_or_decodes(encoded):
    rng = np.random.default_rng(4)
    original = encoded[25]
    for _ in range(40):
        shared, payload = bytearray(original.shared[0]), bytearray(original.chunks[0].payload)
        target = shared if rng.random() < 0.5 else payload
        if rng.random() < 0.3:
            del target[rng.integers(0, len(target)) :]
        else:
            target[rng.integers(0, len(target))] ^= int(rng.integers(1, 256))
        broken = Encoded("lien2006", original.about, [Chunk(0, 4, bytes(payload))], (bytes(shared),))
        try:
            Lien2006.decode(broken)
        except MocodecError as error:
            assert isinstance(error, Corrupt)  # noqa: PT017


def test_a_second_person_is_no_part_of_the_body():
    jumper, turner = sequences.pair(actors.capsules(), 4)
    both = sequences.record((jumper, turner), 2000)
    decoded = Lien2006.decode(Lien2006(residual=25, skeleton=jumper.skeleton()[:1]).encode(both))
    assert measures.d1(sequences.record(jumper, 2000), decoded, 3) < 0.05
