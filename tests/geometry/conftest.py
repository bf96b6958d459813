"""What the tests of tracking share."""

from __future__ import annotations

import pytest

from mocodec.geometry import articulated_icp, articulation, skinning
from mocodec.testing import actors, sequences


@pytest.fixture(scope="session")
def jumper():
    """A function: clouds of a jumping actor with this number of points, and its body, template and skin."""

    def made(points: int):
        performance = sequences.jumping_jacks(actors.capsules(), 4)
        clouds = sequences.record(performance, points, seed=2)
        actor = performance.actor
        assert clouds.colours is not None
        body = articulation.from_skeleton(actor.names, actor.parents, performance.joints[0])
        body, model = articulated_icp.make_model(body, clouds.positions[0], clouds.colours[0], by_surface=True)
        return clouds, body, model, skinning.skin(body, model.points, model.links)

    return made
