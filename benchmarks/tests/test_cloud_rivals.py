"""Rivals of the point cloud codecs: round trips, records, and the report."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.cloud import command, maps, report, rivals, runner, video
from benchmarks.cloud.rivals import RIVALS
from mocodec.errors import CannotEncode, MissingExtra
from mocodec.metrics import point_clouds, splats
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

POINTS = 2500


@pytest.fixture(scope="module")
def performance() -> sequences.Performance:
    return sequences.jumping_jacks(actors.capsules(), 4)


@pytest.fixture(scope="module")
def clouds(performance) -> PointClouds:
    return sequences.record(performance, POINTS, normals=True)


def encoded(rival: rivals.CloudRival, clouds: PointClouds, knob: int) -> bytes:
    """Skips if the rival's package is not installed."""
    try:
        return rival.encode(clouds, knob)
    except MissingExtra as missing:
        pytest.skip(str(missing))


@pytest.mark.parametrize("name", RIVALS)
def test_round_trip(name, clouds):
    rival = RIVALS[name]
    plain = replace(clouds, normals=None)
    coarse, fine = encoded(rival, plain, rival.knobs[-1]), encoded(rival, plain, rival.knobs[0])
    assert len(coarse) <= len(fine) < clouds.raw_bytes
    assert rival.encode(plain, rival.knobs[0]) == fine
    decoded = rival.decode(fine)
    assert (len(decoded), decoded.rate, decoded.up) == (len(clouds), clouds.rate, clouds.up)
    assert decoded.colours is not None
    assert point_clouds.d1(clouds, decoded, 3) < 0.025  # a pixel is about 3.7 cm here
    assert point_clouds.views_psnr(clouds, decoded, 3) > 20
    assert rival.version()


@pytest.mark.parametrize("name", RIVALS)
def test_gaps_empty_frames_and_no_colours(name, clouds):
    rival = RIVALS[name]
    points = [clouds.positions[0].copy(), np.zeros((0, 3)), clouds.positions[2]]
    points[0][::7] = np.nan
    turned = PointClouds([p[:, [2, 0, 1]] for p in points], 30.0, up="z")
    decoded = rival.decode(encoded(rival, turned, rival.knobs[0]))
    assert decoded.colours is None
    assert (len(decoded), decoded.rate, decoded.up) == (3, 30.0, "z")
    assert len(decoded.positions[1]) == 0
    assert np.isfinite(decoded.positions[0]).all()
    assert point_clouds.d1(turned, decoded, 0) < 0.03


def test_zlib_is_lossless(clouds):
    decoded = RIVALS["zlib"].decode(RIVALS["zlib"].encode(clouds, 9))
    assert decoded.colours is not None
    assert clouds.colours is not None
    for frame in range(len(clouds)):
        np.testing.assert_array_equal(decoded.positions[frame], clouds.positions[frame])
        np.testing.assert_array_equal(decoded.colours[frame], clouds.colours[frame])


def test_yang_codes_depth_without_loss(clouds):
    views = maps.cameras(clouds)
    depth, _ = maps.forward(*splats.finite_points(clouds, 1), views)
    points, _ = maps.inverse(np.round(depth, 3), np.zeros((*depth.shape, 3), np.uint8), views)
    decoded = RIVALS["yang-zlib"].decode(RIVALS["yang-zlib"].encode(clouds, 4))
    np.testing.assert_allclose(decoded.positions[1], points, atol=1e-9)


def test_clouds_without_points_cannot_be_mapped():
    with pytest.raises(CannotEncode, match="no frame has a point"):
        RIVALS["yang-zlib"].encode(PointClouds([np.zeros((0, 3))], 15), 4)


def test_maps_have_about_as_many_pixels_as_points(clouds):
    views = maps.cameras(clouds)
    assert maps.Cameras.of(views.numbers(), "y") == views
    depth, colour = maps.forward(*splats.finite_points(clouds, 2), views)
    assert depth.shape == (6, views.rows, views.columns)
    points, _ = maps.inverse(depth, colour, views)
    assert 0.7 * POINTS < len(points) < 1.4 * POINTS
    mapped = PointClouds([points] * 3, 15)
    assert point_clouds.d1(clouds, mapped, 2) < views.pixel


def test_holes_are_closed_and_the_far_side_is_hidden():
    side = np.arange(-0.475, 0.5, 0.05)
    wall = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    front, back = np.insert(wall, 0, 0.3, axis=1), np.insert(wall, 0, -0.3, axis=1)
    pierced = front[np.linalg.norm(wall - side[7], axis=1) > 0.04]  # the far side is visible through the hole
    torn = front[np.linalg.norm(wall - side[12], axis=1) > 0.04]
    views = maps.Cameras((0.0, 0.0, 0.0), 0.05, 0.6, 0.6, "y")
    for points in (np.concatenate([pierced, back]), torn):
        assert len(points) % len(wall)
        view = maps.forward(points, None, views)[0][0]  # looks along x
        assert np.isfinite(view).sum() == len(wall)
        np.testing.assert_allclose(view[np.isfinite(view)], 0.3)


def test_atlas_padding_and_colour_are_undone(clouds):
    views = maps.cameras(clouds)
    depth, colour = maps.forward(*splats.finite_points(clouds, 0), views)
    np.testing.assert_array_equal(maps.cut(maps.atlas(colour)), colour)
    there = maps.atlas(np.isfinite(depth))
    flat = maps.atlas(colour).astype(float)
    filled = maps.padded(flat, there)
    np.testing.assert_array_equal(filled[there], flat[there])
    assert filled.min() >= flat[there].min()
    assert filled.max() <= flat[there].max()
    smooth = np.add.outer(np.arange(16.0), np.arange(32.0))[..., None] * [3.0, 2.0, 1.0] + 40
    assert np.abs(video.from_video(video.to_video(smooth)).astype(float) - smooth).max() < 6


def scene(performance: sequences.Performance, label: str = "short") -> runner.Scene:
    return runner.Scene(label, lambda: performance, points=POINTS)


def test_records(performance):
    work = [runner.rival_coding(RIVALS["zlib"], 9), runner.rival_coding(RIVALS["yang-zlib"], 4)]
    measured = list(runner.run([scene(performance)], work, measured_frames=2))
    lossless, yang = (m.record for m in measured)
    assert (lossless.frames, lossless.points, lossless.measured_frames) == (4, POINTS, 2)
    assert lossless.raw_bytes == 4 * POINTS * 15
    assert lossless.quality["d1_m"] == 0
    assert 0.01 < lossless.floor["d1_m"] < 0.02
    assert yang.ratio == pytest.approx(yang.raw_bytes / yang.bytes)
    assert yang.ratio_1000 == pytest.approx(yang.ratio)
    assert measured[0].decoded is not None
    np.testing.assert_array_equal(measured[0].decoded, measured[0].original)


def test_ratio_over_a_long_sequence(performance):
    name = "lien2006"
    assert name in runner.our_codecs()
    (one,) = runner.run(
        [scene(performance)], [runner.our_coding(name, {"residual": 0}, with_skeleton=True)], measured_frames=1
    )
    record = one.record
    assert not record.problem
    assert 0 < record.once_bytes < record.bytes
    assert record.ratio_1000 > 5 * record.ratio
    assert record.label == "lien2006 residual 0 %, first pose given"


def test_a_missing_package_is_listed(performance, monkeypatch, tmp_path):
    def missing(module: str):
        raise MissingExtra(f"the rival {module}", "bench")

    monkeypatch.setattr(rivals, "needs", missing)
    monkeypatch.setattr(video, "needs", missing)
    work = [runner.rival_coding(RIVALS[name], 9) for name in ("zlib", "draco", "h264")]
    measured = list(runner.run([scene(performance)], work, measured_frames=1))
    assert [bool(m.record.problem) for m in measured] == [False, True, True]
    command.write(tmp_path, measured)
    page = (tmp_path / "cloud.md").read_text()
    assert "Not measured" in page
    assert "the rival DracoPy needs the [bench] extra" in page


def test_failures_of_rivals_are_results_and_ours_are_raised(performance):
    def broken(*_):
        raise RuntimeError("no such encoder")

    theirs = replace(runner.rival_coding(RIVALS["zlib"], 9), encode=broken)
    (one,) = runner.run([scene(performance)], [theirs], measured_frames=1)
    assert one.record.problem == "RuntimeError: no such encoder"
    with pytest.raises(RuntimeError):
        list(runner.run([scene(performance)], [replace(theirs, ours=True)], measured_frames=1))


def test_report(performance, tmp_path):
    pytest.importorskip("matplotlib")
    work = [runner.rival_coding(RIVALS["zlib"], 9), runner.rival_coding(RIVALS["yang-zlib"], 4)]
    measured = list(runner.run([scene(performance), scene(performance, "again")], work, measured_frames=1))
    paths = command.write(tmp_path, measured)
    assert [path.name for path in paths] == ["cloud.json", "cloud.md", "cloud.png", "cloud_views.png"]
    stored = json.loads(paths[0].read_text())
    assert [r["coder"] for r in stored["records"]] == ["zlib", "yang-zlib"] * 2
    page = paths[1].read_text()
    assert page.count("yang-zlib colour bits 4") == 2
    assert "V-PCC TMC2" in page
    found = report.averages([m.record for m in measured])
    assert found["zlib", False][0].d1 == 0


def test_command(tmp_path, monkeypatch, performance):
    monkeypatch.setattr(runner, "scenes", lambda quick: [scene(performance)])
    result = CliRunner().invoke(command.command, ["-o", str(tmp_path / "out"), "--codec", "zlib"])
    assert result.exit_code == 0, result.output
    assert "cloud.json" in result.output
    result = CliRunner().invoke(command.command, ["-o", str(tmp_path), "--codec", "mp3"])
    assert result.exit_code == 2
    assert "no coder named mp3" in result.output
