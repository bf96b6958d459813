"""PCD: the encodings, colours, what is left out, folders, damage."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import formats, native
from mocodec.errors import BadInput, MocodecError, Truncated
from mocodec.formats import folders, lzf, pcd
from mocodec.pointcloud import PointClouds

ENCODINGS = ("ascii", "binary", "binary_compressed")
FIELDS = [("x", "f4", 1), ("y", "f4", 1), ("z", "f4", 1), ("_", "u1", 4), ("rgb", "f4", 1), ("hist", "u2", 3)]


def compressed(data: bytes) -> bytes:
    """LZF of data: a reference to the last place of the same three bytes, where it is near enough."""
    result, literals, places, at = bytearray(), bytearray(), dict[bytes, int](), 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            result.extend([len(run) - 1, *run])
        literals.clear()

    while at < len(data):
        before = places.get(data[at : at + 3], -1)
        places[data[at : at + 3]] = at
        if at + 3 > len(data) or before < 0 or at - before > 8192:
            literals.append(data[at])
            at += 1
            continue
        flush()
        length, back = 3, at - before - 1
        while length < 264 and at + length < len(data) and data[before + length] == data[at + length]:
            length += 1
        short = min(length - 2, 7)
        result.extend([short << 5 | back >> 8, *([length - 9] if short == 7 else []), back & 255])
        at += length
    flush()
    return bytes(result)


def header(fields: list[tuple[str, str, int]], points: int, encoding: str, **lines: str) -> str:
    names, kinds, counts = zip(*fields, strict=True)
    given = {
        "VERSION": "0.7", "FIELDS": " ".join(names), "SIZE": " ".join(kind[1] for kind in kinds),
        "TYPE": " ".join(kind[0].upper() for kind in kinds), "COUNT": " ".join(map(str, counts)),
        "WIDTH": str(points), "HEIGHT": "1", "VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": str(points),
    }  # fmt: skip
    texts = [f"{name} {text}" for name, text in (given | lines).items()]
    return "\n".join(["# .PCD v0.7 - Point Cloud Data file format", *texts, f"DATA {encoding}", ""])


def pcd_file(fields: list[tuple[str, str, int]], rows: np.ndarray, encoding: str, **lines: str) -> bytes:
    """A PCD file of a structured array; padding is left out of compressed data, as the Point Cloud Library does."""
    head = header(fields, len(rows), encoding, **lines).encode()
    if encoding == "binary":
        return head + rows.tobytes()
    names = [name for name in rows.dtype.names or () if encoding == "ascii" or not name.startswith("_")]
    if encoding == "binary_compressed":
        data = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in names)
        packed = compressed(data)
        return head + np.array([len(packed), len(data)], "<u4").tobytes() + packed
    cells = [[f"{value:.9g}" for name in names for value in np.atleast_1d(row[name])] for row in rows]
    return head + "".join(" ".join(row) + "\n" for row in cells).encode()


def scene(points: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Rows of FIELDS, of which every fourth has no coordinates, and their colours."""
    rng = np.random.default_rng(1)
    rows = np.zeros(
        points, [(name, "<" + kind, count) if count > 1 else (name, "<" + kind) for name, kind, count in FIELDS]
    )
    for axis in "xyz":
        rows[axis] = rng.normal(size=points).round(2)
    colours = rng.integers(0, 256, (points, 3)).astype(np.uint8)
    bits = colours.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    rows["rgb"] = bits.astype("<u4").view("<f4")
    rows["x"][::4] = np.nan
    return rows, colours


def read(path: Path, **options) -> PointClouds:
    clouds = formats.read(path, fps=30, **options)
    assert isinstance(clouds, PointClouds)
    return clouds


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_points_colours_and_what_is_left_out(tmp_path, encoding):
    rows, colours = scene()
    (tmp_path / "a.pcd").write_bytes(pcd_file(FIELDS, rows, encoding))
    clouds = read(tmp_path / "a.pcd")
    kept = np.isfinite(rows["x"])
    np.testing.assert_array_equal(clouds.positions[0], np.stack([rows[axis] for axis in "xyz"], axis=1)[kept])
    assert clouds.colours is not None
    np.testing.assert_array_equal(clouds.colours[0], colours[kept])
    assert clouds.source["ignored"] == ["hist"]
    assert f"{pcd.WITHOUT_POSITION}: 10" in formats.notes(clouds)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_normals_wide_types_and_separate_colours(tmp_path, encoding):
    fields = [("x", "f8", 1), ("y", "i2", 1), ("z", "i8", 1), *((f"normal_{axis}", "f4", 1) for axis in "xyz")]
    fields += [("curvature", "f4", 1), *((name, "u1", 1) for name in "rgb")]
    rows = np.zeros(2, [(name, "<" + kind) for name, kind, _ in fields])
    rows["x"], rows["y"], rows["normal_z"], rows["r"], rows["b"] = [1.5, -2.25], [-7, 9], 1, 255, [3, 4]
    (tmp_path / "a.pcd").write_bytes(pcd_file(fields, rows, encoding))
    clouds = read(tmp_path / "a.pcd", unit="mm", up="z")
    np.testing.assert_allclose(clouds.positions[0], [[0.0015, -0.007, 0], [-0.00225, 0.009, 0]])
    assert clouds.colours is not None
    assert clouds.normals is not None
    assert (clouds.colours[0].tolist(), clouds.normals[0].tolist()) == ([[255, 0, 3], [255, 0, 4]], [[0, 0, 1]] * 2)
    assert (clouds.up, clouds.source["ignored"], clouds.source["units"]) == ("z", ["curvature"], "mm")


@pytest.mark.parametrize(
    ("kind", "value", "colour", "note"),
    [
        ("U", str(0xFF102030), (16, 32, 48), ""),
        ("I", str(0x102030), (16, 32, 48), ""),
        ("I", str(0xFF102030 - (1 << 32)), (16, 32, 48), ""),
        ("F", f"{np.uint32(0x102030).view(np.float32):.9g}", (16, 32, 48), ""),
        ("F", f"{np.uint32(0xFF102030).view(np.float32):.9g}", (16, 32, 48), ""),
        ("F", "4.2108e+06", (64, 64, 112), pcd.AS_NUMBERS),
        ("F", "nan", (0, 0, 0), pcd.LOST_COLOURS),
    ],
)
def test_packed_colours_in_text(tmp_path, kind, value, colour, note):
    fields = [("x", "f4", 1), ("y", "f4", 1), ("z", "f4", 1), ("rgba", f"{kind}4", 1)]
    (tmp_path / "a.pcd").write_text(header(fields, 1, "ascii") + f"1 2 3 {value}\n")
    clouds = read(tmp_path / "a.pcd")
    assert clouds.colours is not None
    assert clouds.colours[0].tolist() == [list(colour)]
    assert formats.notes(clouds) == ([f"{note}: 1"] if note else [])


def test_old_headers_organised_clouds_and_viewpoints(tmp_path):
    (tmp_path / "a.pcd").write_bytes(
        b"# .PCD v.5\r\nCOLUMNS X y Z\r\nPOINTS 2\r\nDATA ascii\r\n1 2 3\r\n\r\n4 5 6\r\n7 8 9\r\n"
    )
    assert read(tmp_path / "a.pcd").positions[0].tolist() == [[1, 2, 3], [4, 5, 6]]
    (tmp_path / "a.pcd").write_text(
        header(FIELDS[:3], 4, "ascii", WIDTH="2", HEIGHT="2", VIEWPOINT="0 0 1 1 0 0 0") + "0 0 0\n" * 4
    )
    clouds = read(tmp_path / "a.pcd")
    assert (len(clouds.positions[0]), formats.notes(clouds)) == (4, [f"{pcd.NOT_APPLIED}: 1"])
    for encoding in ENCODINGS:
        (tmp_path / "a.pcd").write_text(header(FIELDS, 0, encoding))
        assert read(tmp_path / "a.pcd").positions[0].shape == (0, 3)


def test_folders_and_globs(tmp_path):
    rows, _ = scene(3)
    for i in (10, 9, 100):
        rows["x"] = i
        (tmp_path / f"f{i}.pcd").write_bytes(pcd_file(FIELDS, rows, "binary"))
    assert [points[0, 0] for points in read(tmp_path).positions] == [9, 10, 100]
    assert len(read(tmp_path / "f1*.pcd")) == 2
    assert folders.below(str(tmp_path), formats.FORMATS) == [str(tmp_path)]
    assert formats.read_options(tmp_path / "f9.pcd") == formats.read_options(tmp_path)
    with pytest.raises(BadInput, match="PCD files store no frame rate"):
        formats.read(tmp_path)
    with pytest.raises(BadInput, match="read, not written"):
        mc.write(tmp_path / "x.pcd", read(tmp_path))
    mc.write(tmp_path / "out", read(tmp_path))
    assert len(formats.read(tmp_path / "out")) == 3
    (tmp_path / "f1.ply").write_bytes(b"")
    with pytest.raises(BadInput, match=r"\.pcd and \.ply files"):
        read(tmp_path)
    (tmp_path / "f1.ply").unlink()
    (tmp_path / "f101.pcd").write_bytes((tmp_path / "f9.pcd").read_bytes()[:-1])
    with pytest.raises(Truncated, match=r"f101\.pcd"):
        read(tmp_path)
    assert len(read(tmp_path, salvage=True)) == 3


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ({"WIDTH": str(1 << 40), "POINTS": str(1 << 40)}, "ends before|take"),
        ({"WIDTH": "9" * 30, "POINTS": "9" * 30}, "points"),
        ({"WIDTH": "-4", "POINTS": "-4"}, "says -4 points"),
        ({"WIDTH": "7"}, "WIDTH × HEIGHT"),
        ({"POINTS": "many"}, "bad header line"),
        ({"COUNT": "1 1 1 4 1 -3"}, "count of -3"),
        ({"COUNT": f"1 1 1 4 1 {1 << 40}"}, "count of"),
        ({"COUNT": "1 1 1"}, "different numbers"),
        ({"SIZE": "4 4 4 1 4 3"}, "unknown type"),
        ({"TYPE": "F F F U F Q"}, "unknown type"),
        ({"FIELDS": "x y z _ rgb rgb"}, "several fields"),
        ({"FIELDS": "x y w _ rgb hist"}, "no fields x, y and z"),
        ({"VIEWPOINT": "here"}, "bad header line"),
    ],
)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_headers_that_cannot_be(tmp_path, encoding, lines, message):
    (tmp_path / "a.pcd").write_bytes(pcd_file(FIELDS, scene()[0], encoding, **lines))
    with pytest.raises((BadInput, Truncated), match=rf"a\.pcd: .*({message})"):
        read(tmp_path / "a.pcd")


def test_files_that_are_no_pcd(tmp_path):
    whole = pcd_file(FIELDS, scene()[0], "binary")
    for data, message in (
        (b"", "empty"),
        (b"ply\n", "not a PCD"),
        (b"# comment\n" * 100_000, "header does not end"),
        (whole.replace(b"DATA binary", b"DATA binary_zstd"), "unknown PCD encoding"),
        (re.sub(rb"(WIDTH|HEIGHT|POINTS).*\n", b"", whole), "no number of points"),
    ):
        (tmp_path / "a.pcd").write_bytes(data)
        with pytest.raises(MocodecError, match=rf"a\.pcd: .*{message}"):
            read(tmp_path / "a.pcd")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_prefix_and_flip_raises_or_reads(tmp_path, encoding):
    whole = pcd_file(FIELDS, scene(12)[0], encoding)
    cut = tmp_path / "cut.pcd"
    for size in range(0, len(whole) - 2, 5):
        cut.write_bytes(whole[:size])
        with pytest.raises(MocodecError):
            read(cut)
    rng = np.random.default_rng(2)
    for at in rng.integers(0, len(whole), 150):
        cut.write_bytes(whole[:at] + bytes([whole[at] ^ 0x15]) + whole[at + 1 :])
        with contextlib.suppress(MocodecError):
            read(cut)


LZF_CASES = [
    (b"", b""),
    (b"\x02abc", b"abc"),
    (b"\x02abc\x20\x02", b"abcabc"),
    (b"\x00a\xe0\xff\x00", b"a" * 265),
    (b"\x01ab\x80\x01", b"ab" + b"ab" * 3),
]


@pytest.mark.parametrize("compiled", [True, False])
def test_lzf(compiled):
    if compiled and native.kernel("lzf_decompress") is None:
        pytest.skip("the compiled module is not built")
    rng = np.random.default_rng(3)
    texts = [rng.integers(0, most, 3000).astype(np.uint8).tobytes() for most in (1, 2, 9, 256)]
    with contextlib.nullcontext() if compiled else native.without():
        for packed, text in [*LZF_CASES, *((compressed(text), text) for text in texts)]:
            assert lzf.decompress(packed, len(text)).tobytes() == text
            for size in {len(text) + 1, max(len(text) - 1, 0)} - {len(text)}:
                with pytest.raises(ValueError, match=r"size|bytes"):
                    lzf.decompress(packed, size)
        for packed in (b"\x02ab", b"\x02abc\x20", b"\x02abc\xe0\x00", b"\x02abc\x20\x03", b"\x20\x00", b"\x02abc\xe0"):
            with pytest.raises(ValueError, match=r"a reference|number of bytes|size"):
                lzf.decompress(packed, 6)


def test_lzf_of_damaged_data_is_the_same_in_both_implementations():
    if native.kernel("lzf_decompress") is None:
        pytest.skip("the compiled module is not built")
    rng = np.random.default_rng(4)

    def outcome(data: bytes) -> bytes | None:
        try:
            return lzf.decompress(data, 600).tobytes()
        except ValueError:
            return None

    packed = compressed(rng.integers(0, 3, 600).astype(np.uint8).tobytes())
    for at in range(len(packed)):
        damaged = packed[:at] + bytes([packed[at] ^ 1 << int(rng.integers(8))]) + packed[at + 1 :]
        with native.without():
            expected = outcome(damaged)
        assert outcome(damaged) == expected
