"""Bodycast live: packets out, points in, with losses on the way."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.bodycast.live import Receiver, Sender
from mocodec.errors import Corrupt
from mocodec.evaluation.cloud import actors, measures, sequences
from mocodec.pointcloud import PointClouds

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
    assert np.mean([len(p[0]) for p in packets[1:]]) < 90
    receiver = Receiver()
    for frame, group in enumerate(packets):
        shown = [cloud for packet in group if (cloud := receiver.push(packet)) is not None]
        assert len(shown) == 1
        assert off(clouds, frame, shown[0]) < 0.05


def test_losses_are_concealed_and_end_with_the_next_packet(sent):
    clouds, packets = sent
    receiver = Receiver()
    for frame, group in enumerate(packets):
        if frame in (5, 6, 11):
            cloud = receiver.conceal()
            assert cloud is not None
            assert off(clouds, frame, cloud) < 0.25
            continue
        cloud = [receiver.push(packet) for packet in group][-1]
        assert cloud is not None
        assert off(clouds, frame, cloud) < 0.05


def test_a_lost_key_pose_is_waited_for(sent):
    clouds, packets = sent
    receiver = Receiver()
    for packet in packets[0]:
        receiver.push(packet)
    before = receiver.number
    assert receiver.push(packets[16][0]) is not None  # its key pose, frame 15, did not come
    assert receiver.number == before
    receiver.push(packets[15][0])
    assert off(clouds, 17, receiver.push(packets[17][0])) < 0.05


def test_late_joiners_twice_and_nobody(sent):
    clouds, packets = sent
    receiver = Receiver()
    assert receiver.push(packets[4][0]) is None
    for packet in packets[0]:
        receiver.push(packet)
    assert off(clouds, 3, receiver.push(packets[3][0])) < 0.05
    assert receiver.push(packets[3][0]) is not None
    sender = Sender()
    [nobody] = sender.push(np.full((30, 3), np.nan))
    assert sender.model == b""
    cloud = receiver.push(nobody)
    assert cloud is not None
    assert len(cloud[0]) == 0


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
