"""Golden files decode to the same motion in every later version, and cannot be overwritten by accident."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

import mocodec
from mocodec.codecs.tempo.models import prior
from mocodec.pointcloud import PointClouds

from . import write

NEEDS = {"lien2006": ["PIL"], "bodycast": ["av"]}
FILES = sorted(write.HERE.glob("*.mocz"))
FROZEN = "93bbf867b14439c6f370f51dfb8687c4ae41d8047010a96eb24d475a42b77f70"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_golden_file_decodes_to_its_twin(path: Path):
    twin = json.loads(path.with_suffix(".json").read_text())
    assert hashlib.sha256(path.read_bytes()).hexdigest() == twin["sha256"], "a golden file was changed"
    for module in NEEDS.get(twin["codec"], ()):
        pytest.importorskip(module)
    motion = mocodec.decode(path)
    if isinstance(motion, PointClouds):
        assert (motion.rate, motion.up, len(motion)) == (twin["rate"], twin["up"], len(twin["positions"]))
        assert motion.colours is not None
        for points, colours, *given in zip(
            motion.positions, motion.colours, twin["positions"], twin["colours"], strict=True
        ):
            np.testing.assert_allclose(points, given[0], rtol=0, atol=2e-6)
            np.testing.assert_allclose(colours, given[1], rtol=0, atol=4)  # JPEG decoders may differ
        return
    wanted = np.array([[[np.nan] * 3 if point is None else point for point in frame] for frame in twin["positions"]])
    assert motion.positions.shape == wanted.shape
    assert np.array_equal(motion.gaps, np.isnan(wanted[:, :, 0]))
    assert np.nanmax(np.abs(motion.positions - wanted)) <= 1e-9
    if "rotations" in twin:
        assert motion.rotations is not None
        assert np.abs(motion.rotations - np.array(twin["rotations"])).max() <= 1e-9
    if "signals" in twin:
        assert repr(write.described_signals(motion)) == repr(twin["signals"])  # repr: NaN and −0 count
    assert (motion.rate, motion.up, list(motion.names)) == (twin["rate"], twin["up"], twin["names"])


def test_files_and_twins_match():
    assert {p.stem for p in FILES} == {p.stem for p in write.HERE.glob("*.json")} - {"frozen"}
    assert FILES


def test_version_1_is_frozen():
    """Files of version 1 stay as they are for ever: to make this pass again, restore them, and do not edit the hash."""
    listed = (write.HERE / "frozen.json").read_bytes()
    assert hashlib.sha256(listed).hexdigest() == FROZEN, "the list of frozen files was changed"
    for name, digest in write.frozen().items():
        path = write.HERE / f"{name}.mocz"
        assert hashlib.sha256(path.read_bytes()).hexdigest() == digest, f"{name} was changed"


def test_a_frozen_file_is_not_written_again():
    before = (write.HERE / "lossless-markers.mocz").read_bytes()
    with pytest.raises(SystemExit, match="frozen version 1"):
        write.write("lossless-markers")
    assert (write.HERE / "lossless-markers.mocz").read_bytes() == before


def test_priors_are_frozen():
    """A prior is found by the hash of its file: another file is another prior, beside this one."""
    assert {prior.read(prior.packaged_bytes(f)).id.hex() for f in ("points.npz", "directions.npz")} == {
        "b881876c",
        "1be90053",
    }


def test_file_of_another_version_is_not_overwritten(tmp_path: Path):
    write.write("lossless-markers", tmp_path)
    twin = tmp_path / "lossless-markers.json"
    before = (tmp_path / "lossless-markers.mocz").read_bytes()
    twin.write_text(twin.read_text().replace(f'"version": "{mocodec.__version__}"', '"version": "0.0.1"'))
    with pytest.raises(SystemExit, match=r"0\.0\.1"):
        write.write("lossless-markers", tmp_path)
    assert (tmp_path / "lossless-markers.mocz").read_bytes() == before
