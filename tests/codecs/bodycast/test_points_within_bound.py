"""All points within a bound: the lattice, its octree, colours, targets, frames without a body, damage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

import mocodec as mc
from mocodec import container, native
from mocodec.codecs.bodycast import (
    Bodycast,
    integer_surface,
    lattice,
    lattice_frames,
    octree,
    point_colours,
    point_octree,
    point_targets,
)
from mocodec.codecs.bodycast.colour_lifting import ColourLifting, ColourSteps
from mocodec.codecs.bodycast.surface_memory import ColourMemory, PlaceMemory, PosedSurface, SampleTable
from mocodec.encoded import Chunk, Encoded
from mocodec.entropy.bit_arrays import BitDecoder, BitEncoder
from mocodec.errors import BadInput, CannotEncode, Corrupt, MocodecError
from mocodec.metrics import point_clouds as measures
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, corruption, sequences

pytest.importorskip("av")


@pytest.fixture(scope="module")
def performance() -> sequences.Performance:
    return sequences.jumping_jacks(actors.capsules(), 4)


@pytest.fixture(scope="module")
def clouds(performance) -> PointClouds:
    return replace(sequences.record(performance, 1500, seed=1), normals=None)


@pytest.fixture(scope="module")
def encoded(performance, clouds) -> Encoded[PointClouds]:
    return Bodycast(max_error=0.002, skeleton=performance.skeleton(), chunk_frames=3).encode(clouds)


def distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Nearest distances in both directions, by SciPy alone."""
    return np.concatenate([KDTree(b).query(a)[0], KDTree(a).query(b)[0]])


def things(frames: int = 3, points: int = 300) -> PointClouds:
    """Points that are no person: a thing 10 cm high."""
    rng = np.random.default_rng(5)
    return PointClouds([rng.uniform(-1, 1, (points, 3)) * [0.4, 0.05, 0.2] for _ in range(frames)], 15.0)


@pytest.mark.parametrize("bound", [1e-5, 0.003, 2.0])
def test_no_place_is_farther_from_the_lattice_than_the_bound(bound):
    points = np.random.default_rng(0).uniform(-50 * bound, 50 * bound, (20_000, 3))
    step = lattice.step_of_bound(bound)
    whole = lattice.nearest(points, step)
    assert ((whole % 2).sum(axis=1) % 3 == 0).all()  # all even or all odd
    distance = np.linalg.norm(points - lattice.positions(whole, step), axis=1)
    assert 0.9 * bound < distance.max() <= bound
    assert np.sqrt(np.mean(distance**2)) == pytest.approx(lattice.RMS_PER_BOUND * bound, rel=0.01)


@pytest.mark.parametrize("codes", [[0], [7], [0, 7], [0, 7, 56, 63, 448, 511]])
def test_octrees_of_few_points(codes):
    codes = np.array(codes)
    encoder = BitEncoder()
    point_octree.code_octree(encoder, codes, 3, len(codes), None)
    decoder = BitDecoder(encoder.finish())
    back, _ = point_octree.code_octree(decoder, None, 3, len(codes), None)
    decoder.finish()
    np.testing.assert_array_equal(back, codes)


@pytest.mark.parametrize("luma", [1, 3, 16])
@pytest.mark.parametrize("count", [1, 2, 17, 333])
def test_colours_are_within_a_step(luma, count):
    rng = np.random.default_rng(2)
    colours = point_colours.ycocg_from_rgb(rng.integers(0, 256, (count, 3)))
    cells, expected = rng.integers(0, 1024, (count, 3)), rng.integers(0, 256, (count, 3))
    known, steps = rng.random(count) < 0.6, ColourSteps.of_luma(luma)
    encoder = BitEncoder()
    decoded = ColourLifting(steps).code_frame(encoder, colours, cells, expected, known)
    back = ColourLifting(steps).code_frame(BitDecoder(encoder.finish()), None, cells, expected, known)
    np.testing.assert_array_equal(back, decoded)
    assert (np.abs(decoded - colours) <= np.array(steps.of_channels) - 1).all()  # steps of 1 are lossless


def test_expected_colours_are_those_of_the_nearest_learned_points():
    places = np.array([[0, 0, 0], [1000, 0, 0], [50_000, 0, 0]])
    neighbours = np.array([[1] * 6, [0] * 6, [2] * 6])
    memory = ColourMemory(SampleTable(places, neighbours, np.array([[10, 0, 0], [10, 0, 0], [99, 5, 5]])))
    assert memory.expected(np.array([0, 2]), places[[0, 2]]).tolist() == [[10, 0, 0], [99, 5, 5]]
    memory.learn(np.zeros(12, np.int64), np.tile([10, 0, 0], (12, 1)), np.tile([200, 7, 7], (12, 1)))
    assert memory.expected(np.array([0]), np.array([[10, 0, 0]])).tolist() == [[200, 7, 7]]


def test_places_of_the_surface_are_learned():
    places = np.array([[0, 0, 0], [100_000, 0, 0]])
    normals = np.tile([0, 0, 1024], (2, 1))
    memory = PlaceMemory(SampleTable(places, np.array([[0] * 6, [1] * 6]), np.zeros((2, 3), np.int64)))
    turns = np.eye(3, dtype=np.int64)[None] << 20
    frame = PosedSurface(np.arange(2), places, normals, np.zeros(2, np.int64), turns)
    memory.learn(frame, np.tile([5, 5, 300], (50, 1)), np.zeros(50, np.int64))
    moved = memory.corrected(frame)
    assert 280 < moved[0, 2] <= 300
    assert moved[1].tolist() == [100_000, 0, 0]


def test_rounding_shifts_keep_values_from_the_border():
    values = np.array([3.0, 3.5, -2.25 + 1e-12, 7.999_999_999])
    shift = integer_surface.rounding_shift(values)
    whole = integer_surface.rounded(values, shift)
    for change in (-1e-8, 1e-8):
        np.testing.assert_array_equal(integer_surface.rounded(values + change, shift), whole)


def test_nearest_samples_do_not_depend_on_the_order_of_a_tree():
    grid = np.stack(np.meshgrid(*[np.arange(6)] * 3), -1).reshape(-1, 3) * 100
    normals = np.tile([0, 0, 1024], (len(grid), 1))
    found = integer_surface.nearest_samples(grid, normals)
    for row in (0, 100, 215):
        every = ((grid - grid[row]) ** 2).sum(axis=1)
        expected = np.lexsort((np.arange(len(grid)), every))[: integer_surface.NEIGHBOURS + 1]
        assert found[row].tolist() == [r for r in expected.tolist() if r != row][: integer_surface.NEIGHBOURS]


def test_every_point_has_a_decoded_one_within_the_bound_and_back(clouds, encoded):
    decoded = Bodycast.decode(encoded)
    assert encoded.promise == {"max_error": 0.002}
    for original, points in zip(clouds.positions, decoded.positions, strict=True):
        assert 0.0015 < distances(np.asarray(original), points).max() <= 0.002
    found = measures.errors(clouds, decoded)
    assert found.max_error <= 0.002
    assert found.psnr > 35


def test_bytes_and_points_do_not_depend_on_threads(performance, clouds):
    codec = Bodycast(max_error=0.004, skeleton=performance.skeleton(), chunk_frames=2)
    alone, together = (mc.encode(clouds, codec, threads=threads) for threads in (1, 2))
    assert alone == together
    pairs = zip(*(mc.decode(alone, PointClouds, threads=threads).positions for threads in (1, 2)), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)


def test_the_surface_saves_bytes(clouds, encoded):
    alone = Bodycast(max_error=0.002, chunk_frames=3)._point_chunks(
        [], _frames(clouds), _spans(encoded), True, 0, {"max_error": 0.002}
    )
    assert sum(len(c.payload) for c in encoded.chunks) < 0.97 * sum(map(len, alone))


def _frames(clouds):
    return list(zip(clouds.positions, clouds.colours, strict=True))


def _spans(encoded):
    return [slice(c.start, c.stop) for c in encoded.chunks]


@pytest.mark.parametrize("frames", [slice(0, 2), slice(2, 4), slice(3, 4), slice(4, 4)])
def test_slice_of_decode_is_decode_of_slice(encoded, frames):
    whole, part = Bodycast.decode(encoded), Bodycast.decode(encoded, frames)
    for i, frame in enumerate(range(frames.start, frames.stop)):
        np.testing.assert_array_equal(part.positions[i], whole.positions[frame])


def test_python_and_compiled_coders_agree():
    clouds = things(2, 60)
    with native.without():
        pure = Bodycast(max_error=0.01).encode(clouds)
    compiled = Bodycast(max_error=0.01).encode(clouds)
    assert pure.chunks[0].payload == compiled.chunks[0].payload
    with native.without():
        decoded = Bodycast.decode(compiled)
    np.testing.assert_array_equal(decoded.positions[1], Bodycast.decode(compiled).positions[1])


def test_less_error_takes_more_bytes():
    clouds = things()
    sizes = [Bodycast(max_error=bound).encode(clouds).payload_bytes for bound in (0.02, 0.005, 0.001, 0.0002)]
    assert sizes == sorted(sizes)


@pytest.mark.parametrize("mean", [0.0005, 0.01])
def test_a_mean_error_is_met_closely(mean):
    clouds = things()
    found = measures.errors(clouds, Bodycast.decode(Bodycast(mean_error=mean).encode(clouds)))
    assert 0.8 * mean < found.mean_error <= mean


@pytest.mark.parametrize("target", [{"size": 3000}, {"ratio": 4.0}])
def test_a_size_is_met(target):
    clouds = things()
    blob = mc.encode(clouds, **target)
    limit = target.get("size") or clouds.raw_bytes / target["ratio"]
    assert 0.5 * limit < len(blob) <= limit
    with pytest.raises(CannotEncode, match="ask for a"):
        mc.encode(clouds, size=200)


def test_psnr_of_colours_is_met(performance, clouds):
    codec = Bodycast(max_error=0.0005, psnr=48, skeleton=performance.skeleton())
    one = clouds[:1]
    assert measures.errors(one, codec.decode(codec.encode(one))).psnr >= 48
    with pytest.raises(CannotEncode, match="colours"):
        replace(codec, max_error=0.05, psnr=60).encode(one)


def test_frames_without_a_body_fall_back_to_points():
    clouds = things()
    blob = np.random.default_rng(3).normal(size=(300, 3)) * 0.4  # as high as a person
    for positions in ([p[:50] for p in clouds.positions], [*clouds.positions[:2], np.zeros((0, 3))], [blob]):
        plain = PointClouds(positions, 15.0)
        decoded = mc.decode(mc.encode(plain), PointClouds)
        assert measures.errors(plain, decoded).max_error <= point_targets.DEFAULT_BOUND_M
    with pytest.raises(BadInput, match="without a body"):
        Bodycast.track(Bodycast().encode(clouds))


def test_a_body_that_is_absent_in_a_frame(performance, clouds):
    positions, colours = list(clouds.positions), list(clouds.colours or ())
    positions[2], colours[2] = positions[2][:5], colours[2][:5]
    holes = PointClouds(positions, 15.0, colours)
    codec = Bodycast(max_error=0.003, skeleton=performance.skeleton())
    assert measures.errors(holes, codec.decode(codec.encode(holes))).max_error <= 0.003


def test_points_that_cannot_be_bounded_are_refused():
    far = PointClouds([np.array([[0.0, 0, 0], [1e6, 0, 0]])], 15.0)
    with pytest.raises(CannotEncode, match="too far"):
        Bodycast(max_error=0.001).encode(far)
    with pytest.raises(BadInput, match="one target"):
        Bodycast(max_error=0.001, size=1000).encode(things())
    with pytest.raises(BadInput, match="exact"):
        Bodycast(max_error=0.001, residual="exact").encode(things())
    with pytest.raises(BadInput, match="above zero"):
        Bodycast(max_error=-1.0).encode(things())


@pytest.mark.parametrize(
    "target",
    [
        {"max_error": 0.002}, {"mean_error": 0.001}, {"psnr": 30.0}, {"size": 5000}, {"residual": "exact"},
        {"residual": 26}, {"residual": 100},
    ],
)  # fmt: skip
def test_points_too_far_apart_are_refused_before_tracking(clouds, monkeypatch, target):
    positions = [points.copy() for points in clouds.positions]
    positions[1][7] = 1e6
    far = replace(clouds, positions=positions)
    monkeypatch.setattr(Bodycast, "_track", None)
    with pytest.raises(CannotEncode, match="apart"):
        Bodycast(**target).encode(far)


def test_the_range_that_is_required_is_that_of_the_lattice():
    step, size = lattice.step_of_bound(0.001), 1 << point_octree.MAX_DEPTH
    for cells in (size - 20, size - 2, size - 1, size, size + 1, size + 20):
        frames = [(np.array([[0.0, 0, 0], [0, cells * step, 0]]), None)]
        outcomes = list[str]()
        for check in (lattice_frames.require_range, lattice_frames.to_lattice):
            try:
                check(frames, 0.001, *([False] if check is lattice_frames.to_lattice else []))
                outcomes.append("")
            except CannotEncode as error:
                outcomes.append(str(error))
        assert outcomes[0] == outcomes[1]


def test_no_body_is_searched_for_a_few_points(performance, monkeypatch):
    few = sequences.record(performance, 240, seed=1)
    monkeypatch.setattr(Bodycast, "_track", None)
    encoded = Bodycast(max_error=0.005).encode(few[:3])
    assert not encoded.shared
    assert measures.errors(few[:3], Bodycast.decode(encoded)).max_error <= 0.005


def test_exact_points_at_infinity_are_refused():
    points = np.array([[0.0, 0, 0], [np.inf, 1, 1]])
    with pytest.raises(CannotEncode, match="infinity"):
        Bodycast(residual="exact").encode(PointClouds([points], 10.0))


def test_duplicates_become_one_point_with_their_mean_colour():
    points = np.tile([[0.1, 0.2, 0.3]], (4, 1))
    colours = np.array([[0, 0, 0], [10, 0, 0], [20, 0, 0], [30, 0, 0]], np.uint8)
    grid, [frame] = lattice_frames.to_lattice([(points, colours)], 0.001, True)
    assert len(frame.codes) == 1
    assert np.asarray(frame.colours).tolist() == [[15, 0, 0]]
    assert distances(points, grid.positions(octree.cells_of_codes(frame.codes))).max() <= 0.001
    assert octree.cells_of_codes(frame.codes).shape == (1, 3)


def test_every_flipped_byte_and_prefix_of_a_file_is_an_error():
    blob = container.pack(Bodycast(max_error=0.01).encode(things(2, 80)))
    for cut in corruption.prefixes(blob, every=7):
        with pytest.raises(MocodecError):
            mc.decode(cut)
    for _, broken in corruption.flips(blob, every=7):
        with pytest.raises(MocodecError):
            mc.decode(broken)


def test_damaged_payloads_raise_corrupt_or_decode(encoded):
    rng = np.random.default_rng(4)
    for _ in range(25):
        payload = bytearray(encoded.chunks[0].payload)
        payload[int(rng.integers(0, len(payload)))] ^= int(rng.integers(1, 256))
        broken = Encoded("bodycast", encoded.about, [Chunk(0, 3, bytes(payload))], encoded.shared)
        try:
            Bodycast.decode(broken)
        except Corrupt:
            continue
