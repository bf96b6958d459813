"""The check of coded points: damage between coding and check, and the check that follows against the full decoding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

import mocodec as mc
from mocodec.codecs.bodycast import Bodycast, point_check, point_encoder
from mocodec.codecs.bodycast.lattice_frames import LatticeFrame
from mocodec.codecs.bodycast.point_encoder import PointEncoder, PointTarget
from mocodec.codecs.bodycast.point_layer import _OctreeOfFrame
from mocodec.codecs.bodycast.point_scene import ChunkBodies
from mocodec.entropy.bit_arrays import BitCheck, BitEncoder
from mocodec.errors import CannotEncode, Corrupt
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

pytest.importorskip("av")
pytestmark = pytest.mark.skipif(not BitCheck.is_available(), reason="the compiled module is not built")

TARGET = PointTarget(max_error=0.004)


@pytest.fixture(scope="module")
def of_person() -> PointEncoder:
    """One chunk of a coloured person."""
    performance = sequences.jumping_jacks(actors.capsules(), 3)
    clouds = replace(sequences.record(performance, 400, seed=1), normals=None)
    made = list[PointEncoder]()

    def keep(encoder: PointEncoder, _: PointTarget) -> list[bytes]:
        made.append(encoder)
        return [b""]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PointEncoder, "encode", keep)
        Bodycast(max_error=0.004, skeleton=performance.skeleton()).encode(clouds)
    return made[-1]


def dish(k: int) -> np.ndarray:
    """Other points of a curved surface in every frame, metres."""
    flat = np.random.default_rng(k).uniform(-0.1, 0.1, (300, 2))
    return np.column_stack([flat[:, 0] + 0.02 * k, flat[:, 1], 3 * (flat**2).sum(axis=1)])


@pytest.fixture(scope="module")
def of_things() -> PointEncoder:
    """Two chunks without bodies or colours, whose frames refer to earlier ones; one frame is empty."""
    frames = [(points, None) for points in (dish(0), dish(1), np.zeros((0, 3)), dish(2), dish(3))]
    return PointEncoder(frames, [slice(0, 3), slice(3, 5)], [ChunkBodies.nobody(3), ChunkBodies.nobody(2)], False)


def outcome(encoder: PointEncoder, follows: bool) -> list[bytes] | None:
    """The parts, or None if the check refuses them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BitCheck, "is_available", lambda: follows)
        try:
            return encoder.encode(TARGET)
        except (CannotEncode, Corrupt):
            return None


@pytest.mark.parametrize("name", ["of_person", "of_things"])
def test_both_checks_accept_and_refuse_the_same_parts(name, request, monkeypatch):
    encoder = request.getfixturevalue(name)
    parts, join = outcome(encoder, follows=True), point_encoder.join
    assert parts is not None
    assert parts == outcome(encoder, follows=False)
    for place in np.linspace(0, len(parts[0]) - 1, 24).astype(int).tolist():

        def flipped(*stored, place=place):
            part = bytearray(join(*stored))
            part[min(place, len(part) - 1)] ^= 1
            return bytes(part)

        monkeypatch.setattr(point_encoder, "join", flipped)
        assert outcome(encoder, follows=True) == outcome(encoder, follows=False)


@pytest.mark.parametrize("follows", [True, False])
@pytest.mark.parametrize("place", [0, 100, -5])
@pytest.mark.parametrize("name", ["of_person", "of_things"])
def test_bytes_that_are_damaged_after_coding_are_refused(name, place, follows, request, monkeypatch):
    finish = BitEncoder.finish

    def damaged(coder):
        data = bytearray(finish(coder))
        if data:
            data[place] ^= 4
        return bytes(data)

    monkeypatch.setattr(BitEncoder, "finish", damaged)
    assert outcome(request.getfixturevalue(name), follows) is None


@pytest.mark.parametrize("follows", [True, False])
def test_points_beyond_the_bound_are_refused(of_things, monkeypatch, follows):
    monkeypatch.setattr(LatticeFrame, "own_distances", lambda self, _: np.full(len(self.originals), 0.0041))
    assert outcome(of_things, follows) is None


def test_another_header_is_refused(of_things, monkeypatch):
    join = point_encoder.join
    monkeypatch.setattr(point_encoder, "join", lambda places, *rest: join(places._replace(kind=4), *rest))
    with pytest.raises(CannotEncode, match=point_check.DIFFERENT):
        of_things.encode(TARGET)


@pytest.mark.parametrize("follows", [True, False])
def test_an_encoder_that_computes_what_a_decoder_does_not_is_refused(of_things, monkeypatch, follows):
    encode = _OctreeOfFrame.encode

    def moved(self, coder, *given):
        coder, reference, located = encode(self, coder, *given)
        return coder, reference, located._replace(positions=located.positions + 1e-9)

    monkeypatch.setattr(_OctreeOfFrame, "encode", moved)
    assert outcome(of_things, follows) is None


def odd_scene() -> PointClouds:
    """Two people and a thing that slides, coloured. Frames are empty, of one point, half empty, repeated, and wide."""
    rng = np.random.default_rng(4)
    people = sequences.pair(actors.capsules(), 10)
    clouds = sequences.record(people, 250, noise_m=0.003, seed=4)
    points = [np.concatenate([own, dish(k) + np.ones(3)]) for k, own in enumerate(clouds.positions)]
    points[3], points[4] = points[3][:0], points[4][:1]
    points[6], points[7] = points[6][points[6][:, 0] > 0], points[5]
    points[8] = np.concatenate([points[8], rng.uniform(-20, 20, (5, 3))])
    return PointClouds(points, 15.0, [rng.integers(0, 256, own.shape, np.uint8) for own in points])


@pytest.mark.parametrize(("bound_m", "chunk_frames"), [(0.0004, 150), (0.004, 4), (0.03, 150)])
def test_all_frames_decode_to_the_points_and_colours_that_were_coded(bound_m, chunk_frames, monkeypatch):
    coded, finish = list[tuple[np.ndarray, np.ndarray]](), point_check.ChunkCheck.finish
    monkeypatch.setattr(point_check, "FIRST_FRAMES", 1000)  # keeps what was coded; the decoder below has nothing of it

    def kept(check, *stored):
        coded.extend(check._first)
        check._first.clear()
        finish(check, *stored)

    monkeypatch.setattr(point_check.ChunkCheck, "finish", kept)
    clouds, skeleton = odd_scene(), sequences.pair(actors.capsules(), 10)[0].skeleton()
    data = mc.encode(clouds, Bodycast(max_error=bound_m, skeleton=skeleton, chunk_frames=chunk_frames))
    decoded = mc.decode(data, PointClouds)
    assert decoded.colours is not None
    found = [own for own in zip(decoded.positions, decoded.colours, strict=True) if len(own[0])]
    for (points, colours), (expected, expected_colours) in zip(found, coded, strict=True):
        np.testing.assert_array_equal(points, expected)
        np.testing.assert_array_equal(colours, expected_colours)
    for own, back in zip(clouds.positions, decoded.positions, strict=True):
        assert (
            len(own) == len(back) == 0
            or max(KDTree(own).query(back)[0].max(), KDTree(back).query(own)[0].max()) <= bound_m
        )
