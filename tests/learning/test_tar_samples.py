"""Tar shards of WebDataset: what is written, what the handler decodes, and WebDataset itself where it is."""

from __future__ import annotations

import io
import pickle
import tarfile
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import archive, learning
from mocodec.testing import synthetic


@pytest.fixture(scope="module")
def vault(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tar_samples")
    for i, name in enumerate(("07/walk.1", "07/run", "08/run")):
        path = folder / f"raw/{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        mc.write(path, synthetic.joints(frames=100 + 20 * i, seed=i))
    archive.build(folder / "raw", folder / "db", archive.Options("liu2006", {"max_error": 0.005}))
    return folder / "db"


def test_a_tar_has_the_files_of_the_archive(vault: Path, tmp_path: Path) -> None:
    with mc.open_archive(vault) as db:
        assert learning.write_tar(db, tmp_path / "all.tar") == 3
        assert learning.write_tar(db.query("subject == 7"), tmp_path / "some.tar") == 2
        stored = {entry.name: entry.read() for entry in db}
    with tarfile.open(tmp_path / "all.tar") as shard:
        found = {member.name: shard.extractfile(member).read() for member in shard}  # pyright: ignore[reportOptionalMemberAccess]
    assert found == {
        "07_run.mocz": stored["07/run"], "07_walk_1.mocz": stored["07/walk.1"], "08_run.mocz": stored["08/run"],
    }  # fmt: skip
    learning.write_tar(vault, tmp_path / "again.tar")
    assert (tmp_path / "again.tar").read_bytes() == (tmp_path / "all.tar").read_bytes()


def test_names_that_give_one_key_are_refused(tmp_path: Path) -> None:
    for name in ("a/b", "a_b"):
        path = tmp_path / f"raw/{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        mc.write(path, synthetic.joints(frames=30, seed=len(name)))
    archive.build(tmp_path / "raw", tmp_path / "db", archive.Options("liu2006", {"max_error": 0.005}))
    with pytest.raises(mc.BadInput, match="a_b"):
        learning.write_tar(tmp_path / "db", tmp_path / "x.tar")
    assert not (tmp_path / "x.tar").exists()


def test_the_handler_decodes_features() -> None:
    motion = synthetic.joints(frames=120, rate=120.0, seed=4)
    data = mc.encode(motion, "liu2006", max_error=0.005)
    names = motion.names[2:6]
    decoder = pickle.loads(pickle.dumps(learning.mocz(("positions", "velocities"), rate=30, points=names)))
    assert decoder(".json", b"{}") is None
    sample = decoder(".left.mocz", data)
    assert sample is not None
    expected = mc.decode(data, mc.Motion).select(names).resample(30)
    np.testing.assert_array_equal(sample["positions"], expected.positions.astype(np.float32))
    assert sample["velocities"].shape == (30, 4, 3)
    assert all(array.dtype == np.float32 and array.flags.c_contiguous for array in sample.values())
    with pytest.raises(mc.MocodecError):
        decoder(".mocz", data[:-20])
    with pytest.raises(mc.BadInput, match="no feature"):
        learning.mocz("colour")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # WebDataset leaves the shard open
def test_webdataset_reads_it(vault: Path, tmp_path: Path) -> None:
    webdataset = pytest.importorskip("webdataset", reason="needs the [webdataset] extra")
    learning.write_tar(vault, tmp_path / "all.tar")
    with tarfile.open(tmp_path / "all.tar", "a") as shard:
        member = tarfile.TarInfo("08_run.txt")
        member.size = 4
        shard.addfile(member, io.BytesIO(b"runs"))
    data = webdataset.WebDataset(str(tmp_path / "all.tar"), shardshuffle=False).decode(learning.mocz(rate=30))
    samples = {sample["__key__"]: sample for sample in data}
    assert sorted(samples) == ["07_run", "07_walk_1", "08_run"]
    assert samples["08_run"]["txt"] == "runs"
    with mc.open_archive(vault) as db:
        expected = db["08/run"][:].resample(30).positions
    np.testing.assert_array_equal(samples["08_run"]["mocz"]["positions"], expected.astype(np.float32))
