"""Speed of windows for learning: from an archive, from compressed .npz, and from memory-mapped .npy.

epoch      all windows once, shuffled so that each block is decoded once, from a cold start
random     windows in any order, after an epoch; the archive's decoded blocks are in memory, like .npy files
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mocodec import archive, learning

FRAMES, STRIDE = 64, 16
MOST_WINDOWS = {"archive": 20_000, "npz": 300, "npy": 20_000}
ALL_FEATURES = ("positions", "velocities", "root", "contacts")


def measure(vault: Path, folder: Path) -> dict[str, Any]:
    """Windows a second of processor time, by source; memory over epochs."""
    plain(vault, folder)
    rows: list[dict[str, Any]] = []
    for rate, features in ((None, ("positions",)), (30.0, ("positions",)), (30.0, ALL_FEATURES)):
        windows = learning.WindowSet(vault, FRAMES, STRIDE, rate, features)
        begun, count = time.process_time(), 0
        for batch in windows.batches(256, seed=0):
            count += len(batch["positions"])
        epoch = count / (time.process_time() - begun)
        numbers = np.random.default_rng(1).integers(0, len(windows), MOST_WINDOWS["archive"])
        rows.append(
            {
                "source": "archive",
                "rate": rate,
                "features": features,
                "windows": len(windows),
                "epoch": epoch,
                "random": per_second(lambda i, w=windows: w[int(i)], numbers),
            }
        )
    for source, read in (("npz", from_npz), ("npy", from_npy)):
        places = [windows_of_all(vault)[i] for i in np.random.default_rng(1).integers(0, 6000, MOST_WINDOWS[source])]
        at = dict(enumerate(places))
        rate = per_second(lambda i, r=read, a=at: r(folder, *a[int(i)]), np.arange(len(places)))
        rows.append({"source": source, "rate": None, "features": ("positions",), "random": rate})
    return {"frames": FRAMES, "stride": STRIDE, "rows": rows, "memory": memory(vault)}


@lru_cache
def windows_of_all(vault: Path) -> list[tuple[str, int]]:
    """(name, first frame) of every window at the recordings' original rate."""
    windows = learning.WindowSet(vault, FRAMES, STRIDE)
    with archive.open_archive(vault) as db:
        counts = {row.name: windows.cut.windows(row.frames, row.rate) for row in db.rows()}
    return [(name, STRIDE * k) for name, count in counts.items() for k in range(count)]


def per_second(read: Callable[[Any], Any], numbers: Any) -> float:
    """Calls a second of processor time."""
    begun = time.process_time()
    for number in numbers:
        read(number)
    return len(numbers) / (time.process_time() - begun)


def plain(vault: Path, folder: Path) -> None:
    """Writes the decoded positions of each recording as float32 to .npz and .npy files."""
    (folder / "plain").mkdir(parents=True, exist_ok=True)
    with archive.open_archive(vault) as db:
        for entry in db:
            path = folder / "plain" / entry.row.stem
            if not path.with_suffix(".npy").exists():
                positions = entry.open()[:].positions.astype(np.float32)
                np.savez_compressed(path.with_suffix(".npz"), positions=positions)
                np.save(path.with_suffix(".npy"), positions)


def from_npz(folder: Path, name: str, start: int) -> Any:
    """A window from a compressed file, which is decompressed whole."""
    with np.load(folder / "plain" / f"{name.rpartition('/')[2]}.npz") as file:
        return file["positions"][start : start + FRAMES].copy()


@cache
def mapped(folder: Path, name: str) -> Any:
    return np.load(folder / "plain" / f"{name.rpartition('/')[2]}.npy", mmap_mode="r")


def from_npy(folder: Path, name: str, start: int) -> Any:
    """A window from a memory-mapped file."""
    return np.array(mapped(folder, name)[start : start + FRAMES])


def memory(vault: Path) -> dict[str, float]:
    """Peak memory of the process, MB: after one epoch with a small cache, and after three more."""
    windows = learning.WindowSet(vault, FRAMES, STRIDE, cache_bytes=4 << 20)
    peaks = []
    for epoch in range(4):
        for _ in windows.batches(256, seed=0, epoch=epoch):
            pass
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    return {"after_one": peaks[0], "after_four": peaks[-1]}
