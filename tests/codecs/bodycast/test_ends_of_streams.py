"""A stream of mixed bits that leaves bytes is corrupt (docs/payloads/bodycast-points.md), in every kind of points."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest

from mocodec import api, native
from mocodec.codecs.bodycast import Bodycast, exact_octree
from mocodec.codecs.bodycast.body_model import unpack_models
from mocodec.codecs.bodycast.chunk_payload import pack_chunk, unpack_chunk
from mocodec.codecs.bodycast.exact_octree import ExactHeader
from mocodec.codecs.bodycast.point_layer import PointsHeader, split_references
from mocodec.encoded import Chunk, Encoded
from mocodec.entropy import varint
from mocodec.errors import Corrupt
from mocodec.pointcloud import PointClouds

GOLDEN = Path(__file__).parents[2] / "golden"
WITHIN_BOUND = ("jumper-bounded", "jumper-learned", "jumper-smoothed", "jumper-cubes", "covered")
EXACT = ("exact", "exact-steps")
MORE = bytes(8)  # more than the four bytes that a decoder reads before the first bit

pytest.importorskip("av")


def golden(name: str) -> Encoded[PointClouds]:
    with api.open(GOLDEN / f"bodycast-{name}.mocz", PointClouds) as file:
        return file.encoded


def changed(encoded: Encoded[PointClouds], change: Callable[[bytes], bytes]) -> Encoded[PointClouds]:
    """The exact points of the first chunk replaced."""
    first, *others = encoded.chunks
    streams = unpack_chunk(first, len(encoded.shared))
    payload = pack_chunk(streams._replace(exact_points=change(streams.exact_points)))
    return replace(encoded, chunks=[Chunk(first.start, first.frames, payload), *others])


def with_longer_part(data: bytes, which: int) -> bytes:
    """Places, repeats or bits of floats of exact points, with more bytes at their end."""
    header, at = ExactHeader.read(data)
    sizes = list(header.sizes)
    end = at + sum(sizes[: which + 1])
    sizes[which] += len(MORE)
    return header._replace(sizes=(sizes[0], sizes[1], sizes[2])).pack() + data[at:end] + MORE + data[end:]


def with_longer_octrees(data: bytes, encoded: Encoded[PointClouds]) -> bytes:
    """More bytes at the end of the octrees of points within a bound."""
    first = encoded.chunks[0]
    present = int((~unpack_chunk(first, len(encoded.shared)).is_absent).sum())
    part, _ = split_references(data, first.frames)
    coloured = any(model.coloured for model in unpack_models(encoded.shared))
    octrees = PointsHeader.read(part, first.frames, len(encoded.shared), present, coloured).octrees
    size = octrees.stop - octrees.start
    before = data[: len(data) - len(part) + octrees.start - len(varint.write([size]))]
    return before + varint.write([size + len(MORE)]) + part[octrees] + MORE + part[octrees.stop :]


@pytest.fixture(params=["compiled", "NumPy"])
def coders(request: pytest.FixtureRequest):
    if request.param == "compiled" and native.kernel("BitArrayDecoder") is None:
        pytest.skip("not built")
    with nullcontext() if request.param == "compiled" else native.without():
        yield


def refused(encoded: Encoded[PointClouds]) -> None:
    with pytest.raises(Corrupt, match="does not end"):
        Bodycast.decode(encoded)


@pytest.mark.usefixtures("coders")
@pytest.mark.parametrize("name", [*WITHIN_BOUND, *EXACT])
def test_colours(name):
    refused(changed(golden(name), lambda data: data + MORE))


@pytest.mark.usefixtures("coders")
@pytest.mark.parametrize("name", WITHIN_BOUND)
def test_octrees(name):
    encoded = golden(name)
    refused(changed(encoded, lambda data: with_longer_octrees(data, encoded)))


@pytest.mark.usefixtures("coders")
@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("part", [0, 1])
def test_places_and_repeats_of_exact_points(name, part):
    refused(changed(golden(name), lambda data: with_longer_part(data, part)))


def test_bits_of_floats_on_a_grid():
    encoded = golden("exact-steps")
    assert unpack_chunk(encoded.chunks[0], len(encoded.shared)).exact_points[0] == exact_octree.KIND
    with pytest.raises(Corrupt, match="bits of floats"):
        Bodycast.decode(changed(encoded, lambda data: with_longer_part(data, 2)))
