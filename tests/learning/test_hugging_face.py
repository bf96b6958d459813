"""Windows as a data set of Hugging Face: values, shards, formats, workers, and the error without the package."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import archive, learning
from mocodec.learning import WindowSet, blocks
from mocodec.testing import synthetic

OPTIONS: dict[str, Any] = {"frames": 32, "stride": 8, "rate": 60.0, "features": ("positions", "root")}


@pytest.fixture(scope="module")
def vault(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hugging_face")
    (folder / "raw").mkdir()
    for i, frames in enumerate((130, 20, 300)):
        mc.write(folder / f"raw/clip_{i}.npz", synthetic.joints(frames=frames, seed=i))
    archive.build(folder / "raw", folder / "db", archive.Options("liu2006", {"max_error": 0.005}))
    return folder / "db"


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BLOCK_FRAMES", 96)


def test_runs_of_blocks_cover_all_windows_once(vault: Path) -> None:
    windows = WindowSet(vault, **OPTIONS)
    for most in (1, 2, 3, 1000):
        runs = windows.runs_of_blocks(most)
        assert len(runs) <= most
        assert [number for start, stop in runs for number in range(start, stop)] == list(range(len(windows)))
        assert all(windows._where(start)[3] == 0 for start, _ in runs)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_examples_are_the_windows(vault: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    pytest.importorskip("datasets", reason="needs the [datasets] extra")
    windows = WindowSet(vault, **OPTIONS)
    data = learning.to_datasets(vault, **OPTIONS)
    assert set(data.features) == {"recording", "second", "positions", "root"}
    assert data.features["positions"].shape == (32, 21, 3)
    examples = list(data.with_format("numpy"))
    assert len(examples) == len(windows)
    for number, example in enumerate(examples):
        assert (example["recording"], example["second"]) == windows.place(number)
        for name, array in windows[number].items():
            assert example[name].dtype == np.float32
            np.testing.assert_array_equal(example[name], array)
    shuffled = data.shuffle(seed=1, buffer_size=10)
    places = [(row["recording"], row["second"]) for row in shuffled]
    assert sorted(places) == sorted(map(windows.place, range(len(windows))))
    assert places != sorted(places)
    parts = [list(data.shard(2, index)) for index in (0, 1)]
    assert sum(map(len, parts)) == len(windows)
    assert min(map(len, parts)) > 0
    with pytest.raises(mc.BadInput, match="stride"):
        learning.to_datasets(windows, stride=2)


def test_without_the_package(vault: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "datasets", None)
    with pytest.raises(mc.MissingExtra, match=r"mocodec\[datasets\]"):
        learning.to_datasets(vault)
