"""The bodies' surface from frame to frame: the compiled module and NumPy give the same integers."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.bodycast.integer_surface import IntegerSurface
from mocodec.codecs.bodycast.surface_memory import (
    SEARCHED_SAMPLES,
    ColourMemory,
    PlaceMemory,
    PosedSurface,
    SampleTable,
)

pytestmark = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
SAMPLES, LINKS = 70, 4


def surface(rng: np.random.Generator) -> tuple[IntegerSurface, SampleTable]:
    neighbours = rng.integers(0, SAMPLES, (SAMPLES, 12))
    links, shares = rng.integers(0, LINKS, (SAMPLES, 2)), rng.integers(0, 4097, SAMPLES)
    points, normals = rng.integers(-70_000, 70_000, (SAMPLES, 3)), rng.integers(-1024, 1025, (SAMPLES, 3))
    table = SampleTable(points, neighbours[:, : SEARCHED_SAMPLES - 1], rng.integers(-255, 256, (SAMPLES, 3)))
    return IntegerSurface(points, normals, neighbours, links, shares), table


def results(largest_turn: int, missing: float) -> list[np.ndarray]:
    """Three frames, of which the later ones lack some samples. missing: share of points without a sample."""
    rng = np.random.default_rng(largest_turn)
    whole, table = surface(rng)
    places_memory, colour_memory, found = PlaceMemory(table), ColourMemory(table), list[np.ndarray]()
    for frame in range(3):
        turns = rng.integers(-largest_turn, largest_turn + 1, (LINKS, 3, 3))
        moves = rng.integers(-(1 << 17), 1 << 17, (LINKS, 3))
        places, normals = whole.posed(turns, moves)
        rows = np.arange(SAMPLES)[5 * frame :]
        posed = PosedSurface(rows, places[rows], normals[rows], whole.links[rows, 0], turns)
        samples = rng.integers(0, len(rows), 300)
        samples[rng.random(300) < missing] = -1
        points = posed.places[samples] + rng.integers(-900, 900, (300, 3))
        found += [places, normals, places_memory.corrected(posed)]
        places_memory.learn(posed, points, samples)
        known = samples >= 0
        canonical = table.canonical(posed, points[known], samples[known])
        found += [canonical, colour_memory.expected(rows[samples[known]], canonical)]
        colour_memory.learn(rows[samples[known]], canonical, rng.integers(-512, 512, (len(canonical), 3)))
    return found


@pytest.mark.parametrize("largest_turn", [1 << 20, 1 << 45])
@pytest.mark.parametrize("missing", [0.0, 0.4, 1.0])
def test_compiled_and_numpy_surfaces_are_the_same(largest_turn, missing):
    ours = results(largest_turn, missing)
    with native.without():
        theirs = results(largest_turn, missing)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(a, b)


def test_rows_beyond_the_samples_are_refused():
    kernel = native.kernel("canonical_places")
    assert kernel is not None
    three, zero, one = np.zeros((1, 3), np.int64), np.zeros(1, np.int64), np.ones(1, np.int64)
    for links, samples in ((zero, one), (one, zero)):
        with pytest.raises(ValueError, match="beyond the samples"):
            kernel(three, zero, three, links, np.zeros((1, 3, 3), np.int64), three, samples)
