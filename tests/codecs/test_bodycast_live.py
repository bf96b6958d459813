"""Bodycast live: packets out, points in, with losses on the way."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.bodycast.live import Receiver, Sender
from mocodec.errors import Corrupt
from mocodec.metrics import point_clouds as measures
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

pytest.importorskip("av")


@pytest.fixture(scope="module")
def sent():
    performance = sequences.jumping_jacks(actors.capsules(), 20)
    clouds = sequences.record(performance, 2000, seed=1)
    assert clouds.colours is not None
    sender = Sender(skeleton=performance.skeleton())
    return clouds, [sender.push(p, c) for p, c in zip(clouds.positions, clouds.colours, strict=True)]


def off(clouds, frame, cloud) -> float:
    return measures.d1(clouds[frame : frame + 1], PointClouds([cloud[0]], 15.0), 0)


def test_a_packet_a_frame_and_small(sent):
    clouds, packets = sent
    assert [len(p) for p in packets] == [2] + [1] * 19
    assert np.mean([len(p[0]) for p in packets[1:]]) < 45
    receiver = Receiver()
    for frame, group in enumerate(packets):
        shown = [cloud for packet in group if (cloud := receiver.push(packet)) is not None]
        assert len(shown) == 1
        assert off(clouds, frame, shown[0]) < 0.05


def test_losses_are_concealed_and_end_with_the_next_packet(sent):
    clouds, packets = sent
    receiver = Receiver()
    lost, need_them = (5, 6, 11), (7,)
    for frame, group in enumerate(packets):
        cloud = receiver.conceal() if frame in lost else [receiver.push(packet) for packet in group][-1]
        assert cloud is not None
        assert off(clouds, frame, cloud) < (0.25 if frame in lost + need_them else 0.05)


def test_a_lost_key_pose_is_waited_for(sent):
    clouds, packets = sent
    receiver = Receiver()
    for packet in packets[0]:
        receiver.push(packet)
    before = receiver.number
    assert receiver.push(packets[17][0]) is not None  # its key pose, frame 16, did not come
    assert receiver.number == before
    receiver.push(packets[16][0])
    assert off(clouds, 18, receiver.push(packets[18][0])) < 0.05


def test_late_joiners_twice_and_nobody(sent):
    clouds, packets = sent
    receiver = Receiver()
    assert receiver.push(packets[4][0]) is None
    for packet in packets[0]:
        receiver.push(packet)
    assert off(clouds, 4, receiver.push(packets[4][0])) < 0.05
    assert receiver.push(packets[4][0]) is not None
    sender = Sender()
    [nobody] = sender.push(np.full((30, 3), np.nan))
    assert sender.model == b""
    cloud = receiver.push(nobody)
    assert cloud is not None
    assert len(cloud[0]) == 0


def test_pictures_change_the_surface_and_may_be_lost():
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


def test_damaged_packets_do_not_end_it(sent):
    clouds, packets = sent
    receiver = Receiver()
    for packet in packets[0]:
        receiver.push(packet)
    with pytest.raises(Corrupt):
        receiver.push(b"\x09\x01")
    with pytest.raises(Corrupt):
        receiver.push(packets[1][0][:3])
    assert off(clouds, 2, receiver.push(packets[2][0])) < 0.05
