"""Reading and writing by suffix; errors are one line."""

from __future__ import annotations

import contextlib
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocodec import BadInput, PointClouds, Signal, formats
from mocodec.testing import synthetic

from .samples import SHARED, capture, markers, needs_shared


def test_suffix_in_any_case(tmp_path):
    formats.write(tmp_path / "A.TRC", markers())
    assert formats.read(tmp_path / "A.TRC").points == 5


@pytest.mark.parametrize("name", ["walk.obj", "walk"])
def test_an_unknown_suffix_lists_the_known(tmp_path, name):
    (tmp_path / name).write_bytes(b"?")
    with pytest.raises(BadInput, match=r"\.c3d .*\.bvh .*\.mocz"):
        formats.read(tmp_path / name)
    with pytest.raises(BadInput, match=r"\.c3d"):
        formats.write(tmp_path / name, markers())


def test_an_fbx_is_refused_with_what_to_do(tmp_path):
    (tmp_path / "walk.fbx").write_bytes(b"?")
    with pytest.raises(BadInput, match=r"neither read nor written.*\.glb or \.bvh"):
        formats.read(tmp_path / "walk.fbx")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(BadInput, match="no such file"):
        formats.read(tmp_path / "gone.c3d")
    with pytest.raises(BadInput, match="there is no folder"):
        formats.write(tmp_path / "no" / "folder.c3d", markers())


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".c3d", ".csv", ".amc"])
def test_point_clouds_are_no_motion(tmp_path, suffix):
    clouds = PointClouds([np.zeros((1, 3))], 5.0)
    with pytest.raises(BadInput, match=f"{suffix} stores motions, not point clouds; name a folder"):
        formats.write(tmp_path / f"x{suffix}", clouds)


def test_a_motion_is_no_point_cloud(tmp_path):
    with pytest.raises(BadInput, match="not motions"):
        formats.write(tmp_path / "x.ply", markers()[:1])


def test_an_option_of_another_format(tmp_path):
    formats.write(tmp_path / "x.trc", markers())
    with pytest.raises(BadInput, match="no option 'asf'"):
        formats.read(tmp_path / "x.trc", asf="y.asf")


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh", ".amc", ".npz", ".glb"])
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
        formats.replace_whole(tmp_path / "a.bin", None)  # pyright: ignore[reportArgumentType]
    assert (tmp_path / "a.bin").read_bytes() == b"first"
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]


def test_replace_whole_follows_links_and_keeps_permissions(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "a.bin", tmp_path / "link.bin"
    target.write_bytes(b"before")
    target.chmod(0o640)
    link.symlink_to(target)
    formats.replace_whole(link, b"after")
    assert link.is_symlink()
    assert target.read_bytes() == b"after"
    assert target.stat().st_mode & 0o777 == 0o640
    (tmp_path / "new.bin").symlink_to(tmp_path / "there" / "b.bin")  # to a file that is not there yet
    formats.replace_whole(tmp_path / "new.bin", b"new")
    assert sorted(p.name for p in (tmp_path / "there").iterdir()) == ["a.bin", "b.bin"]


def test_replace_whole_gives_a_new_file_the_usual_permissions(tmp_path):
    before = os.umask(0o027)
    try:
        formats.replace_whole(tmp_path / "a.bin", b"")
    finally:
        os.umask(before)
    assert (tmp_path / "a.bin").stat().st_mode & 0o777 == 0o640


def test_replace_whole_names_what_it_was_asked_for(tmp_path):
    for path in (tmp_path, tmp_path / "no" / "folder.bin"):
        with pytest.raises(BadInput, match=re.escape(f"{path}: ")) as error:
            formats.replace_whole(path, b"")
        assert ".part" not in str(error.value)
    longest = tmp_path / ("n" * 251 + ".bin")
    formats.replace_whole(longest, b"x")
    assert longest.read_bytes() == b"x"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs the devices of a Linux")
def test_replace_whole_on_devices():
    formats.replace_whole("/dev/null", b"x")
    assert not Path("/dev/null").is_file()
    with pytest.raises(BadInput, match="/dev/full: "):
        formats.replace_whole("/dev/full", b"x")


@pytest.mark.parametrize(
    ("suffix", "expected"),
    [
        (".c3d", ["skeleton", "joint rotations"]),
        (".trc", ["analog channels", "events", "C3D parameters", "skeleton", "joint rotations"]),
        (".npz", ["analog channels", "events", "C3D parameters"]),
        (".bvh", ["analog channels", "events", "C3D parameters"]),
        (".amc", ["analog channels", "events", "C3D parameters"]),
    ],
)
def test_dropped_lists_what_a_format_cannot_hold(suffix, expected):
    figure = synthetic.joints(5)
    assert formats.dropped(f"x{suffix}", replace(figure, extras=capture().extras)) == expected
    assert formats.dropped(f"x{suffix}", markers()) == []


ODD = (None, "a", -1, 1e300, float("nan"), [], ["zyx*x"], {}, [3])


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh", ".amc", ".npz"])
@pytest.mark.parametrize("key", ["units", "unit_m", "first_frame", "channels", "residual_word", "up_guessed"])
def test_invalid_sources_are_refused_or_ignored(tmp_path, suffix, key):
    """Sources come from files, which may be wrong."""
    good = {"format": suffix[1:], "units": "cm", "unit_m": 0.01, "first_frame": 1, "channels": ["XYZzyx*21"]}
    figure = synthetic.joints(3)
    for value in ODD:
        motion = replace(figure, source={**good, key: value})
        with contextlib.suppress(BadInput):
            formats.write(tmp_path / f"x{suffix}", motion)


@pytest.mark.parametrize("key", ["analog", "events", "parameters", "parameter_notes", "residuals", "rotations"])
def test_invalid_extras_raise_one_line_or_are_ignored(tmp_path, key):
    odd = [*ODD, [{"time_s": "now"}], [{}], {"POINT": 3}, {"POINT": {"SCALE": "x", "LABELS": {}}}, {"A" * 300: {}}]
    for value in odd:
        with contextlib.suppress(BadInput):
            formats.write(tmp_path / "x.c3d", replace(markers(), extras={**capture().extras, key: value}))


def test_signals_and_events_are_validated():
    with pytest.raises(BadInput, match="a signal is"):
        Signal(np.zeros(3), 0.0)
    with pytest.raises(BadInput, match="a signal is"):
        Signal(np.array(3), 100.0)
    for events in (3, [3], [{"label": "x"}], [{"time_s": "now"}], [{"time_s": float("nan")}]):
        with pytest.raises(BadInput, match="events"):
            replace(markers(), extras={"events": events})


def test_dropped_names_unknown_extras():
    assert formats.dropped("x.c3d", replace(markers(), extras={"subject": "A", "events": []})) == ["subject"]


@needs_shared
@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh"])
def test_every_real_file_reads_or_says_why_not(suffix):
    files = sorted(SHARED.rglob(f"*{suffix}"))
    assert files
    for path in files:
        message = ""
        try:
            motion = formats.read(path)
            assert motion.points == 0 or 0.3 < np.nanmax(np.abs(motion.positions)) < 30  # metres: people in rooms
        except BadInput as error:
            message = str(error)
        assert "\n" not in message
