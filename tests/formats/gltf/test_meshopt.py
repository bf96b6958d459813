"""EXT_meshopt_compression: buffer views that a small encoder here compresses decode to their bytes."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import BadInput
from mocodec.formats import gltf
from mocodec.formats.gltf import meshopt

from .build import Build, about, leg


def compressed(elements: np.ndarray) -> bytes:
    """Elements (count, stride), uint8, as mode 0 stores them; each group with the fewest bytes."""
    count, stride = elements.shape
    block = min((8192 // stride) & ~15, 256)
    result, before = b"\xa0", elements[0]
    for start in range(0, count, block):
        rows = elements[start : start + block]
        deltas = np.diff(rows, axis=0, prepend=before[None])
        codes = np.where(deltas & 0x80, ~(deltas << 1), deltas << 1).astype(np.uint8)
        codes = np.concatenate([codes, np.zeros((-len(codes) % 16, stride), np.uint8)])
        for column in codes.T:
            packed = [best(group.tolist()) for group in column.reshape(-1, 16)]
            modes = [mode for mode, _ in packed] + [0] * (-len(packed) % 4)
            heads = np.reshape(modes, (-1, 4)) @ [1, 4, 16, 64]
            result += bytes(heads.tolist()) + b"".join(data for _, data in packed)
        before = rows[-1]
    return result + bytes(max(0, 32 - stride)) + elements[0].tobytes()


def best(codes: list[int]) -> tuple[int, bytes]:
    """The mode of a group of 16 codes, and its bytes."""
    if not any(codes):
        return 0, b""
    choices = {3: bytes(codes)}
    for mode, bits in ((1, 2), (2, 4)):
        sentinel, per_byte = (1 << bits) - 1, 8 // bits
        short = [min(code, sentinel) for code in codes]
        whole = bytes(code for code in codes if code >= sentinel)
        rows = [short[i : i + per_byte] for i in range(0, 16, per_byte)]
        choices[mode] = bytes(sum(c << (8 - bits * (i + 1)) for i, c in enumerate(row)) for row in rows) + whole
    mode = min(choices, key=lambda m: len(choices[m]))
    return mode, choices[mode]


@pytest.mark.parametrize("count", [1, 15, 16, 17, 255, 257, 700])
@pytest.mark.parametrize("stride", [4, 12, 16, 64, 256])
def test_what_was_compressed_comes_back(count, stride):
    rng = np.random.default_rng(count * stride)
    steps = rng.choice([0, 0, 0, 1, 255, 3, 17], (count, stride)) * (np.arange(stride) % 3)
    elements = np.cumsum(steps, axis=0).astype(np.uint8)
    assert meshopt.decode(compressed(elements), count, stride, "ATTRIBUTES") == elements.tobytes()


def test_the_sentinel_example_of_the_specification():
    packed = bytes([0x17, 0x5F, 0xF0, 0xBC, 0x77, 0xA9, 0x21, 0x00, 0x34, 0xB5])
    stream = b"\xa0" + (b"\x02" + packed + b"\0\0\0") + bytes(32)
    values = np.frombuffer(meshopt.decode(stream, 16, 4, "ATTRIBUTES"), np.int8).reshape(16, 4)
    deltas = [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]
    assert np.diff(values[:, 0], prepend=np.int8(0)).tolist() == deltas
    assert not values[:, 1:].any()


def test_filters():
    words = np.array(
        [[0x02000003, 0x00FFFFFF, -0x01000001]], "<i4"
    )  # exponent and mantissa: 2 and 3, 0 and −1, −2 and −1
    made = np.frombuffer(meshopt.decode(compressed(words.view(np.uint8)), 1, 12, "ATTRIBUTES", "EXPONENTIAL"), "<f4")
    np.testing.assert_array_equal(made, [12.0, -1.0, -0.25])
    stored = np.array([[0, 0, 2047, 2044 | 2], [100, -200, 0, 2044 | 3]], "<i2")
    made = meshopt.decode(compressed(stored.view(np.uint8)), 2, 8, "ATTRIBUTES", "QUATERNION")
    turns = np.frombuffer(made, "<i2").reshape(2, 4) / 32767
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1, atol=1e-4)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(turns[0], [0, half, half, 0], atol=1e-4)
    np.testing.assert_allclose(turns[1, :3], [100 / 2047 * half, -200 / 2047 * half, 0], atol=1e-4)
    for name in ("OCTAHEDRAL", "COLOR"):
        with pytest.raises(BadInput, match=name):
            meshopt.decode(compressed(stored.view(np.uint8)), 2, 8, "ATTRIBUTES", name)


def test_every_prefix_is_an_error():
    elements = np.random.default_rng(1).integers(0, 256, (40, 16)).astype(np.uint8)
    data = compressed(elements)
    for stop in range(len(data)):
        with pytest.raises(BadInput):
            meshopt.decode(data[:stop], 40, 16, "ATTRIBUTES")
    with pytest.raises(BadInput):
        meshopt.decode(data, 40, 16, "TRIANGLES")


def test_a_compressed_animation(tmp_path):
    times, swing = np.arange(30) / 30, about("x", 40 * np.sin(np.arange(30) / 6))
    plain = Build(leg(), [{"joints": [0, 1, 2, 3]}]).animation().move(1, "rotation", times, swing)
    expected = gltf.read(plain.glb(tmp_path / "x.glb")).positions
    build = Build(leg(), [{"joints": [0, 1, 2, 3]}]).animation()
    packed = compressed(swing.astype("<f4").view(np.uint8))
    extension = {"buffer": 0, "byteLength": len(packed), "byteStride": 16, "count": 30, "mode": "ATTRIBUTES"}
    view = build.view(packed)
    extension["byteOffset"] = build.json["bufferViews"][view]["byteOffset"]
    build.json["bufferViews"][view] = {
        "buffer": 1, "byteLength": 480, "extensions": {"EXT_meshopt_compression": extension},
    }  # fmt: skip
    build.move(1, "rotation", times, build.accessor(swing, bufferView=view))
    build.json["buffers"].append({"byteLength": 480, "extensions": {"EXT_meshopt_compression": {"fallback": True}}})
    build.json["extensionsUsed"] = build.json["extensionsRequired"] = ["EXT_meshopt_compression"]
    np.testing.assert_array_equal(gltf.read(build.glb(tmp_path / "y.glb")).positions, expected)
    extension["byteOffset"] += 4
    extension["byteLength"] -= 4
    with pytest.raises(BadInput, match="EXT_meshopt_compression"):
        gltf.read(build.glb(tmp_path / "y.glb"))
