"""Bases learned from the recording."""

import numpy as np

from mocodec.codecs.tempo.models import stored_basis


def test_squares_beside_a_basis_of_samples_within_it_and_beside_it() -> None:
    random = np.random.default_rng(1)
    columns = np.linalg.qr(random.normal(size=(12, 4)))[0]
    within = random.normal(size=(3, 4)) @ columns.T
    spectrum = np.concatenate([random.normal(size=(5, 12)), within + 1e-9 * random.normal(size=(3, 12)), 0 * within])
    rest = spectrum - (spectrum @ columns) @ columns.T
    found = stored_basis._squares_beside(columns, spectrum)
    np.testing.assert_allclose(found, (rest**2).sum(axis=1), rtol=1e-9)
