"""The model of one segment: the number of principal components."""

from __future__ import annotations

import numpy as np

from mocodec.codecs.liu2006 import segment_model


def test_components_needed_is_the_smallest_number_within_the_tolerance() -> None:
    variances = np.array([16.0, 9.0, 4.0, 1.0])
    assert segment_model.components_needed(variances, 10.0, 1) == 0
    assert segment_model.components_needed(variances, 2.5, 1) == 2
    assert segment_model.components_needed(variances, 2.5 / 2**0.5, 2) == 2
    assert segment_model.components_needed(variances, 1e-9, 1) == 4
