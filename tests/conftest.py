"""Internal errors of codecs fail tests, where users would get a larger file and a note. Workers start quickly."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator

import pytest

os.environ.setdefault("MOCODEC_STRICT", "1")


@pytest.fixture(scope="session", autouse=True)
def forked_workers() -> Iterator[None]:
    """Workers are forked from a process that has imported mocodec, since spawned ones import it for a second each."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        yield
        return
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["mocodec.cli.encode", "mocodec.cli.decode", "mocodec.archive.building"])
    with pytest.MonkeyPatch.context() as patch:
        for module in ("mocodec.cli.workers", "mocodec.archive.pool"):
            patch.setattr(f"{module}.get_context", lambda _: context)
        yield
