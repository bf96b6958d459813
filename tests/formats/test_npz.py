"""NPZ: ours round trip, others' keys, and archives that lie."""

from __future__ import annotations

import contextlib
import io
import tracemalloc
import zipfile

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, formats
from mocodec.cli import run
from mocodec.formats import numpy_files

from .samples import BVH, markers


def save(tmp_path, **arrays):
    np.savez(tmp_path / "x.npz", **arrays)
    return tmp_path / "x.npz"


def test_round_trip(tmp_path):
    motion = markers()
    formats.write(tmp_path / "x.npz", motion)
    again = formats.read(tmp_path / "x.npz")
    assert np.array_equal(again.positions, motion.positions, equal_nan=True)
    assert (again.names, again.rate, again.up) == (motion.names, motion.rate, motion.up)


def test_skeleton_and_rotations_go_along(tmp_path):
    (tmp_path / "x.bvh").write_text(BVH)
    motion = formats.read(tmp_path / "x.bvh")
    formats.write(tmp_path / "x.npz", motion)
    again = formats.read(tmp_path / "x.npz")
    assert np.array_equal(again.rotations, motion.rotations)
    assert again.skeleton.parents == motion.skeleton.parents
    formats.write(tmp_path / "y.bvh", again)
    assert formats.read(tmp_path / "y.bvh").names == motion.names


@pytest.mark.parametrize("key", ["joints", "jtr", "positions"])
def test_keys_of_machine_learning_data_sets(tmp_path, key):
    positions = np.random.default_rng(1).normal(size=(6, 22, 3)).astype(np.float32)
    motion = formats.read(save(tmp_path, **{key: positions}, mocap_framerate=30.0, poses=np.zeros((6, 66))))
    assert np.array_equal(motion.positions, positions.astype(float))
    assert motion.rate == 30.0
    assert formats.read(save(tmp_path, **{key: positions}), rate=60).rate == 60.0


def test_marker_files(tmp_path):
    positions = np.random.default_rng(1).normal(size=(6, 3, 3)) * 500
    positions[2, 1] = 0
    path = save(tmp_path, markers=positions, labels=np.array(["A", "B", "C"]), frame_rate=120.0)
    motion = formats.read(path)
    assert motion.names == ("A", "B", "C")
    assert np.argwhere(motion.gaps).tolist() == [[2, 1]]
    assert np.allclose(motion.positions[0], positions[0] * 1e-3)
    assert np.allclose(formats.read(path, unit="m", up="y").positions[0], positions[0])


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"positions": np.zeros((5, 3)), "poses": np.zeros((5, 156)), "rate": 1.0}, r"\(frames, points, 3\)"),
        ({"other": np.zeros(3)}, "none of the arrays"),
        ({"positions": np.zeros((5, 3)), "rate": 1.0}, r"\(frames, points, 3\)"),
        ({"positions": np.zeros((5, 2, 3))}, "rate="),
        ({"positions": np.zeros((5, 2, 3)), "rate": np.nan}, "rate must be"),
        ({"positions": np.array([[["a", "b", "c"]]]), "rate": 1.0}, "must be numbers"),
        ({"positions": np.full((5, 2, 3), np.inf), "rate": 1.0, "up": "y"}, "infinite"),
        ({"positions": np.zeros((5, 2, 3)), "rate": 1.0, "unit": "yard"}, "yard"),
        ({"positions": np.zeros((5, 2, 3)), "rate": 1.0, "source": "[1]"}, "JSON object"),
        ({"positions": np.array([[[None, 1, 2]]]), "rate": 1.0}, "Python objects"),
        ({"positions": np.zeros((0, 2, 3)), "rate": np.zeros(0)}, "'rate' is empty"),
        ({"positions": np.zeros((5, 2, 3)), "fps": np.array([30, 60])}, r"'fps' holds values that differ .*rate="),
        ({"poses": np.zeros((5, 66)), "fps": np.array([30.0, 60.0])}, r"'fps' holds values that differ .*rate="),
        ({"joints": np.zeros((5, 6)), "rate": 1.0}, r"joints\.reshape\(-1, 2, 3\)"),
    ],
)
def test_invalid_arrays_raise_one_line(tmp_path, arrays, says):
    with pytest.raises(BadInput, match=says):
        formats.read(save(tmp_path, **arrays))


def test_a_rate_that_is_repeated_is_one(tmp_path):
    assert formats.read(save(tmp_path, positions=np.zeros((5, 2, 3)), fps=np.full(5, 30.0))).rate == 30


@pytest.mark.parametrize("claimed", [(1000000000, 100, 3), (2, 2, 3), (1, 0, 3)])
def test_an_array_with_a_false_declared_size(tmp_path, claimed):
    raw = io.BytesIO()
    np.lib.format.write_array_header_1_0(raw, {"descr": "<f8", "fortran_order": False, "shape": claimed})
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("positions.npy", raw.getvalue() + bytes(24))
    with pytest.raises(BadInput, match="cut off or damaged"):
        formats.read(tmp_path / "x.npz", rate=1)


def test_point_clouds(tmp_path):
    rng = np.random.default_rng(0)
    positions = [rng.normal(size=(n, 3)) for n in (4, 0, 7)]
    colours = [rng.integers(0, 256, p.shape).astype(np.uint8) for p in positions]
    clouds = mc.PointClouds(positions, 15.0, colours, up="z")
    mc.write(tmp_path / "clouds.npz", clouds)
    back = mc.read(tmp_path / "clouds.npz")
    assert isinstance(back, mc.PointClouds)
    assert (back.rate, back.up, len(back)) == (15.0, "z", 3)
    assert back.colours is not None
    for i in range(3):
        np.testing.assert_array_equal(back.positions[i], positions[i])
        np.testing.assert_array_equal(back.colours[i], colours[i])
    np.savez(tmp_path / "bad.npz", points=np.zeros((5, 3)), counts=[2, 2], rate=15)
    with pytest.raises(mc.BadInput, match="counts"):
        mc.read(tmp_path / "bad.npz")
    np.savez(tmp_path / "mm.npz", points=np.full((2, 3), 1000), counts=[1, 1], fps=30, unit="mm")
    metres = mc.read(tmp_path / "mm.npz")
    assert isinstance(metres, mc.PointClouds)
    assert metres.positions[1].tolist() == [[1.0, 1.0, 1.0]]


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_only_what_numpy_writes_is_inflated(tmp_path, method):
    raw = io.BytesIO()
    np.save(raw, np.zeros((200_000, 5, 3)))
    with zipfile.ZipFile(tmp_path / "x.npz", "w", method) as archive:
        archive.writestr("positions.npy", raw.getvalue())
    tracemalloc.start()
    with pytest.raises(BadInput, match="compressed by a method"):
        formats.read(tmp_path / "x.npz", rate=1)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_no_more_is_inflated_than_is_declared(tmp_path):
    raw = io.BytesIO()
    np.save(raw, np.zeros((100_000, 5, 3)))
    with zipfile.ZipFile(tmp_path / "x.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("positions.npy", raw.getvalue())
    data = (tmp_path / "x.npz").read_bytes()
    true_size, lie = (n.to_bytes(4, "little") for n in (len(raw.getvalue()), 2048))
    (tmp_path / "x.npz").write_bytes(data.replace(true_size, lie))
    with pytest.raises(BadInput):
        formats.read(tmp_path / "x.npz", rate=1)


def test_a_header_that_is_not_python(tmp_path):
    header = b"{'descr': ('<f8', 'shape': (3,"
    member = b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("positions.npy", member)
    with pytest.raises(BadInput):
        formats.read(tmp_path / "x.npz", rate=1)


def test_a_source_of_the_wrong_types_is_left_out(tmp_path):
    source = '{"format": 5, "unit_m": "x", "first_frame": "y", "subject": "A"}'
    motion = formats.read(save(tmp_path, positions=np.zeros((5, 2, 3)), rate=1.0, up="y", source=source))
    assert dict(motion[2:].source)["subject"] == "A"
    assert not {"format", "unit_m", "first_frame"} & motion.source.keys()
    assert any("format, unit_m, first_frame" in note for note in formats.notes(motion))


def test_control_characters_do_not_reach_the_terminal(tmp_path, capsys):
    names = np.array(["\x1b]0;title\x07", "a\rb\x1b[2J"])
    source = '{"note\\u001b[31m": "\\u001b[31m", "notes": ["\\u001b[31mred"]}'
    path = save(tmp_path, positions=np.ones((5, 2, 3)), rate=10.0, up="y", names=names, source=source)
    assert run(["info", str(path)]) == 0
    assert run(["compare", str(path), str(path)]) == 0
    printed = "".join(capsys.readouterr())
    assert "]0;title" in printed
    assert "red" in printed
    assert all(c.isprintable() or c == "\n" for c in printed)


@pytest.mark.parametrize("saver", [np.savez, np.savez_compressed])
def test_a_cut_archive_is_read_as_far_as_it_goes(tmp_path, saver):
    positions = np.random.default_rng(2).normal(size=(200, 7, 3))
    whole = {"rate": np.array(50.0), "names": np.array([f"M{i}" for i in range(7)]), "positions": positions}
    saver(tmp_path / "x.npz", **whole, parents=np.zeros(7, int))
    data = (tmp_path / "x.npz").read_bytes()
    (tmp_path / "x.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(BadInput, match=r"cut off: the directory .* --salvage"):
        formats.read(tmp_path / "x.npz")
    motion = formats.read(tmp_path / "x.npz", salvage=True)
    assert isinstance(motion, mc.Motion)
    assert 50 < len(motion) < 150
    assert np.array_equal(motion.positions, positions[: len(motion)])
    assert (motion.rate, motion.names[6]) == (50.0, "M6")
    assert any("of 200 rows of 'positions'" in note for note in formats.notes(motion))
    (tmp_path / "x.npz").write_bytes(data[: data.rindex(b"PK\x03\x04")])
    assert np.array_equal(formats.read(tmp_path / "x.npz", salvage=True).positions, positions)


def test_every_prefix_of_an_archive_is_read_or_one_line(tmp_path):
    np.savez(tmp_path / "x.npz", rate=np.array(50.0), poses=np.zeros((9, 156)), trans=np.zeros((9, 3)))
    data = (tmp_path / "x.npz").read_bytes()
    frames = set()
    for end in range(0, len(data), 97):
        (tmp_path / "y.npz").write_bytes(data[:end])
        with contextlib.suppress(BadInput):
            frames.add(len(formats.read(tmp_path / "y.npz", salvage=True)))
    assert {1, 5, 9} <= frames


def test_names_that_are_objects_are_left_out_with_a_note(tmp_path):
    names = np.array(["a", "b"], dtype=object)
    np.savez(tmp_path / "x.npz", positions=np.ones((3, 2, 3)), rate=30.0, names=names)
    motion = formats.read(tmp_path / "x.npz")
    assert motion.names == ("P1", "P2")
    assert any("'names' holds Python objects" in note for note in formats.notes(motion))


def test_pieces_have_the_unit_of_their_own_array_and_read_it_once(tmp_path, monkeypatch):
    read = []
    load = numpy_files.Rows.load
    monkeypatch.setattr(numpy_files.Rows, "load", lambda rows, name: read.append(name) or load(rows, name))
    np.savez(tmp_path / "x.npz", positions=np.full((9, 2, 3), 1000.0), rate=30.0, unit="mm")
    blocks = formats.read_blocks(tmp_path / "x.npz")
    assert read.count("positions") == 1
    assert np.allclose(next(iter(blocks.parts())).positions, 1.0)
