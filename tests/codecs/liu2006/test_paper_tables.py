"""Tables 2 and 3: counts of an encoded motion, global and piecewise PCA, and the paper's sequence 2."""

from __future__ import annotations

from pathlib import Path

import pytest

import mocodec
from mocodec.codecs.liu2006 import Liu2006, decoding, global_pca, marker_groups, paper_tables, piecewise_pca, statistics
from mocodec.motion import Motion
from mocodec.testing import synthetic

SEQUENCE_2 = Path(__file__).parents[3] / "../shared/data/cmu/c3d/85_12.c3d"


def test_statistics_agree_with_the_encoded_bytes() -> None:
    motion = synthetic.markers(300, seed=5)
    encoded = Liu2006().encode(motion)
    counts = statistics(encoded)
    assert counts.segments == len(encoded.chunks)
    assert sum(counts.bytes_by_part.values()) == encoded.payload_bytes
    assert counts.scalar_ratio == motion.positions.size / counts.scalars
    feet, others = counts.components[0]
    normalisation_scalars = 9 * counts.normalisation_control_points
    assert normalisation_scalars + 18 * (1 + feet) + 96 * (1 + others) < counts.scalars


def test_piecewise_pca_needs_fewer_components_than_global_pca() -> None:
    motion = synthetic.markers(300, seed=5)
    markers = marker_groups.assign(motion, (), ())
    for tolerance in (0.02, 0.005):
        of_sequence = global_pca(motion, markers, tolerance)
        of_segments = piecewise_pca(motion, markers, [slice(0, 150), slice(150, 300)], tolerance)
        assert len(of_sequence.components) == 1
        assert len(of_segments.components) == 2
        assert max(of_segments.components) <= of_sequence.components[0]
        assert 0 < of_segments.d_world < of_segments.d_normalised


@pytest.mark.skipif(
    not SEQUENCE_2.exists(), reason="the paper's sequence 2 is absent (../shared/data/cmu/c3d/85_12.c3d)"
)
def test_sequence_2_reaches_the_numbers_of_tables_2_and_3() -> None:
    """Table 2: 9 segments, 10.9 components, ratio 18.4 at d = 7.1 %. Table 3: ratios 3.7 and 5.0."""
    motion = mocodec.read(SEQUENCE_2)
    assert isinstance(motion, Motion)
    encoded = Liu2006().encode(motion)
    decoded = Liu2006.decode(encoded)
    markers = decoding.read_shared(encoded)[1]
    counts = statistics(encoded)
    assert abs(counts.segments - 9) <= 1
    assert abs(counts.average_components - 10.9) <= 1
    assert counts.scalar_ratio >= 18.4
    assert paper_tables.d_normalised(motion, decoded.positions, markers) <= 7.1
    assert motion.raw_bytes / encoded.payload_bytes >= 40
    segments = [slice(chunk.start, chunk.stop) for chunk in encoded.chunks]
    assert global_pca(motion, markers).scalar_ratio == pytest.approx(3.7, abs=0.1)
    assert piecewise_pca(motion, markers, segments).scalar_ratio == pytest.approx(5.0, abs=0.15)
