"""Parts of recordings that are like a query, and recordings that show the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import archive
from mocodec.archive import similarity
from mocodec.testing import synthetic

OPTIONS = archive.Options("liu2006", {"max_error": 0.005})


def turned(motion: mc.Motion, angle: float, shift: float) -> mc.Motion:
    """The motion elsewhere, facing another way. z is up."""
    c, s = np.cos(angle), np.sin(angle)
    positions = motion.positions @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [shift, -shift, 0]
    return mc.Motion(positions, motion.rate, motion.names, motion.up)


def walk(frames: int, seed: int, rate: float = 60.0) -> mc.Motion:
    motion = synthetic.joints(frames=frames, rate=rate, seed=seed)
    return mc.Motion(motion.positions, rate, motion.names, motion.up)


@pytest.fixture(scope="module")
def vault(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Walks of four people; "again" is part of "walk_1" elsewhere, "copy" the same file as "walk_2"."""
    folder = tmp_path_factory.mktemp("similar")
    (folder / "raw").mkdir()
    for seed in range(4):
        mc.write(folder / f"raw/walk_{seed}.npz", walk(360, seed))
    mc.write(folder / "raw/again.npz", turned(walk(360, 1)[120:300], 1.3, 4.0))
    (folder / "raw/copy.npz").write_bytes((folder / "raw/walk_2.npz").read_bytes())
    mc.write(folder / "raw/short.npz", walk(40, 9))
    archive.build(folder / "raw", folder / "db", OPTIONS)
    assert archive.index(folder / "db") > 0
    return folder / "db"


def test_a_clip_is_found_wherever_it_is_and_faces(vault: Path) -> None:
    query = turned(walk(360, 3)[60:240], -2.0, 10.0)
    with mc.open_archive(vault) as db:
        hits = archive.search(db, query)
        assert hits[0].name == "walk_3"
        assert hits[0].start == pytest.approx(1.0, abs=0.11)
        assert hits[0].distance < 0.02 < hits[1].distance
        assert [hit.distance for hit in hits] == sorted(hit.distance for hit in hits)
        assert archive.search(db, query, leave_out="walk_3")[0].name != "walk_3"
        assert {hit.name for hit in archive.search(db.query("like(name, 'walk_[01]')"), query)} <= {"walk_0", "walk_1"}


def test_another_tempo_is_found(vault: Path) -> None:
    slower = mc.Motion(walk(360, 3).positions[40:300], 60.0 / 1.25, walk(10, 0).names)
    with mc.open_archive(vault) as db:
        best = archive.search(db, slower)[0]
        assert (best.name, best.tempo) == ("walk_3", 1.25)
        assert best.start == pytest.approx(40 / 60, abs=0.11)
        assert best.distance < archive.search(db, slower, tempos=(1.0,))[0].distance


def test_duplicates(vault: Path) -> None:
    with mc.open_archive(vault) as db:
        pairs = {frozenset((pair.one, pair.other)): pair for pair in archive.duplicates(db)}
    assert set(pairs) == {frozenset(("copy", "walk_2")), frozenset(("again", "walk_1"))}
    assert pairs[frozenset(("copy", "walk_2"))].equal
    assert pairs[frozenset(("again", "walk_1"))].share > 0.8


def test_the_index_grows_with_the_archive(vault: Path, tmp_path: Path) -> None:
    archive.merge([vault], tmp_path / "db")
    windows = archive.index(tmp_path / "db")
    path = next((tmp_path / "db/similar").glob("*.npz"))
    before = similarity.Index.read(path)
    mc.write(tmp_path / "new.npz", walk(200, 11))
    archive.build(tmp_path / "new.npz", tmp_path / "db", OPTIONS)
    assert archive.index(tmp_path / "db") > windows
    after = similarity.Index.read(path)
    np.testing.assert_array_equal(before.basis, after.basis)
    with mc.open_archive(tmp_path / "db") as db:
        assert archive.search(db, walk(200, 11)[20:150])[0].name == "new"
    archive.remove(tmp_path / "db", ["new"])
    with mc.open_archive(tmp_path / "db") as db:
        assert "new" not in {hit.name for hit in archive.search(db, walk(200, 11)[20:150])}


def test_what_cannot_be_searched_for(vault: Path, tmp_path: Path) -> None:
    with mc.open_archive(vault) as db:
        with pytest.raises(mc.BadInput, match=r"at least 1\.3 s"):
            archive.search(db, walk(40, 1))
        with pytest.raises(mc.BadInput, match="no index of recordings with the points"):
            archive.search(db, synthetic.markers(frames=400, seed=1))
    archive.merge([vault], tmp_path / "db")
    (tmp_path / "db/similar").mkdir()
    (tmp_path / "db/similar/broken.npz").write_bytes(b"PK\x03\x04 broken")
    with mc.open_archive(tmp_path / "db") as db, pytest.raises(mc.Corrupt, match="make it again"):
        archive.search(db, walk(200, 1))
