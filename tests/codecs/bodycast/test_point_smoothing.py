"""Points move to the surface around them: the compiled module and NumPy give the same integers, and less error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.bodycast import lattice, point_smoothing
from mocodec.codecs.bodycast.integer_surface import nearest_samples
from mocodec.codecs.bodycast.surface_hints import NORMAL_BITS, SUBUNIT_BITS, SurfaceHints
from mocodec.entropy.bit_arrays import BitDecoder, BitEncoder

RADIUS = 120.0  # of the sphere, lattice units


def sphere(points: int, missing: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, SurfaceHints]:
    """Places on a sphere, their lattice points, the sample near each, and the surface."""
    rng = np.random.default_rng(points)
    outward = unit(rng.normal(size=(300, 3)))
    at = np.round((RADIUS + RADIUS * outward) * (1 << SUBUNIT_BITS)).astype(np.int64)
    normals = np.round(outward * (1 << NORMAL_BITS)).astype(np.int64)
    hints = SurfaceHints(at, normals, nearest_samples(at, normals), 20 << SUBUNIT_BITS, 9)
    places = RADIUS + RADIUS * unit(rng.normal(size=(points, 3)))
    cells = lattice.nearest(places, 1.0)
    samples = ((places[:, None] - at / (1 << SUBUNIT_BITS)) ** 2).sum(axis=2).argmin(axis=1)
    samples[rng.random(points) < missing] = -1
    return places, cells, samples, hints


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
@pytest.mark.parametrize(
    ("points", "missing", "scale"),
    [(1, 0.0, 1), (40, 0.0, 1), (400, 0.3, 1), (4500, 0.0, 1), (50, 1.0, 1), (400, 0.1, 60), (400, 0.1, 300)],
)
def test_compiled_and_numpy_moves_are_the_same(points: int, missing: float, scale: int) -> None:
    """scale: of all coordinates, so that distances or the coordinates themselves do not fit into 16 bits."""
    _, cells, samples, hints = sphere(points, missing)
    cells, hints = cells * scale, replace(hints, points=hints.points * scale, spacing=hints.spacing * scale)
    ours = point_smoothing.smooth(cells, samples, hints)
    with native.without():
        theirs = point_smoothing.smooth(cells, samples, hints)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(a, b)


def test_points_come_nearer_to_the_surface() -> None:
    _, cells, samples, hints = sphere(500)
    smoothed = point_smoothing.smooth(cells, samples, hints)
    moved = cells + smoothed.shifts / (1 << point_smoothing.FINE_BITS)
    before, after = (np.abs(np.linalg.norm(p - RADIUS, axis=1) - RADIUS) for p in (cells, moved))
    assert np.sqrt((after**2).mean()) < 0.8 * np.sqrt((before**2).mean())


def test_points_without_a_surface_stay() -> None:
    _, cells, samples, hints = sphere(30, missing=1.0)
    assert not point_smoothing.smooth(cells, samples, hints).shifts.any()
    assert not point_smoothing.smooth(cells, samples, None).shifts.any()


def test_points_that_stay_are_coded() -> None:
    _, cells, samples, hints = sphere(200)
    smoothed = point_smoothing.smooth(cells, samples, hints)
    stays = np.random.default_rng(1).random(200) < 0.1
    encoder = BitEncoder()
    wanted = point_smoothing.code_stays(encoder, smoothed, stays)
    np.testing.assert_array_equal(wanted, stays | (smoothed.moves == 0))
    decoder = BitDecoder(encoder.finish())
    np.testing.assert_array_equal(point_smoothing.code_stays(decoder, smoothed, None), wanted)
    decoder.finish()
