"""DCT along time: orthonormal, and truncation leaves the best approximation in its frequencies."""

from __future__ import annotations

import numpy as np

from mocodec.stages import dct


def test_all_frequencies_give_the_samples_back():
    samples = np.random.default_rng(0).normal(size=(3, 50, 4))
    assert np.allclose(dct.inverse(dct.forward(samples), 50), samples, atol=1e-12)


def test_energy_is_the_same_on_both_sides():
    samples = np.random.default_rng(1).normal(size=(50, 4))
    spectrum = dct.forward(samples)
    assert np.isclose((samples**2).sum(), (spectrum**2).sum())
    left_out = samples - dct.inverse(dct.forward(samples, 20), 50)
    assert np.isclose((left_out**2).sum(), (spectrum[20:] ** 2).sum())


def test_no_frequencies_are_zeros():
    assert np.array_equal(dct.inverse(np.zeros((2, 0, 3)), 5), np.zeros((2, 5, 3)))
