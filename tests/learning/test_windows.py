"""Windows of an archive: their values, their order, and how they are read."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import archive, learning
from mocodec.learning import WindowSet, blocks
from mocodec.testing import synthetic
from mocodec.testing.hinged_figures import figure

LENGTHS = (130, 64, 40, 300)


@pytest.fixture(scope="module")
def vault(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four recordings of joints at 120 Hz; the third is shorter than a window."""
    folder = tmp_path_factory.mktemp("windows")
    (folder / "raw").mkdir()
    for i, frames in enumerate(LENGTHS):
        mc.write(folder / f"raw/clip_{i}.npz", synthetic.joints(frames=frames, seed=i))
    archive.build(folder / "raw", folder / "db", archive.Options("liu2006", {"max_error": 0.005}))
    return folder / "db"


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BLOCK_FRAMES", 96)


def test_windows_are_those_of_the_recordings(vault: Path) -> None:
    windows = WindowSet(vault, frames=64, stride=16)
    counts = [max(0, (frames - 64) // 16 + 1) for frames in LENGTHS]
    assert len(windows) == sum(counts)
    with mc.open_archive(vault) as db:
        number = 0
        for i, count in enumerate(counts):
            whole = db[f"clip_{i}"][:].positions.astype(np.float32)
            for k in range(count):
                window = windows[number]["positions"]
                assert windows.place(number) == (f"clip_{i}", 16 * k / 120)
                np.testing.assert_allclose(window, whole[16 * k : 16 * k + 64], atol=1e-6)
                assert (window.dtype, window.flags.c_contiguous, window.base) == (np.float32, True, None)
                number += 1
    np.testing.assert_array_equal(windows[-1]["positions"], windows[len(windows) - 1]["positions"])
    with pytest.raises(IndexError):
        windows[len(windows)]


@pytest.mark.parametrize("rate", [30.0, 60.0, 50.0, 25.0, 240.0])
def test_another_rate_is_that_of_resample(vault: Path, rate: float) -> None:
    windows = WindowSet(vault, frames=8, stride=5, rate=rate, features=("positions", "velocities"))
    with mc.open_archive(vault) as db:
        whole = db["clip_3"][:].resample(rate)
    first = next(i for i in range(len(windows)) if windows.place(i)[0] == "clip_3")
    velocity = np.gradient(whole.positions, 1 / rate, axis=0)
    assert len(windows) - first == (len(whole) - 8) // 5 + 1
    for k in range(len(windows) - first):
        window = windows[first + k]
        np.testing.assert_allclose(window["positions"], whole.positions[5 * k : 5 * k + 8], atol=2e-6)
        np.testing.assert_allclose(window["velocities"], velocity[5 * k : 5 * k + 8], atol=1e-3)


def test_batches_and_orders(vault: Path) -> None:
    windows = WindowSet(vault, frames=32, stride=8, cache_bytes=100_000)
    first, again, next_epoch = windows.order(3), windows.order(3), windows.order(3, epoch=1)
    np.testing.assert_array_equal(first, again)
    assert (first != next_epoch).any()
    for order in (first, next_epoch, windows.order(None)):
        np.testing.assert_array_equal(np.sort(order), np.arange(len(windows)))
    batch = windows.batch([5, 0, 7])["positions"]
    assert batch.shape == (3, 32, 21, 3)
    for row, number in enumerate((5, 0, 7)):
        np.testing.assert_array_equal(batch[row], windows[number]["positions"])
    for workers in (1, 2, 3):
        numbers = windows.batch_numbers(4, seed=1, workers=workers)
        np.testing.assert_array_equal(np.sort(np.concatenate(numbers)), np.arange(len(windows)))
        whole = windows.batch_numbers(4, seed=1, workers=workers, drop_last=True)
        assert {len(part) for part in whole} == {4}


def test_a_shuffled_epoch_decodes_each_block_once(vault: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    windows = WindowSet(vault, frames=32, stride=8, cache_bytes=150_000)
    loaded = list[int]()
    load = windows._load

    def counting(block: int) -> blocks.Block:
        loaded.append(block)
        return load(block)

    windows._cache.load = counting
    for _ in windows.batches(5, seed=0):
        assert windows._cache.bytes <= 150_000
    assert len(loaded) <= windows.first_block[-1] + 1  # the first block also tells how large frames are


def test_values_do_not_depend_on_what_was_read_before(vault: Path) -> None:
    whole = WindowSet(vault, frames=16, stride=4, rate=50.0)
    tight = WindowSet(vault, frames=16, stride=4, rate=50.0, cache_bytes=0)
    for number in whole.order(5)[:12]:
        np.testing.assert_array_equal(whole[number]["positions"], tight[number]["positions"])


def test_it_is_pickled_without_what_it_decoded(vault: Path) -> None:
    windows = WindowSet(vault, frames=32, stride=8)
    before = windows[3]["positions"]
    data = pickle.dumps(windows)
    assert len(data) < 10_000
    np.testing.assert_array_equal(pickle.loads(data)[3]["positions"], before)


def test_the_iterator(vault: Path) -> None:
    found = list(learning.windows(vault, frames=64, stride=16, batch=4, seed=0))
    assert sum(len(batch["positions"]) for batch in found) == len(WindowSet(vault))
    assert next(learning.windows(vault, frames=64))["positions"].shape == (64, 21, 3)


def test_features_of_a_skeletal_motion(tmp_path: Path) -> None:
    motion = figure(frames=60)
    mc.write(tmp_path / "walk.bvh", motion)
    archive.build(tmp_path / "walk.bvh", tmp_path / "db", archive.Options("lossless"))
    window = WindowSet(tmp_path / "db", frames=20, stride=20, features=("rotations6d",))[1]["rotations6d"]
    with mc.open_archive(tmp_path / "db") as db:
        rotations = db["walk"][20:40].rotations
    assert rotations is not None
    assert window.shape == (20, motion.points, 6)
    a, b = window[..., :3], window[..., 3:]
    np.testing.assert_allclose(np.linalg.norm(a, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose((a * b).sum(-1), 0, atol=1e-6)
    w, x, y, z = np.moveaxis(rotations, -1, 0)
    np.testing.assert_allclose(a[..., 0], 1 - 2 * (y * y + z * z), atol=1e-6)
    np.testing.assert_allclose(b[..., 0], 2 * (x * y - w * z), atol=1e-6)


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_heading_turns_with_the_body(up: str) -> None:
    motion = synthetic.joints(frames=50, seed=1).turned(up)
    axis = "xyz".index(up)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    angle = 0.7
    turned = motion.positions.copy()
    turned[..., a] = np.cos(angle) * motion.positions[..., a] - np.sin(angle) * motion.positions[..., b]
    turned[..., b] = np.sin(angle) * motion.positions[..., a] + np.cos(angle) * motion.positions[..., b]
    root = learning.FEATURES["root"]
    before, after = root(motion), root(mc.Motion(turned, motion.rate, motion.names, up, motion.skeleton))
    change = np.arctan2(after[:, 3], after[:, 4]) - np.arctan2(before[:, 3], before[:, 4])
    np.testing.assert_allclose(np.angle(np.exp(1j * (change - angle))), 0, atol=1e-9)


def test_contacts_are_of_slow_feet() -> None:
    names = ("LeftFoot", "LeftToe", "RightFoot", "RightToe", "Hips")
    positions = np.zeros((30, 5, 3))
    positions[:, 2, 0] = np.arange(30) / 30  # 1 m/s at 30 Hz
    found = learning.FEATURES["contacts"](mc.Motion(positions, 30.0, names))
    np.testing.assert_array_equal(found, np.broadcast_to([1.0, 1.0, 0.0, 1.0], (30, 4)))


@pytest.mark.parametrize(
    ("features", "match"),
    [
        (("rotations6d",), "needs recordings with rotations"),
        (("smells",), "no feature named smells"),
    ],
)
def test_features_that_cannot_be(vault: Path, features: Sequence[str], match: str) -> None:
    with pytest.raises(mc.BadInput, match=match):
        WindowSet(vault, features=features)[0]


def test_different_sets_of_points(vault: Path, tmp_path: Path) -> None:
    archive.merge([vault], tmp_path / "db")
    mc.write(tmp_path / "markers.npz", synthetic.markers(frames=80, seed=1))
    archive.build(tmp_path / "markers.npz", tmp_path / "db", archive.Options("liu2006", {"max_error": 0.005}))
    with mc.open_archive(tmp_path / "db") as db:
        with pytest.raises(mc.BadInput, match="2 different sets of points"):
            WindowSet(db)
        assert len(WindowSet(db.query("joints == 0"))) == 2
        names = db["clip_0"].names[3:5]
        assert WindowSet(db.query("like(name, 'clip_*')"), points=names)[0]["positions"].shape == (64, 2, 3)
        with pytest.raises(mc.BadInput, match="long enough"):
            WindowSet(db, frames=5000)


def test_tensors(vault: Path) -> None:
    torch = pytest.importorskip("torch", reason="tensors need torch")
    from mocodec.torch import Windows

    windows = Windows(vault, frames=32, stride=8)
    plain = WindowSet(vault, frames=32, stride=8)
    assert torch.equal(windows[2]["positions"], torch.from_numpy(plain[2]["positions"]))
    sampler = windows.sampler(8, seed=4, workers=2)
    loader = torch.utils.data.DataLoader(windows, batch_sampler=sampler)
    first, second = ([batch["positions"] for batch in loader] for _ in range(2))
    assert sum(map(len, first)) == len(windows)
    assert not torch.equal(first[0], second[0])
    sampler.set_epoch(0)
    assert torch.equal(next(iter(loader))["positions"], first[0])
    assert len(sampler) == len(first)
