"""One door for all formats: by suffix, with one line for what cannot be."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import BadInput, formats

from .samples import SHARED, markers, needs_shared


def test_suffix_in_any_case(tmp_path):
    formats.write(tmp_path / "A.TRC", markers())
    assert formats.read(tmp_path / "A.TRC").points == 5


@pytest.mark.parametrize("name", ["walk.fbx", "walk.glb", "walk"])
def test_an_unknown_suffix_lists_the_known(tmp_path, name):
    (tmp_path / name).write_bytes(b"?")
    with pytest.raises(BadInput, match=r"\.c3d .*\.bvh .*\.mocz"):
        formats.read(tmp_path / name)
    with pytest.raises(BadInput, match=r"\.c3d"):
        formats.write(tmp_path / name, markers())


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(BadInput, match="no such file"):
        formats.read(tmp_path / "gone.c3d")
    with pytest.raises(BadInput, match="cannot write"):
        formats.write(tmp_path / "no" / "folder.c3d", markers())


def test_an_option_of_another_format(tmp_path):
    formats.write(tmp_path / "x.trc", markers())
    with pytest.raises(BadInput, match="no option 'asf'"):
        formats.read(tmp_path / "x.trc", asf="y.asf")


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh", ".amc", ".npz"])
@pytest.mark.parametrize("content", [b"", b"\0" * 2000, b"not it\n" * 200, b"\xff\xfe\x80" * 600])
def test_other_content_under_every_suffix(tmp_path, suffix, content):
    (tmp_path / f"x{suffix}").write_bytes(content)
    (tmp_path / "x.asf").write_bytes(content)
    with pytest.raises(BadInput) as error:
        formats.read(tmp_path / f"x{suffix}")
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_replace_whole_leaves_nothing_half_written(tmp_path):
    formats.replace_whole(tmp_path / "a.bin", b"first")
    with pytest.raises(TypeError):
        formats.replace_whole(tmp_path / "a.bin", None)
    assert (tmp_path / "a.bin").read_bytes() == b"first"
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]


@needs_shared
@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh"])
def test_every_real_file_reads_or_says_why_not(suffix):
    files = sorted(SHARED.rglob(f"*{suffix}"))
    assert files
    for path in files:
        message = ""
        try:
            motion = formats.read(path)
            assert 0.3 < np.nanmax(np.abs(motion.positions)) < 30  # metres: people in rooms
        except BadInput as error:
            message = str(error)
        assert "\n" not in message
