"""bodycast on whole recordings: quality levels, unusual frames, outliers, several people, exact points, damage."""

from __future__ import annotations

import numpy as np
import pytest

import mocodec as mc
from mocodec import container
from mocodec.codecs.bodycast import Bodycast, integer_surface, tracking
from mocodec.codecs.bodycast.body_model import unpack_models
from mocodec.codecs.bodycast.chunk_payload import unpack_chunk
from mocodec.codecs.bodycast.decoder import SceneDecoder
from mocodec.codecs.bodycast.point_layer import PlacesEncoder
from mocodec.codecs.bodycast.point_scene import ChunkBodies
from mocodec.codecs.clouds import body_record
from mocodec.encoded import Chunk, Encoded
from mocodec.errors import BadInput, CannotEncode, Corrupt, MocodecError
from mocodec.geometry import articulation, body_tracking, skinning
from mocodec.metrics import point_clouds as measures
from mocodec.motion import Motion
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, corruption, sequences

pytest.importorskip("av")


@pytest.fixture(scope="module")
def performance() -> sequences.Performance:
    return sequences.jumping_jacks(actors.capsules(), 8)


@pytest.fixture(scope="module")
def clouds(performance) -> PointClouds:
    return sequences.record(performance, 2500, seed=1)


@pytest.fixture(scope="module")
def encoded(performance, clouds) -> dict[float, Encoded[PointClouds]]:
    skeleton = performance.skeleton()
    return {r: Bodycast(residual=r, skeleton=skeleton, chunk_frames=3).encode(clouds) for r in (0, 70)}


def test_error_is_near_the_resampling_floor(performance, clouds, encoded):
    floor = measures.d1(clouds, sequences.record(performance, 2500, seed=9), 6)
    assert measures.d1(clouds, Bodycast.decode(encoded[0]), 6) < 1.6 * floor
    assert sum(len(c.payload) for c in encoded[0].chunks) < clouds.raw_bytes / 1000


@pytest.fixture(scope="module")
def small(clouds) -> PointClouds:
    """Three frames of a quarter of the points."""
    return thinned(clouds[:3], 4)


def thinned(clouds: PointClouds, step: int) -> PointClouds:
    """One of `step` points of every frame."""
    assert clouds.colours is not None
    return PointClouds([p[::step] for p in clouds.positions], 15.0, [c[::step] for c in clouds.colours])


def test_more_residual_is_less_error_for_more_bytes(performance, clouds):
    few = thinned(clouds[:2], 2)
    skeleton = performance.skeleton()
    residuals = (0, 25, 26, 75, 100, "exact")
    files = [Bodycast(residual=r, skeleton=skeleton).encode(few) for r in residuals]
    sizes = [sum(map(len, f.shared)) + f.payload_bytes for f in files]
    errors = [measures.errors(few, Bodycast.decode(f)) for f in files]
    assert sizes == sorted(sizes)
    assert [e.d1 for e in errors] == sorted((e.d1 for e in errors), reverse=True)
    for file, error in zip(files[2:-1], errors[2:-1], strict=True):
        assert error.max_error <= file.promise["max_error"]
    assert errors[-2].max_error <= 1e-4
    assert errors[-1].max_error == 0


def test_residual_and_psnr_go_together(performance, clouds):
    encoded = Bodycast(residual=80, psnr=40, skeleton=performance.skeleton()).encode(clouds[:1])
    found = measures.errors(clouds[:1], Bodycast.decode(encoded))
    assert encoded.promise.keys() == {"max_error", "psnr"}
    assert found.max_error <= encoded.promise["max_error"]
    assert found.psnr >= 40


def test_tracked_joints_are_near_the_true_joints(performance, encoded):
    motion = Bodycast.track(encoded[0])
    column = motion.names.index("LeftForeArm")
    truth = performance.joints[:, performance.actor.names.index("LeftForeArm")]
    assert np.linalg.norm(motion.positions[:, column] - truth, axis=1).mean() < 0.03


def test_same_bytes_twice(performance, clouds, encoded):
    again = Bodycast(residual=70, skeleton=performance.skeleton(), chunk_frames=3).encode(clouds)
    assert again.shared == encoded[70].shared
    assert [c.payload for c in again.chunks] == [c.payload for c in encoded[70].chunks]


@pytest.mark.parametrize("frames", [slice(0, 3), slice(2, 5), slice(7, 8), slice(4, 4)])
@pytest.mark.parametrize("residual", [0, 70])
def test_slice_of_decode_is_decode_of_slice(encoded, frames, residual):
    whole, part = Bodycast.decode(encoded[residual]), Bodycast.decode(encoded[residual], frames)
    assert len(part) == frames.stop - frames.start
    for i, frame in enumerate(range(frames.start, frames.stop)):
        np.testing.assert_array_equal(part.positions[i], whole.positions[frame])


def test_round_trip_through_a_file(encoded, clouds):
    decoded = mc.decode(container.pack(encoded[70]))
    assert isinstance(decoded, PointClouds)
    assert len(decoded) == len(clouds)
    assert decoded.rate == clouds.rate


def test_frames_with_few_points_or_gaps(performance, clouds):
    assert clouds.colours is not None
    positions, colours = list(clouds.positions), list(clouds.colours)
    for frame, few in ((2, 0), (4, 3)):
        positions[frame], colours[frame] = positions[frame][:few], colours[frame][:few]
    positions[5] = positions[5].copy()
    positions[5][::7] = np.nan
    decoded = Bodycast.decode(Bodycast(skeleton=performance.skeleton()).encode(PointClouds(positions, 15.0, colours)))
    assert [len(decoded.positions[f]) for f in (2, 4)] == [0, 3]
    assert measures.d1(clouds, decoded, 7) < 0.05


def test_without_colours_and_skeleton(clouds):
    grey = PointClouds(clouds.positions[:3], 15.0)
    decoded = Bodycast.decode(Bodycast().encode(grey))
    assert decoded.colours is None
    assert measures.d1(grey, decoded, 2) < 0.05


def test_outliers_are_coded_unless_switched_off(performance, clouds):
    assert clouds.colours is not None
    rng = np.random.default_rng(3)
    box = rng.uniform([1.2, 0.0, 0.0], [1.5, 0.4, 0.005], (700, 3))
    positions = [np.concatenate([p, box]) for p in clouds.positions[:4]]
    colours = [np.concatenate([c, np.full((700, 3), 90, np.uint8)]) for c in clouds.colours[:4]]
    both = PointClouds(positions, 15.0, colours)
    decoded = Bodycast.decode(Bodycast(skeleton=performance.skeleton()).encode(both))
    assert (decoded.positions[3][:, 0] > 1.15).sum() > 300
    alone = Bodycast.decode(Bodycast(skeleton=performance.skeleton(), strangers=False).encode(both))
    assert (alone.positions[3][:, 0] > 1.15).sum() == 0


def test_two_people_have_two_bodies(performance, clouds):
    """The second person stands beside the first, then leaves; frames with either number of people decode."""
    assert clouds.colours is not None
    aside = np.array([1.6, 0.0, 0.3])
    positions = [np.concatenate([p, p[::2] + aside]) if i < 6 else p for i, p in enumerate(clouds.positions)]
    colours = [np.concatenate([c, 255 - c[::2]]) if i < 6 else c for i, c in enumerate(clouds.colours)]
    both = PointClouds(positions, 15.0, colours)
    first = performance.skeleton()
    second = Motion(first.positions + aside, first.rate, first.names, "y", first.skeleton, first.rotations)
    encoded = Bodycast(skeleton=[first, second], chunk_frames=5).encode(both)
    assert len(encoded.shared) == 2
    decoded = Bodycast.decode(encoded)
    assert max(measures.d1(both, decoded, i) for i in (0, 3, 5, 7)) < 0.06
    assert (decoded.positions[4][:, 0] > 1.0).sum() > 800
    assert (decoded.positions[7][:, 0] > 1.0).sum() == 0
    apart = Bodycast.track(encoded, body=1).positions[3] - Bodycast.track(encoded).positions[3]
    assert np.linalg.norm(apart - aside, axis=1).max() < 0.2
    with pytest.raises(BadInput, match="2 bodies"):
        Bodycast.track(encoded, body=2)
    alone = Bodycast.decode(Bodycast(skeleton=first, people=1).encode(both[:5]))
    assert (alone.positions[4][:, 0] > 1.0).sum() > 300  # as outliers


def test_exact_points(clouds, performance):
    assert clouds.colours is not None
    few = PointClouds([p[:900] for p in clouds.positions[:4]], 15.0, [c[:900] for c in clouds.colours[:4]])
    encoded = Bodycast(residual="exact", skeleton=performance.skeleton(), chunk_frames=3).encode(few)
    decoded = mc.decode(container.pack(encoded))
    assert decoded.colours is not None
    assert few.colours is not None
    for i in range(4):
        was = np.concatenate([few.positions[i].astype(np.float32), few.colours[i]], axis=1)
        now = np.concatenate([decoded.positions[i].astype(np.float32), decoded.colours[i]], axis=1)
        np.testing.assert_array_equal(was[np.lexsort(was.T)], now[np.lexsort(now.T)])
    assert len(Bodycast.track(encoded)) == 4
    rough = Bodycast(residual="exact", precision=0.002, skeleton=performance.skeleton()).encode(few)
    assert rough.payload_bytes < 0.6 * encoded.payload_bytes
    assert measures.d1(few, Bodycast.decode(rough), 2) < 0.002


def test_links_of_template_points_are_learned_from_motion(performance, clouds):
    assert clouds.colours is not None
    person = tracking.PersonTracker((clouds.positions[0], clouds.colours[0]), performance.skeleton(), "y", 1000)
    frames = list(zip(clouds.positions, clouds.colours, strict=True))
    poses = [person.tracker.pose, *(person.fit(cloud, i).pose for i, cloud in enumerate(frames) if i)]
    tracker, body = person.tracker, person.body
    arm = [i for i, name in enumerate(body.names) if name.startswith("Left") and "Arm" in name]
    rows = np.flatnonzero(np.isin(tracker.skin.links[:, 0], arm))[::3]
    wrong = tracker.skin.links[:, 0].copy()
    wrong[rows] = body.names.index("Spine")  # as if the sleeve had touched the trunk
    skin = skinning.skin(body, tracker.skin.points, wrong)
    person.tracker = body_tracking.BodyTracker(body, skin, tracker.normals, tracker.colours, tracker.settings)
    person.learn_links(frames, poses)
    learned = person.tracker.skin.links[rows, 0]
    assert np.mean(learned == body.names.index("Spine")) < 0.1


def test_refined_poses_fit_and_small_links_stay_near_the_first_pose(performance, clouds):
    assert clouds.colours is not None
    person = tracking.PersonTracker((clouds.positions[0], clouds.colours[0]), performance.skeleton(), "y", 1000)
    body, data = person.body, person.dense_data((clouds.positions[0], clouds.colours[0]), 0)
    owners = np.bincount(person.tracker.skin.links[:, 0], minlength=len(body))
    end = min((link for link in range(len(body)) if link not in body.parents and owners[link]), key=lambda i: owners[i])
    assert owners[end] < tracking.SMALL_SHARE * owners.sum()
    forearm = body.names.index("LeftForeArm")
    for link, turn in ((forearm, 0.12 * np.cross(body.axes[forearm], [0, 0, 1.0])), (end, 0.5 * body.axes[end])):
        pose = articulation.Pose.canonical(len(body))
        pose.rotations[link] = articulation.exp(turn)
        left = articulation.log(person.refine_pose(data, pose).rotations[link])
        assert np.linalg.norm(left) < 0.5 * np.linalg.norm(turn)


def test_number_of_decoded_points(performance, clouds):
    encoded = Bodycast(points=700, skeleton=performance.skeleton()).encode(clouds[:3])
    assert [len(p) for p in Bodycast.decode(encoded).positions] == [700] * 3


def test_surface_is_written_as_glb(encoded, tmp_path):
    motion, surface = Bodycast.track(encoded[0]), Bodycast.surface(encoded[0])
    mc.write(tmp_path / "body.glb", motion, surface=surface)
    back = mc.read(tmp_path / "body.glb")
    assert isinstance(back, Motion)
    assert np.abs(back.positions - motion.positions).max() < 1e-4


def test_clouds_in_millimetres_are_refused(clouds):
    with pytest.raises(CannotEncode, match="metres"):
        Bodycast().encode(PointClouds([p * 1000 for p in clouds.positions[:2]], 15.0))


def test_every_prefix_and_flipped_byte_of_a_file_is_an_error(performance, small):
    grey = PointClouds(small.positions, 15.0)
    blob = container.pack(Bodycast(cells=300, skeleton=performance.skeleton()).encode(grey))
    for cut in corruption.prefixes(blob, every=1 + len(blob) // 400):
        with pytest.raises(MocodecError):
            mc.decode(cut)
    for at, broken in corruption.flips(blob, every=1 + len(blob) // 400):
        try:
            mc.decode(broken)
        except MocodecError:
            continue
        pytest.fail(f"byte {at} of {len(blob)} flipped without an error")


def test_unusable_input_is_refused(clouds):
    with pytest.raises(CannotEncode, match="no body"):
        Bodycast().encode(PointClouds([np.zeros((0, 3))] * 3, 15.0))
    with pytest.raises(CannotEncode, match="not motions"):
        Bodycast().encode(Motion(np.zeros((2, 1, 3)), 30.0))  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="percentage"):
        Bodycast(residual=-1).encode(clouds)


def test_damaged_bytes_raise_corrupt_or_decode(performance, small):
    rng = np.random.default_rng(4)
    original = Bodycast(residual=70, skeleton=performance.skeleton()).encode(small)
    for _ in range(30):
        shared, payload = bytearray(original.shared[0]), bytearray(original.chunks[0].payload)
        target = shared if rng.random() < 0.5 else payload
        if rng.random() < 0.3:
            del target[rng.integers(0, len(target)) :]
        else:
            target[rng.integers(0, len(target))] ^= int(rng.integers(1, 256))
        broken = Encoded("bodycast", original.about, [Chunk(0, 3, bytes(payload))], (bytes(shared),))
        try:
            Bodycast.decode(broken)
        except MocodecError as error:
            assert isinstance(error, Corrupt)  # noqa: PT017


@pytest.mark.parametrize("settings", [{"max_error": 0.01}, {"residual": "exact"}])
def test_an_encoder_codes_points_from_the_very_bodies_that_a_decoder_reads(settings, monkeypatch):
    coded = list[ChunkBodies]()
    begin = PlacesEncoder.__init__

    def recorded(self, grid, frames, bodies, *rest, **named):
        coded.append(bodies)
        begin(self, grid, frames, bodies, *rest, **named)

    monkeypatch.setattr(PlacesEncoder, "__init__", recorded)
    performance = sequences.turning(actors.capsules(), 8).moved((7000.0, -300.0, 5000.0))  # where floats are coarse
    clouds = sequences.record(performance, 200, seed=3)
    encoded = Bodycast(skeleton=performance.skeleton(), **settings).encode(clouds)
    scene, streams = SceneDecoder(unpack_models(encoded.shared), coloured=True), unpack_chunk(encoded.chunks[0], 1)
    own, read = coded[-1], ChunkBodies(scene.textures, scene._poses(streams, len(clouds)), streams.is_absent)
    np.testing.assert_array_equal(own.textures[0].canonical, read.textures[0].canonical)
    for k in range(len(clouds)):
        np.testing.assert_array_equal(own.pose_values(k), read.pose_values(k))
    assert len(Bodycast.decode(encoded)) == len(clouds)


@pytest.mark.parametrize("largest", [1.0, 1e9])
def test_values_keep_some_floats_from_the_border(largest):
    values = largest + np.array([0, 1 - 1 / 64 - 2 * np.spacing(largest)])
    shift = integer_surface.rounding_shift(values)
    for change in (-4, 4):
        moved = values + change * np.spacing(largest)
        np.testing.assert_array_equal(integer_surface.rounded(moved, shift), integer_surface.rounded(values, shift))


def test_a_body_that_no_decoder_would_read_is_refused(performance, small, monkeypatch):
    monkeypatch.setattr(body_record, "MAX_LINKS", 3)
    with pytest.raises(CannotEncode, match="cannot store this body"):
        Bodycast(max_error=0.01, skeleton=performance.skeleton()).encode(small)
