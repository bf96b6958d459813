"""Colours of lattice points: the compiled module and NumPy give the same bytes, colours and errors."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.bodycast import point_colours
from mocodec.codecs.bodycast.colour_lifting import ColourLifting, ColourSteps
from mocodec.codecs.bodycast.surface_memory import SEARCHED_SAMPLES, ColourMemory, SampleTable
from mocodec.entropy.bit_arrays import BitDecoder, BitEncoder
from mocodec.errors import Corrupt

pytestmark = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
SAMPLES = 60


def table(rng: np.random.Generator) -> SampleTable:
    neighbours = rng.integers(0, SAMPLES, (SAMPLES, SEARCHED_SAMPLES - 1))
    return SampleTable(rng.integers(-9000, 9000, (SAMPLES, 3)), neighbours, rng.integers(-255, 256, (SAMPLES, 3)))


def frames(points: int, extreme: bool) -> list[tuple[np.ndarray, ...]]:
    """Rows, places, cells, colours and where they are expected, of three frames."""
    rng = np.random.default_rng(points)
    places = (1 << 23) if extreme else 9000
    return [
        (
            rng.integers(0, SAMPLES, points),
            rng.integers(-places, places + 1, (points, 3)),
            rng.integers(0, 1 << 20 if extreme else 60, (points, 3)),
            rng.integers(-255, 256, (points, 3)) if extreme else rng.normal(30, 12, (points, 3)).astype(np.int64),
            rng.random(points) < 0.8,
        )
        for _ in range(3)
    ]


def coded(points: int, step: int, extreme: bool) -> tuple[bytes, list[np.ndarray]]:
    """The bytes of three frames, and what is expected and decoded; the decoder is checked."""
    coder, memory = BitEncoder(), ColourMemory(table(np.random.default_rng(0)))
    lifting, found = ColourLifting(ColourSteps.of_luma(step)), list[np.ndarray]()
    for rows, places, cells, colours, is_expected in frames(points, extreme):
        expected = memory.expected(rows, places)
        decoded = lifting.code_frame(coder, colours, cells, expected, is_expected)
        memory.learn(rows, places, decoded)
        found += [expected, decoded]
    data = coder.finish()
    decoder, lifting = BitDecoder(data), ColourLifting(ColourSteps.of_luma(step))
    for k, (_, _, cells, _, is_expected) in enumerate(frames(points, extreme)):
        back = lifting.code_frame(decoder, None, cells, found[2 * k], is_expected)
        np.testing.assert_array_equal(back, found[2 * k + 1])
    decoder.finish()
    return data, found


@pytest.mark.parametrize("points", [1, 2, 5, 300, 2500])
@pytest.mark.parametrize(("step", "extreme"), [(1, True), (1, False), (6, False)])
def test_compiled_and_numpy_colours_are_the_same(points, step, extreme):
    data, found = coded(points, step, extreme)
    with native.without():
        pure, expected = coded(points, step, extreme)
    assert data == pure
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(("apart", "far"), [(1, 0), (40, 3), (700, 30_000)])
def test_candidates_of_equal_distance_are_chosen_alike(apart, far):
    """apart: distance of the places, on a grid of 7 a side. far: of the rows' places from one another."""
    rng = np.random.default_rng(apart)
    rows, offsets = rng.integers(0, SAMPLES, 3000), rng.integers(0, 2, (SAMPLES, 3)) * far
    places = rng.integers(0, 7, (3000, 3)) * apart + offsets[rows]
    colours = rng.integers(-255, 256, (3000, 3)).astype(np.int16)

    def expected() -> np.ndarray:
        memory = ColourMemory(table(np.random.default_rng(0)))
        memory.learn(rows[:2000], places[:2000], colours[:2000])
        return memory.expected(rows, places)

    ours = expected()
    with native.without():
        np.testing.assert_array_equal(ours, expected())


def test_colour_spaces_are_the_same():
    rng = np.random.default_rng(0)
    colours = rng.integers(0, 256, (500, 3)).astype(np.uint8)
    values = rng.integers(-512, 512, (500, 3)).astype(np.int16)
    ours = point_colours.ycocg_from_rgb(colours), point_colours.rgb_from_ycocg(values)
    with native.without():
        np.testing.assert_array_equal(ours[0], point_colours.ycocg_from_rgb(colours))
        np.testing.assert_array_equal(ours[1], point_colours.rgb_from_ycocg(values))
    np.testing.assert_array_equal(point_colours.rgb_from_ycocg(ours[0]), colours)


def test_damaged_colours_fail_alike():
    data, found = coded(300, 1, True)
    cells, is_expected = frames(300, True)[0][2], frames(300, True)[0][4]
    rng = np.random.default_rng(2)

    def outcome(stream: bytes) -> str:
        try:
            lifting = ColourLifting(ColourSteps.of_luma(1))
            return str(lifting.code_frame(BitDecoder(stream), None, cells, found[0], is_expected).tolist())
        except Corrupt as error:
            return str(error)

    for stream in [b"", data[:40], *(rng.bytes(400) for _ in range(6))]:
        ours = outcome(stream)
        with native.without():
            assert ours == outcome(stream)
