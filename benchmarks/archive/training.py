"""Trains a small autoencoder from the archive and from the original positions in memory-mapped .npy: loss and time.

Both see the same windows in the same order: 64 frames of 31 joints at 120 Hz, minus the place of the first frame.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mocodec import archive, formats, learning
from mocodec.motion import Motion

from .windows import FRAMES, STRIDE, windows_of_all

EPOCHS, BATCH, HIDDEN = 6, 256, 64
SEED = 0


def measure(vault: Path, folder: Path, people: Path) -> list[dict[str, Any]]:
    """Loss of each epoch (m², mean over coordinates) and seconds of processor time, by source."""
    originals(vault, folder, people)
    windows = learning.WindowSet(vault, FRAMES, STRIDE)
    places = windows_of_all(vault)
    mapped = {name: np.load(original(folder, name), mmap_mode="r") for name, _ in places}

    def from_npy(numbers: Any) -> Any:
        chosen = [places[int(i)] for i in numbers]
        return np.stack([mapped[name][start : start + FRAMES] for name, start in chosen])

    sources: dict[str, Callable[[Any], Any]] = {
        "archive": lambda numbers: windows.batch(numbers)["positions"],
        "original .npy": from_npy,
    }
    return [{"source": name, **trained(windows, read)} for name, read in sources.items()]


def original(folder: Path, name: str) -> Path:
    """The file of the original positions of a recording."""
    return folder / "original" / f"{name.rpartition('/')[2]}.npy"


def originals(vault: Path, folder: Path, people: Path) -> None:
    """Write the original positions of each recording as float32."""
    (folder / "original").mkdir(exist_ok=True)
    with archive.open_archive(vault) as db:
        for row in db.rows():
            path = original(folder, row.name)
            if not path.exists():
                motion = formats.read(people / row.path)
                assert isinstance(motion, Motion)
                np.save(path, motion.positions.astype(np.float32))


def trained(windows: learning.WindowSet, read: Callable[[Any], Any]) -> dict[str, Any]:
    """Train, and return the loss of each epoch, the time of reading and the whole time."""
    import torch  # pyright: ignore[reportMissingImports]

    torch.manual_seed(SEED)
    torch.set_num_threads(1)
    values = FRAMES * 31 * 3
    model = torch.nn.Sequential(torch.nn.Linear(values, HIDDEN), torch.nn.Tanh(), torch.nn.Linear(HIDDEN, values))
    optimiser = torch.optim.Adam(model.parameters(), 1e-3)
    losses, reading, begun = list[float](), 0.0, time.process_time()
    for epoch in range(EPOCHS):
        total, count = 0.0, 0
        for numbers in windows.batch_numbers(BATCH, SEED, epoch):
            before = time.process_time()
            batch = read(numbers)
            reading += time.process_time() - before
            x = torch.from_numpy(batch - batch[:, :1].mean(axis=2, keepdims=True)).reshape(len(batch), -1)
            loss = ((model(x) - x) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            total, count = total + loss.item() * len(batch), count + len(batch)
        losses.append(total / count)
    return {"losses": losses, "reading_s": reading, "seconds": time.process_time() - begun}
