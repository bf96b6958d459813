"""Octrees of lattice points, octant by octant and cube by cube: the compiled module and NumPy give the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.bodycast import cube_octree, integer_surface, octree, point_choice, point_octree
from mocodec.codecs.bodycast.lattice_frames import LatticeFrame, LatticeGrid
from mocodec.codecs.bodycast.surface_hints import NORMAL_BITS, SUBUNIT_BITS, SurfaceHints
from mocodec.entropy.bit_arrays import BitDecoder, BitEncoder
from mocodec.errors import Corrupt

CodeOctree = Callable[..., tuple[np.ndarray, np.ndarray]]
both = pytest.mark.parametrize(
    "code_octree", [point_octree.code_octree, cube_octree.code_octree], ids=["octants", "cubes"]
)
compiled = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")


def sphere(count: int, rng: np.random.Generator) -> np.ndarray:
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def scene(depth: int, points: int, samples: int, far: int = 0, seed: int = 0) -> tuple[np.ndarray, SurfaceHints | None]:
    """Codes of points near a sphere, and its samples; `far` of these lie outside the octree."""
    rng = np.random.default_rng(seed)
    side = 1 << depth
    places = side * (0.5 + 0.4 * sphere(points, rng)) + rng.normal(0, 0.01 * side + 0.5, (points, 3))
    lattice = 2 * np.round(places / 2).astype(int) + rng.integers(0, 2, (points, 1))
    codes = np.unique(octree.morton_codes(np.clip(lattice, 0, side - 1) & ~1 | lattice[:, :1] & 1))
    if not samples:
        return codes, None
    normals = sphere(samples, rng)
    radius = 0.4 * side * (1 << SUBUNIT_BITS)
    at = np.floor(side * (1 << SUBUNIT_BITS) / 2 + radius * normals).astype(np.int64)
    at[:far] += 3 * side << SUBUNIT_BITS
    whole = np.floor(normals * (1 << NORMAL_BITS)).astype(np.int64)
    neighbours = integer_surface.nearest_samples(at, whole)
    spacing = int(np.sqrt(np.median(((at[neighbours[:, 0]] - at) ** 2).sum(axis=1)))) or 1
    return codes, SurfaceHints(at, whole, neighbours, spacing, depth)


def coded(
    code_octree: CodeOctree, frames: list[tuple[np.ndarray, SurfaceHints | None]], depth: int
) -> tuple[bytes, list[np.ndarray]]:
    """The bytes of frames, and the samples of their points, from the encoder and from the decoder."""
    encoder = BitEncoder()
    samples = [code_octree(encoder, codes, depth, len(codes), hints)[1] for codes, hints in frames]
    data = encoder.finish()
    decoder = BitDecoder(data)
    for codes, hints in frames:
        back, nearest = code_octree(decoder, None, depth, len(codes), hints)
        np.testing.assert_array_equal(back, codes)
        samples.append(nearest)
    decoder.finish()
    return data, samples


@compiled
@both
@pytest.mark.parametrize(
    ("depth", "points", "samples", "far"),
    [
        (1, 8, 0, 0),
        (2, 3, 1, 0),
        (4, 60, 15, 3),
        (7, 300, 150, 0),
        (7, 400, 40, 0),
        (7, 100, 400, 50),
        (9, 100, 40, 40),
        (20, 30, 60, 0),
        (20, 30, 5, 1),
    ],
)
def test_compiled_and_numpy_octrees_are_the_same(code_octree, depth, points, samples, far):
    frames = [scene(depth, points, samples, far, seed) for seed in range(3)]
    frames[1] = (frames[1][0], None)  # a frame without a body between two with one
    data, found = coded(code_octree, frames, depth)
    with native.without():
        pure, expected = coded(code_octree, frames, depth)
    assert data == pure
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@compiled
@pytest.mark.parametrize(("depth", "points", "samples", "far"), [(5, 33, 14, 3), (8, 900, 300, 100), (20, 200, 60, 1)])
def test_samples_kept_from_a_choice_are_those_of_other_points_too(depth, points, samples, far):
    encoder, frames = BitEncoder(), list[tuple[np.ndarray, SurfaceHints]]()
    for seed in range(4):
        codes, hints = scene(depth, points, samples, far, seed)
        assert hints is not None
        cells = octree.cells_of_codes(codes)
        source = LatticeFrame(codes, None, np.asarray(cells * 0.01, np.float64), np.arange(len(codes)))
        chosen = point_choice.chosen_cells(source, LatticeGrid(0.01, np.zeros(3, np.int64), depth), hints, 0.012)
        coded = (chosen.codes, codes, codes[::3], scene(depth, points, 0, seed=seed + 9)[0])[seed]
        cube_octree.code_octree(encoder, coded, depth, len(coded), hints)
        frames.append((coded, replace(hints)))  # of which nothing is kept
    decoder = BitDecoder(encoder.finish())
    for codes, hints in frames:
        np.testing.assert_array_equal(cube_octree.code_octree(decoder, None, depth, len(codes), hints)[0], codes)
    decoder.finish()


@compiled
@both
def test_damaged_bytes_fail_alike(code_octree):
    codes, hints = scene(6, 100, 60)
    data = coded(code_octree, [(codes, hints)], 6)[0]
    rng = np.random.default_rng(1)
    cases = [(data[: len(data) // 2], len(codes)), (data, len(codes) - 5), (data, len(codes) + 5)]
    cases += [(rng.bytes(len(data)), len(codes)) for _ in range(20)]

    def outcome(stream: bytes, points: int) -> str:
        try:
            return str(code_octree(BitDecoder(stream), None, 6, points, hints)[0].tolist())
        except Corrupt as error:
            return str(error)

    for stream, points in cases:
        ours = outcome(stream, points)
        with native.without():
            assert ours == outcome(stream, points)


@compiled
@both
@pytest.mark.parametrize("codes", [[7, 0], [0, 0], [0, 8], [0, 3]])
def test_codes_that_are_no_frame_are_refused(code_octree, codes):
    with pytest.raises(ValueError, match="octree: "):
        code_octree(BitEncoder(), np.array(codes), 1, 2, None)
