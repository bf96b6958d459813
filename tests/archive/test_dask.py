"""Building on a Dask cluster, also when a worker of it is killed."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import mocodec as mc
from mocodec import archive

OPTIONS = archive.Options("liu2006", {"max_error": 0.005})


@pytest.mark.filterwarnings("ignore")
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system cannot kill")
def test_a_cluster_builds_the_same_although_a_worker_is_killed(made: Path, tmp_path: Path) -> None:
    distributed: Any = pytest.importorskip("distributed", reason="a Dask cluster needs the [dask] extra")
    (tmp_path / "many").mkdir()
    for i, path in enumerate(sorted((made / "raw").rglob("*.npz")) * 4):
        (tmp_path / f"many/clip_{i:02}.npz").write_bytes(path.read_bytes())
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, memory_limit=0, silence_logs=50
    ) as cluster:
        victim = next(iter(cluster.workers.values())).pid
        killed = threading.Event()

        def kill_one(done: int, total: int, path: str) -> None:
            if done == 3 and not killed.is_set():
                os.kill(victim, signal.SIGKILL)
                killed.set()
                time.sleep(0.2)

        with archive.dask_cluster(cluster.scheduler_address) as executor:
            report = archive.build(tmp_path / "many", tmp_path / "db", OPTIONS, executor=executor, report_to=kill_one)
    assert killed.is_set()
    assert (len(report.added), report.failed) == (16, [])
    with mc.open_archive(tmp_path / "db") as db, mc.open_archive(made / "db") as expected:
        assert list(archive.damage(db)) == []
        assert {row.content for row in db.rows()} == {row.content for row in expected.rows()}


def test_no_scheduler_is_one_line() -> None:
    pytest.importorskip("distributed", reason="a Dask cluster needs the [dask] extra")
    with pytest.raises(mc.BadInput, match="no Dask scheduler"), archive.dask_cluster("tcp://127.0.0.1:9"):
        pass
