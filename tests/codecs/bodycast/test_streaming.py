"""Live use of bodycast: packets out, points in, with losses on the way."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.bodycast.streaming import Receiver, Sender, with_checksum
from mocodec.errors import BadInput, Corrupt
from mocodec.metrics import point_clouds as measures
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

pytest.importorskip("av")


@pytest.fixture(scope="module")
def recording():
    performance = sequences.jumping_jacks(actors.capsules(), 20)
    clouds = sequences.record(performance, 2000, seed=1)
    assert clouds.colours is not None
    sender = Sender(skeleton=performance.skeleton())
    return clouds, [sender.push(p, c) for p, c in zip(clouds.positions, clouds.colours, strict=True)]


def distance(clouds, frame, cloud) -> float:
    return measures.d1(clouds[frame : frame + 1], PointClouds([cloud[0]], 15.0), 0)


def test_one_small_packet_per_frame(recording):
    clouds, packets = recording
    assert [len(p) for p in packets] == [2] + [1] * 19
    assert np.mean([len(p[0]) for p in packets[1:]]) < 45
    receiver = Receiver()
    for frame, group in enumerate(packets):
        shown = [cloud for packet in group if (cloud := receiver.push(packet)) is not None]
        assert len(shown) == 1
        assert distance(clouds, frame, shown[0]) < 0.05


def test_losses_are_concealed_until_the_next_decodable_packet(recording):
    clouds, packets = recording
    receiver = Receiver()
    lost, dependent = (5, 6, 11), (7,)
    for frame, group in enumerate(packets):
        cloud = receiver.conceal() if frame in lost else [receiver.push(packet) for packet in group][-1]
        assert cloud is not None
        assert distance(clouds, frame, cloud) < (0.25 if frame in lost + dependent else 0.05)


def test_poses_after_a_lost_key_pose_are_concealed_until_it_arrives(recording):
    clouds, packets = recording
    receiver = Receiver()
    for packet in packets[0]:
        receiver.push(packet)
    before = receiver.frame
    assert receiver.push(packets[17][0]) is not None  # its key pose, frame 16, did not come
    assert receiver.frame == before
    assert receiver.push(packets[16][0]) is None  # later than the frame after it
    assert distance(clouds, 18, receiver.push(packets[18][0])) < 0.05


def test_late_joining_repeated_packets_and_frames_without_a_body(recording):
    clouds, packets = recording
    receiver = Receiver()
    assert receiver.push(packets[4][0]) is None
    for packet in packets[0]:
        receiver.push(packet)
    assert distance(clouds, 4, receiver.push(packets[4][0])) < 0.05
    assert receiver.push(packets[4][0]) is None
    sender = Sender()
    for _ in range(6):
        [no_body] = sender.push(np.full((30, 3), np.nan))
    assert sender.model == b""
    cloud = receiver.push(no_body)
    assert cloud is not None
    assert len(cloud[0]) == 0
    assert receiver.push(no_body) is None


def test_repeated_and_late_packets_change_nothing_that_is_shown(recording):
    """A channel that repeats every packet, and the one before it, shows what a perfect channel shows."""
    _, packets = recording
    once, twice = Receiver(), Receiver()
    for frame, group in enumerate(packets):
        for packet in group:
            expected = once.push(packet)
            shown = twice.push(packet)
            assert (shown is None) == (expected is None)
            if expected is not None:
                np.testing.assert_array_equal(shown[0], expected[0])
            earlier = packets[frame - 1] if frame else []
            assert [twice.push(again) for again in (packet, *earlier, packets[0][0])].count(None) == 2 + len(earlier)
    assert twice.frame == once.frame == len(packets) - 1
    np.testing.assert_array_equal(twice.conceal()[0], once.conceal()[0])


def test_a_repeated_packet_without_its_reference_is_concealed_once(recording):
    _, packets = recording
    receiver = Receiver()
    for packet in [*packets[0], packets[1][0], packets[2][0]]:
        receiver.push(packet)
    assert receiver.push(packets[17][0]) is not None  # its key pose, frame 16, did not come
    pose = receiver.pose
    assert receiver.push(packets[17][0]) is None
    assert receiver.pose is pose


def test_a_late_pose_is_the_reference_of_later_ones(recording):
    clouds, packets = recording
    receiver = Receiver()
    for packet in [*packets[0], packets[1][0], packets[3][0]]:  # frame 3 refers to frame 2
        receiver.push(packet)
    assert receiver.push(packets[2][0]) is None
    assert receiver.push(packets[17][0]) is not None
    assert receiver.push(packets[16][0]) is None  # late key pose
    assert distance(clouds, 18, receiver.push(packets[18][0])) < 0.05


def test_another_model_starts_another_stream(recording):
    _, packets = recording
    receiver = Receiver()
    for packet in [*packets[0], packets[9][0]]:
        receiver.push(packet)
    performance = sequences.jumping_jacks(actors.capsules(), 2)
    other = sequences.record(performance, 1000, seed=3)
    sender = Sender(skeleton=performance.skeleton())
    shown = [receiver.push(packet) for packet in sender.push(other.positions[0], other.colours[0])]
    assert distance(other, 0, shown[-1]) < 0.05


def test_pictures_change_the_surface_and_do_not_depend_on_each_other():
    performance = sequences.jumping_jacks(actors.capsules(), 9)
    clouds = sequences.record(performance, 2000, seed=1)
    assert clouds.colours is not None
    sender = Sender(skeleton=performance.skeleton(), picture_every=4)
    colours = [np.full_like(c, 200) if i > 3 else c for i, c in enumerate(clouds.colours)]  # the light goes on
    packets = [sender.push(p, c) for p, c in zip(clouds.positions, colours, strict=True)]
    assert [len(group) for group in packets] == [3, 1, 1, 1, 2, 1, 1, 1, 2]
    bright = dict[tuple[int, ...], float]()
    for kept in ((0, 4, 8), (0, 8), (0,)):
        receiver, shown = Receiver(), None
        for frame, group in enumerate(packets):
            for packet in group:
                if packet[0] == 4 and frame not in kept:
                    continue
                shown = receiver.push(packet) or shown
        assert shown is not None
        assert shown[1] is not None
        bright[kept] = float(shown[1].mean())
    assert bright[0, 4, 8] == bright[0, 8]
    assert bright[0, 8] > 1.5 * bright[0,]


def test_decoding_goes_on_after_damaged_packets(recording):
    clouds, packets = recording
    receiver = Receiver()
    for packet in packets[0]:
        receiver.push(packet)
    with pytest.raises(Corrupt):
        receiver.push(b"\x09\x01")
    with pytest.raises(Corrupt):
        receiver.push(packets[1][0][:3])
    assert distance(clouds, 2, receiver.push(packets[2][0])) < 0.05


BOUND = 0.004


@pytest.fixture(scope="module")
def bounded():
    """Eight frames within a bound, coloured; frame 3 is empty and frame 5 shows twenty points only."""
    performance = sequences.jumping_jacks(actors.capsules(), 8)
    clouds = sequences.record(performance, 1500, seed=2)
    assert clouds.colours is not None
    kept = {3: 0, 5: 20}
    frames = [
        (points[: kept.get(i, len(points))], colours[: kept.get(i, len(points))])
        for i, (points, colours) in enumerate(zip(clouds.positions, clouds.colours, strict=True))
    ]
    sender = Sender(skeleton=performance.skeleton(), max_error=BOUND)
    return frames, [sender.push(*frame) for frame in frames]


def farthest(one, other) -> float:
    """The largest distance of points from the nearest of the others, in both directions."""
    apart = np.linalg.norm(one[:, None] - other, axis=2)
    return float(max(apart.min(axis=0).max(), apart.min(axis=1).max()))


def test_packets_within_a_bound_carry_all_points_and_decode_alone(bounded):
    frames, packets = bounded
    for number, (points, colours) in enumerate(frames):
        receiver = Receiver()
        receiver.push(packets[0][0])
        cloud = receiver.push(packets[number][-1])
        assert cloud is not None
        assert cloud[1] is not None
        assert len(cloud[0]) == len(cloud[1])
        if len(points):
            assert farthest(points, cloud[0]) <= BOUND
            assert abs(float(cloud[1].mean()) - float(colours.mean())) < 3
        else:
            assert len(cloud[0]) == 0


def test_points_without_a_body_need_no_model_and_others_do(bounded):
    _, packets = bounded
    receiver = Receiver()
    assert receiver.push(packets[1][0]) is None
    assert receiver.conceal() is None
    cloud = receiver.push(packets[5][0])
    assert cloud is not None
    assert len(cloud[0]) > 0
    assert receiver.push(packets[3][0]) is None  # late


def test_a_lost_packet_of_points_is_concealed_by_the_surface(bounded):
    frames, packets = bounded
    receiver = Receiver()
    for packet in packets[0]:
        receiver.push(packet)
    receiver.push(packets[1][0])
    cloud = receiver.conceal()
    assert cloud is not None
    assert farthest(frames[2][0], cloud[0]) < 0.3


def test_points_of_no_person_are_within_the_bound_too():
    rng = np.random.default_rng(4)
    sender, receiver = Sender(max_error=BOUND), Receiver()
    for _ in range(2):
        points = rng.uniform(-0.3, 0.3, (400, 3)) * [1, 0.05, 1]
        [packet] = sender.push(points)
        cloud = receiver.push(packet)
        assert cloud is not None
        assert farthest(points, cloud[0]) <= BOUND
    assert sender.model == b""


def test_damaged_packets_of_points_raise(bounded):
    _, packets = bounded
    receiver = Receiver()
    receiver.push(packets[0][0])
    content = packets[1][0][:-2]
    for at in range(1, 40):
        for damaged in (content[:at], content[:at] + bytes([content[at] ^ 0xFF]) + content[at + 1 :]):
            try:
                receiver.push(with_checksum(damaged))
            except Corrupt:
                receiver._shown = 0
    assert receiver.push(packets[2][0]) is not None


def test_settings_that_cannot_be_used_are_refused():
    with pytest.raises(BadInput):
        Sender(max_error=-1.0)
    with pytest.raises(BadInput):
        Sender(cells=3)


def test_arrays_of_other_shapes_are_refused():
    points, colours = np.zeros((5, 3)), np.zeros((5, 3), np.uint8)
    for arrays in ((points[:, :2], None), (points, colours[:4]), (points.tolist(), colours), (points, colours / 255)):
        with pytest.raises(BadInput, match="of frame 0 must be"):
            Sender().push(*arrays)
