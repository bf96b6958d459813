"""Left transforms learned from many recordings: Algorithm 1, sharing between files, marker sets, memory limit."""

from __future__ import annotations

import numpy as np
import pytest

import mocodec as mc
from mocodec import metrics
from mocodec.codecs.hou2014 import Hou2014, Hou2014Database
from mocodec.errors import BadInput
from mocodec.motion import Motion
from mocodec.testing import synthetic


@pytest.fixture(scope="module")
def walks() -> list[Motion]:
    return [synthetic.markers(frames=420, seed=seed) for seed in range(5)]


def test_files_share_the_learned_transforms_and_have_smaller_payloads(walks: list[Motion]):
    learned = Hou2014Database(transforms=2, clip_frames=140).fit(walks[:4])
    encoded = [learned.codec(walk, mean_error=0.003).encode(walk) for walk in walks]
    assert len({one.shared[1:] for one in encoded}) == 1
    fitted_to_file = Hou2014(mean_error=0.003).encode(walks[4])
    size = len(encoded[4].shared[0]) + sum(len(c.payload) for c in encoded[4].chunks)
    assert size < fitted_to_file.payload_bytes
    for walk, one in zip(walks, encoded, strict=True):
        assert metrics.mean_distance(walk.positions, Hou2014.decode(one).positions) <= 0.003


def test_file_with_learned_transforms_decodes_alone(walks: list[Motion]):
    learned = Hou2014Database(transforms=2).fit(walks[:3])
    blob = mc.encode(walks[4], codec=learned.codec(walks[4], max_error=0.005))
    assert metrics.distances(walks[4].positions, mc.decode(blob).positions).max() <= 0.005
    assert "transforms" not in mc.open(blob).encoded.settings


def test_annealing_separates_two_subspaces_and_converges():
    rng = np.random.default_rng(5)
    subspaces = [np.linalg.qr(rng.normal(size=(30, 4)))[0] for _ in range(2)]
    time = np.linspace(0, 1, 280)
    motions = []
    for i in range(24):
        curves = sum(rng.normal(size=(1, 4)) * np.cos(np.pi * f * time)[:, None] for f in range(1, 8))
        motions.append(Motion((curves @ subspaces[i % 2].T).reshape(280, 10, 3), 120.0))
    learned = Hou2014Database(transforms=2, components=4, tolerance=1e-6).fit(motions)
    (annealing,) = learned.annealings.values()
    assert annealing.converged
    assert annealing.iterations <= 30
    assert len(set(annealing.transform_index[::2])) == len(set(annealing.transform_index[1::2])) == 1
    assert annealing.transform_index[0] != annealing.transform_index[1]
    assert annealing.distortions[-1] < 1e-3 * annealing.distortions[0]


def test_each_marker_set_has_its_own_transforms(walks: list[Motion]):
    other = synthetic.joints(frames=300, seed=1)
    learned = Hou2014Database(transforms=1).fit([walks[0], other])
    assert set(learned.transforms) == {walks[0].names, other.names}
    assert learned.codec(walks[1].select(walks[1].names[:4])).transforms == ()


def test_fit_without_motions_raises_bad_input():
    with pytest.raises(BadInput):
        Hou2014Database().fit([])


def test_spectra_in_a_temporary_file_give_the_same_transforms(walks: list[Motion]):
    progress: list[tuple[str, int, int]] = []
    in_memory = Hou2014Database(transforms=2).fit(walks, lambda *event: progress.append(event))
    in_file = Hou2014Database(transforms=2, memory_bytes=20_000).fit(walks)
    assert in_memory.transforms == in_file.transforms
    assert progress[0] == ("reading", 1, 5)
