"""The measurements of section III: Table I, singular values, DCT spectra."""

from __future__ import annotations

import numpy as np

from mocodec.codecs.hou2014 import analysis
from mocodec.motion import Motion


def test_matrix_has_all_x_then_all_y_then_all_z(walk: Motion):
    m = analysis.matrix(walk.positions)
    assert m.shape == (3 * walk.points, len(walk))
    assert np.array_equal(m[walk.points + 2], walk.positions[:, 2, 1])


def test_mean_variation_is_small_beside_total_deviation(walk: Motion):
    m = analysis.matrix(walk.positions)
    assert analysis.mean_variation(m) < 0.05 * analysis.total_deviation(m)


def test_mean_variation_and_total_deviation_of_a_ramp():
    ramp = np.arange(12.0).reshape(1, 12)
    assert np.isclose(analysis.mean_variation(ramp), 11 / 12)
    assert np.isclose(analysis.total_deviation(ramp), ramp.std())


def test_singular_values_of_clips_fall_faster_than_those_of_the_sequence(walk: Motion):
    m = analysis.matrix(walk.positions)
    of_sequence = analysis.singular_values(m)
    assert of_sequence[0] == 1
    assert all(analysis.singular_values(clip)[20] < of_sequence[20] for clip in analysis.random_clips(m, 60, 3))


def test_unfold_makes_each_clip_a_row(walk: Motion):
    assert analysis.unfold(analysis.matrix(walk.positions), 60).shape == (15, 60 * 3 * walk.points)


def test_rows_need_fewer_dct_coefficients_than_columns(walk: Motion):
    m = analysis.matrix(walk.positions)
    row = analysis.coefficients_for_energy(analysis.row_spectrum(m, 0))
    column = analysis.coefficients_for_energy(analysis.column_spectrum(m, 100))
    assert row / m.shape[1] < 0.5 * column / m.shape[0]
