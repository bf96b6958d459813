"""DCT along time: orthonormal, and truncation leaves the best approximation in its frequencies."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.stages import dct

FRAMES = (1, 2, 3, 50, 51, dct.MATRIX_FRAMES, dct.MATRIX_FRAMES + 1, 3000)
"""Even and odd, by matrix and by FFT."""


@pytest.mark.parametrize("frames", FRAMES)
def test_it_is_the_orthonormal_dct_2_of_the_definition(frames: int):
    samples = np.random.default_rng(frames).normal(size=(frames, 2))
    frequency, at = np.arange(frames)[:, None], np.arange(frames)
    matrix = np.cos(np.pi / frames * (at + 0.5) * frequency) * np.sqrt(2 / frames)
    matrix[0] /= np.sqrt(2)
    assert np.allclose(dct.forward(samples), matrix @ samples, atol=1e-11)


@pytest.mark.parametrize("frames", FRAMES)
def test_all_frequencies_give_the_samples_back(frames: int):
    samples = np.random.default_rng(0).normal(size=(frames, 4, 3))
    assert np.allclose(dct.inverse(dct.forward(samples), frames), samples, atol=1e-12)


@pytest.mark.parametrize("frames", [50, 51, 2000])
def test_energy_is_the_same_on_both_sides(frames: int):
    samples = np.random.default_rng(1).normal(size=(frames, 4))
    spectrum = dct.forward(samples)
    assert np.isclose((samples**2).sum(), (spectrum**2).sum())
    left_out = samples - dct.inverse(dct.forward(samples, 20), frames)
    assert np.isclose((left_out**2).sum(), (spectrum[20:] ** 2).sum())


@pytest.mark.parametrize("frames", [7, 50, 2000])
def test_along_another_axis(frames: int):
    samples = np.random.default_rng(2).normal(size=(3, frames, 4))
    spectrum = dct.forward(samples, 6, axis=1)
    assert spectrum.shape == (3, 6, 4)
    assert np.allclose(spectrum[1], dct.forward(samples[1], 6), atol=1e-13)
    assert np.allclose(dct.inverse(spectrum, frames, axis=1)[2], dct.inverse(spectrum[2], frames), atol=1e-13)


def test_a_single_curve():
    curve = np.random.default_rng(3).normal(size=40)
    assert np.allclose(dct.inverse(dct.forward(curve), 40), curve, atol=1e-13)


def test_no_frequencies_are_zeros_and_no_frames_are_none():
    assert np.array_equal(dct.inverse(np.zeros((2, 0, 3)), 5, axis=1), np.zeros((2, 5, 3)))
    assert dct.forward(np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize(
    ("frames", "known"), [(1, 1), (51, 20), (70, 70), (1500, 90), (1500, 1400), (64, 0), (1500, 0)]
)
def test_panels_are_the_inverse(frames: int, known: int):
    rng = np.random.default_rng(frames)
    spectra = rng.normal(size=(2, known, 37))
    spectra *= np.arange(known)[:, None] < np.linspace(known, 0, 37)  # columns of falling bandwidth
    out = np.ones((2, frames, 38))
    dct.inverse_panels(spectra, out)
    assert np.allclose(out[..., :37], dct.inverse(spectra, frames, axis=1), atol=1e-11)
    assert (out[..., 37] == 1).all()


@pytest.mark.parametrize(("frames", "known"), [(1, 1), (51, 20), (70, 70), (1500, 90)])
def test_inverse_of_runs_by_the_matrix(frames: int, known: int):
    spectra = np.random.default_rng(frames).normal(size=(2, known, 5))
    out = np.empty((2, frames, 5))
    dct.inverse_runs(spectra, out)
    assert np.allclose(out, dct.inverse(spectra, frames, axis=1), atol=1e-11)
