"""Behaviour that all point cloud codecs share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import encode, not_kept
from mocodec.codecs.bodycast import Bodycast
from mocodec.codecs.lien2006 import Lien2006
from mocodec.errors import CannotEncode
from mocodec.metrics import point_clouds as measures
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

pytest.importorskip("av")
pytest.importorskip("PIL")


@pytest.mark.parametrize("codec", ["tempo", "hou2014", "liu2006", "lossless"])
def test_codecs_of_motions_refuse_point_clouds(codec):
    with pytest.raises(CannotEncode, match=f"{codec} codes motions, not point clouds"):
        encode(PointClouds([np.zeros((4, 3))], 15.0), codec)


@pytest.mark.parametrize("codec", [Bodycast(), Lien2006(residual=25)], ids=lambda codec: codec.name)
@pytest.mark.parametrize("far", [1e6, 1e20, 1e200])
def test_points_far_from_the_origin_are_ignored(codec, far):
    performance = sequences.jumping_jacks(actors.capsules(), 8)
    clouds = sequences.record(performance, 2000, seed=1)
    codec = replace(codec, skeleton=performance.skeleton())
    positions = [points.copy() for points in clouds.positions[:4]]
    positions[1][5], positions[2] = far, positions[2] * far
    decoded = codec.decode(codec.encode(PointClouds(positions, 15.0)))
    assert measures.d1(clouds, decoded, 1) < 0.05
    assert len(decoded.positions[2]) == 0
    assert measures.d1(clouds, decoded, 3) < 0.06
    with pytest.raises(CannotEncode, match="no body"):
        codec.encode(PointClouds([points * far for points in clouds.positions[:2]], 15.0))


def test_normals_are_named_as_not_kept():
    points = np.zeros((4, 3))
    assert not_kept(PointClouds([points], 15.0)) == []
    assert not_kept(PointClouds([points], 15.0, normals=[points + 1])) == ["the normals of the points"]
