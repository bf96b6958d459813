"""PLY: round trips, files of other programs, damage."""

from __future__ import annotations

import contextlib
import errno

import numpy as np
import pytest

from mocodec import formats
from mocodec.errors import BadInput, MocodecError, Truncated
from mocodec.formats import ply
from mocodec.pointcloud import PointClouds

ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")


def clouds(frames: int = 3, colours: bool = True, normals: bool = False) -> PointClouds:
    rng = np.random.default_rng(1)
    sizes = [50, 0, 3, 7][:frames]
    return PointClouds(
        positions=[rng.normal(size=(n, 3)).astype(np.float32).astype(np.float64) for n in sizes],
        rate=15.0,
        colours=[rng.integers(0, 256, (n, 3)).astype(np.uint8) for n in sizes] if colours else None,
        normals=[rng.normal(size=(n, 3)).astype(np.float32).astype(np.float64) for n in sizes] if normals else None,
        up="z",
    )


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("colours", "normals"), [(True, False), (False, False), (True, True)])
def test_round_trip(tmp_path, encoding, colours, normals):
    original = clouds(colours=colours, normals=normals)
    ply.write(tmp_path / "out", original, encoding=encoding)
    back = ply.read(tmp_path / "out")
    assert back.rate == 15.0
    assert back.up == "z"
    for what in ("positions", "colours", "normals"):
        a, b = getattr(original, what), getattr(back, what)
        assert (a is None) == (b is None)
        for x, y in zip(a or (), b or (), strict=True):
            np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_nan_points_and_doubles_survive(tmp_path, encoding):
    points = np.array([[1 / 3, 2.0, 3.0], [np.nan] * 3])
    ply.write(tmp_path / "a.ply", PointClouds([points], 10.0, source={"double": True}), encoding=encoding)
    back = ply.read(tmp_path / "a.ply")
    np.testing.assert_array_equal(back.positions[0], points)


def test_missing_rates_and_unknown_units_raise(tmp_path):
    file = tmp_path / "x.ply"
    head = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    file.write_bytes(head + b"end_header\n1000 0 5\n")
    with pytest.raises(BadInput, match="fps"):
        ply.read(file)
    np.testing.assert_allclose(ply.read(file, fps=30, unit="mm").positions[0], [[1.0, 0.0, 0.005]])
    with pytest.raises(BadInput, match="unit"):
        ply.read(file, fps=30, unit="furlong")


def test_unit_goes_back(tmp_path):
    original = PointClouds([np.array([[1.0, 2.0, 3.0]])], 5.0, source={"units": "mm", "unit_m": 0.001})
    ply.write(tmp_path / "x.ply", original, encoding="ascii")
    assert "1000 2000 3000" in (tmp_path / "x.ply").read_text()
    np.testing.assert_allclose(ply.read(tmp_path / "x.ply").positions[0], [[1.0, 2.0, 3.0]])


def test_natural_order_and_glob(tmp_path):
    for i in (10, 9, 100):
        ply.write(tmp_path / f"f{i}.ply", PointClouds([np.full((1, 3), float(i))], 5.0))
    assert [p[0, 0] for p in ply.read(tmp_path).positions] == [9, 10, 100]
    assert len(ply.read(tmp_path / "f1*.ply")) == 2


def test_other_elements_and_properties(tmp_path):
    file = tmp_path / "x.ply"
    lines = ["ply", "format binary_big_endian 1.0", "obj_info made elsewhere today", "element camera 2"]
    lines += ["property double f", "element vertex 2", "property uchar alpha"]
    lines += [f"property float {c}" for c in ("red", "green", "blue")] + [f"property double {c}" for c in "xyz"]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header", ""]
    header = "\r\n".join(lines).encode()
    row = np.zeros(2, [("alpha", "u1"), *[(c, ">f4") for c in "rgb"], *[(c, ">f8") for c in "xyz"]])
    row["r"], row["z"] = 1.0, [4.0, 5.0]
    face = b"\x03" + np.arange(3, dtype=">i4").tobytes()
    file.write_bytes(header + np.zeros(2, ">f8").tobytes() + row.tobytes() + face)
    back = ply.read(file, fps=1)
    np.testing.assert_array_equal(back.positions[0], [[0, 0, 4], [0, 0, 5]])
    assert back.colours is not None
    np.testing.assert_array_equal(back.colours[0], [[255, 0, 0]] * 2)
    assert back.source["ignored"] == ["alpha"]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_prefix_and_flip_raises_or_reads(tmp_path, encoding):
    ply.write(tmp_path / "x.ply", clouds(1)[0:1], encoding=encoding)
    whole = (tmp_path / "x.ply").read_bytes()
    cut = tmp_path / "cut.ply"
    for size in range(0, len(whole) - 1, 7):
        cut.write_bytes(whole[:size])
        if encoding == "ascii" and size > whole.index(b"end_header") + 100:
            continue
        with pytest.raises(MocodecError):
            ply.read(cut)
    rng = np.random.default_rng(2)
    for at in rng.integers(0, len(whole), 150):
        cut.write_bytes(whole[:at] + bytes([whole[at] ^ 0x15]) + whole[at + 1 :])
        with contextlib.suppress(MocodecError):
            ply.read(cut, fps=1)


def test_folders_are_not_overwritten_by_accident(tmp_path):
    ply.write(tmp_path / "out", clouds())
    with pytest.raises(BadInput, match="already"):
        ply.write(tmp_path / "out", clouds())
    ply.write(tmp_path / "out", clouds(2), overwrite=True)
    assert len(ply.read(tmp_path / "out")) == 2
    with pytest.raises(BadInput, match=r"no \.ply"):
        ply.read(tmp_path / "nothing", fps=1)


@pytest.mark.parametrize("old_frames", [0, 3])
def test_a_folder_is_written_as_a_whole_or_not_at_all(tmp_path, monkeypatch, old_frames):
    """A full disk at the second frame: frames that were there stay."""
    if old_frames:
        ply.write(tmp_path / "out", clouds(old_frames))
    before = {file.name: file.read_bytes() for file in tmp_path.rglob("*.ply")}
    real = ply.frame_bytes

    def full(recording, frame, encoding):
        if frame == 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(recording, frame, encoding)

    monkeypatch.setattr(ply, "frame_bytes", full)
    with pytest.raises(BadInput, match="No space left"):
        formats.write(tmp_path / "out", clouds(2), overwrite=True)
    assert {file.name: file.read_bytes() for file in tmp_path.rglob("*.ply")} == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"] * bool(old_frames)


def test_globs_and_folders_through_formats_read(tmp_path):
    for i in (1, 2, 11):
        ply.write(tmp_path / f"f{i}.ply", PointClouds([np.full((1, 3), float(i))], 5.0))
    for path, count in ((tmp_path, 3), (tmp_path / "f1*.ply", 2), (tmp_path / "f2.ply", 1)):
        assert len(formats.read(path)) == count


def test_faces_before_the_vertices(tmp_path):
    file = tmp_path / "x.ply"
    lines = ["ply", "format binary_little_endian 1.0", "element face 2", "property list uchar int vertex_indices"]
    lines += ["element vertex 2", "property float x", "property float y", "property float z", "end_header", ""]
    points = np.array([[1, 2, 3], [4, 5, 6]], "<f4")
    triangle, quad = (bytes([n]) + np.arange(n, dtype="<i4").tobytes() for n in (3, 4))
    file.write_bytes("\n".join(lines).encode() + 2 * triangle + points.tobytes())
    np.testing.assert_array_equal(ply.read(file, fps=1).positions[0], points)
    file.write_bytes("\n".join(lines).encode() + triangle + quad + points.tobytes())
    with pytest.raises(BadInput, match="different sizes"):
        ply.read(file, fps=1)
    file.write_bytes("\n".join(lines).encode() + triangle)
    with pytest.raises(Truncated):
        ply.read(file, fps=1)


def test_an_empty_file_and_missing_numbers_are_named(tmp_path):
    for i in (0, 1, 2, 5):
        ply.write(tmp_path / f"f{i}.ply", PointClouds([np.full((1, 3), float(i))], 5.0))
    assert ply.read(tmp_path).source["missing_numbers"] == 2
    (tmp_path / "f2.ply").write_bytes(b"")
    with pytest.raises(Truncated, match=r"f2\.ply: is empty"):
        ply.read(tmp_path)


def test_numbers_of_files_without_a_usual_step_miss_nothing(tmp_path):
    for i in range(6):
        ply.write(tmp_path / f"f{i * i}.ply", PointClouds([np.full((1, 3), float(i))], 5.0))
    assert "missing_numbers" not in ply.read(tmp_path).source


def test_points_too_large_for_metres_are_noted_unless_the_unit_is_known(tmp_path):
    ascii_file(tmp_path / "f1.ply", "0 0 0 1 2 3\n0 1800 0 1 2 3", kind="uchar")
    assert any("1,800 m" in note and "--unit mm" in note for note in formats.notes(ply.read(tmp_path, fps=1)))
    assert formats.notes(ply.read(tmp_path, fps=1, unit="mm")) == []


def test_colours_that_only_later_frames_have_are_noted(tmp_path):
    ply.write(tmp_path / "f1.ply", PointClouds([np.zeros((1, 3))], 5.0))
    ascii_file(tmp_path / "f2.ply", "0 0 0 1 2 3\n0 1 0 1 2 3", kind="uchar")
    assert any(
        "colours of 1 frame are left out, since f1.ply has none" in note for note in formats.notes(ply.read(tmp_path))
    )


def test_a_comment_that_is_no_axis_is_no_vertical_axis(tmp_path):
    ply.write(tmp_path / "f1.ply", PointClouds([np.zeros((1, 3))], 5.0, up="z"), encoding="ascii")
    assert ply.read(tmp_path).up == "z"
    (tmp_path / "f1.ply").write_text((tmp_path / "f1.ply").read_text().replace("up z", "up north"))
    assert ply.read(tmp_path).up == "y"
    with pytest.raises(BadInput, match="up must be one of x, y, z"):
        PointClouds([np.zeros((1, 3))], 5.0, up="north")


def test_damage_among_ascii_vertices_names_what_is_there(tmp_path):
    ascii_file(tmp_path / "f1.ply", "0 0 0 1 2 3\n1 1 1 4 x5 6")
    with pytest.raises(BadInput, match="'x5' among its vertices is not a number"):
        ply.read(tmp_path, fps=1)
    ascii_file(tmp_path / "f1.ply", "0 0 0 1 2 3\n1 1 1 4 5 6 7")
    with pytest.raises(BadInput, match="its 2 vertices have 13 numbers, not 6 each"):
        ply.read(tmp_path, fps=1)


def test_a_device_is_no_frame(tmp_path):
    (tmp_path / "x.ply").symlink_to("/dev/zero")
    with pytest.raises(BadInput, match=r"no \.ply file"):
        ply.read(tmp_path / "x.ply", fps=1)


def test_names_of_properties_in_upper_case(tmp_path):
    ascii_file(tmp_path / "f1.ply", "0 0 0 1 2 3\n1 1 1 4 5 6", kind="uchar")
    header, rows = (tmp_path / "f1.ply").read_text().split("end_header")
    (tmp_path / "f1.ply").write_text(header.replace(" x", " X").replace(" red", " Red") + "end_header" + rows)
    clouds = ply.read(tmp_path, fps=1)
    assert clouds.colours is not None
    assert clouds.colours[0][1].tolist() == [4, 5, 6]
    assert clouds.positions[0][1].tolist() == [1, 1, 1]


def ascii_file(path, rows: str, count: str = "2", kind: str = "float") -> None:
    lines = ["ply", "format ascii 1.0", f"element vertex {count}", *(f"property float {axis}" for axis in "xyz")]
    lines += [f"property {kind} {colour}" for colour in ("red", "green", "blue")] + ["end_header", rows, ""]
    path.write_text("\n".join(lines))


@pytest.mark.parametrize("kind", ["float", "double"])
def test_float_colours_of_either_range(tmp_path, kind):
    ascii_file(tmp_path / "f1.ply", "0 0 0 145 131 170\n1 1 1 0.5 0 255", kind=kind)
    ascii_file(tmp_path / "f2.ply", "0 0 0 0 1 0\n1 1 1 0 0 0", kind=kind)  # the sequence decides
    motion = ply.read(tmp_path, fps=1)
    assert motion.colours is not None
    assert [c.tolist() for c in motion.colours] == [[[145, 131, 170], [0, 0, 255]], [[0, 1, 0], [0, 0, 0]]]
    assert any("0 to 255" in note for note in formats.notes(motion))
    ascii_file(tmp_path / "f1.ply", "0 0 0 0.5 1 0\n1 1 1 0 0 1.0000001", kind=kind)
    unit = ply.read(tmp_path, fps=1)
    assert unit.colours is not None
    assert unit.colours[0].tolist() == [[128, 255, 0], [0, 0, 255]]
    assert formats.notes(unit) == []


def test_points_and_normals_without_numbers_are_noted(tmp_path):
    points = np.array([[0, 0, 0], [np.nan] * 3, [1, np.inf, 1]])
    ply.write(
        tmp_path / "a.ply", PointClouds([points], 10.0, normals=[np.array([[0, 0, 1], [np.nan] * 3, [np.nan] * 3])])
    )
    assert [note[:8] for note in formats.notes(ply.read(tmp_path / "a.ply"))] == ["2 points", "2 normal"]


@pytest.mark.parametrize("count", ["99999999999999999999", "4611686018427387904", "1000000000000"])
def test_counts_beyond_the_file(tmp_path, count):
    for encoding in ENCODINGS:
        ascii_file(tmp_path / "a.ply", "0 0 0 0 0 0", count)
        data = (tmp_path / "a.ply").read_bytes().replace(b"ascii", encoding.encode())
        (tmp_path / "a.ply").write_bytes(data)
        with pytest.raises(MocodecError):
            ply.read(tmp_path / "a.ply", fps=1)
        (tmp_path / "a.ply").write_bytes(
            data.replace(b"element vertex", b"element face 1\nproperty list uchar int i\nelement vertex")
        )
        with pytest.raises(MocodecError):
            ply.read(tmp_path / "a.ply", fps=1)


def test_digits_of_other_scripts_in_names_of_files(tmp_path):
    for name in ("²1.ply", "²3.ply", "٣2.ply", "5.ply"):
        ascii_file(tmp_path / name, "0 0 0 0 0 0\n0 0 0 0 0 0")
    assert len(ply.read(tmp_path, fps=1)) == 4


def test_broken_frames_at_the_end_can_be_left_out(tmp_path):
    ply.write(tmp_path / "x", clouds(4))
    last = tmp_path / "x/frame_000003.ply"
    last.write_bytes(last.read_bytes()[:-20])
    with pytest.raises(Truncated):
        formats.read(tmp_path / "x")
    seen = formats.read(tmp_path / "x", salvage=True)
    assert len(seen) == 3
    assert any("1 frames at the end" in note for note in formats.notes(seen))
    (tmp_path / "x/frame_000004.ply").write_bytes((tmp_path / "x/frame_000000.ply").read_bytes())
    with pytest.raises(Truncated):
        formats.read(tmp_path / "x", salvage=True)
    with pytest.raises(Truncated):
        formats.read(last, salvage=True)
