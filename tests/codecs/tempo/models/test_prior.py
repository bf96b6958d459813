"""The shipped prior."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.tempo.coding.rows import POSE
from mocodec.codecs.tempo.models import prior
from mocodec.errors import UnknownCodec


@pytest.mark.parametrize("known", [prior.for_points(), prior.for_directions()])
def test_the_prior_is_orthonormal_and_identified(known: prior.Prior) -> None:
    for statistics in (known.joints.statistics, *([known.bones.statistics] if known.bones else [])):
        for basis in statistics.bases:
            exact = 1e-5 if statistics is known.joints.statistics else 1e-2  # float16
            assert np.abs(basis @ basis.T - np.eye(len(basis))).max() < exact
        assert len(statistics.spreads) == len(statistics.means) == POSE + len(statistics.bases[0])
    assert prior.by_id(known.id) is known
    with pytest.raises(UnknownCodec):
        prior.by_id(b"nope")


def test_another_prior_encodes_while_it_is_installed() -> None:
    data = prior.packaged_bytes(prior.POINTS_FILE) + b"\0"
    with prior.installed(points=data) as (points, directions):
        assert prior.for_points() is points
        assert prior.for_directions() is directions
        assert points.id != prior._packaged(prior.POINTS_FILE).id
        assert prior.by_id(points.id) is points
    assert prior.for_points().id != points.id
