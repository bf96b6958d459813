"""Speed-up of two workers: builds in processes and on a Dask cluster, learning a prior, windows in a loader.

efficiency   time of one worker / (2 · time of two); 1 is ideal. Wall-clock times: measure on an idle machine
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from mocodec import archive

FRAMES, STRIDE, BATCH, EPOCHS = 64, 16, 256, 3
WORKERS = (1, 2)


def measure(people: Path, vault: Path, folder: Path, options: archive.Options) -> list[dict[str, Any]]:
    """Seconds of each kind of work with one and with two workers. vault: an archive with rotations."""
    work: dict[str, Callable[[int], float]] = {
        "build, processes": lambda n: built(people, folder / f"processes_{n}", options, n, None),
        "build, Dask cluster": lambda n: on_cluster(people, folder / f"dask_{n}", options, n),
        "learn a prior": lambda n: learned(vault, n),
        "windows, DataLoader": lambda n: loaded(vault, n),
    }
    rows: list[dict[str, Any]] = []
    for name, run in work.items():
        one, two = (run(workers) for workers in WORKERS)
        rows.append({"work": name, "one_s": one, "two_s": two, "efficiency": one / (2 * two)})
    return rows


def built(people: Path, where: Path, options: archive.Options, workers: int, executor: Executor | None) -> float:
    """Seconds of a build, including the start of processes; the workers of a cluster run already."""
    begun = time.perf_counter()
    archive.build(people, where, options, workers=workers, executor=executor)
    return time.perf_counter() - begun


def on_cluster(people: Path, where: Path, options: archive.Options, workers: int) -> float:
    """Seconds of a build on a cluster of this machine. workers: of one thread each."""
    import distributed  # pyright: ignore[reportMissingImports]

    with (
        distributed.LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        archive.dask_cluster(cluster.scheduler_address) as executor,
    ):
        return built(people, where, options, workers, executor)


def learned(vault: Path, workers: int) -> float:
    """Seconds of learning a prior, including the start of the processes."""
    with archive.open_archive(vault) as db:
        begun = time.perf_counter()
        archive.train_prior(db, workers=workers)
        return time.perf_counter() - begun


def loaded(vault: Path, workers: int) -> float:
    """Seconds of all epochs without the first, in which the workers start and fill their caches."""
    from torch.utils.data import DataLoader  # pyright: ignore[reportMissingImports]

    from mocodec.torch import Windows

    windows = Windows(vault, FRAMES, STRIDE, cache_bytes=1 << 20)
    sampler = windows.sampler(BATCH, seed=0, workers=workers)
    loader = DataLoader(windows, batch_sampler=sampler, num_workers=workers, persistent_workers=True)
    begun = 0.0
    for epoch in range(EPOCHS + 1):
        if epoch == 1:
            begun = time.perf_counter()
        for _ in loader:
            pass
    return time.perf_counter() - begun
