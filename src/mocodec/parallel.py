# pyright: strict
"""Threads for work that leaves the interpreter free: chunks that the compiled module decodes.

    with parallel.threads(None):           as many as there are processors
        parallel.over(function, items)     the results, in the order of the items
        parallel.over(function, blocks(n)) the same of slices of n frames

Without `threads` around it, `over` works in the calling thread. MOCODEC_THREADS in the environment sets another number
for None; processes that were started as workers of another count one, since their siblings have the other processors.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from .errors import BadInput

MOST = 64
"""More threads than this wait for memory."""

Item = TypeVar("Item")
Result = TypeVar("Result")

_threads: ContextVar[int] = ContextVar("mocodec_threads", default=1)


@contextmanager
def threads(number: int | None) -> Generator[None, None, None]:
    """Within this context, `over` uses so many threads; None: `usual`. Raises BadInput for a number below 1."""
    if number is not None and number < 1:
        raise BadInput(f"threads must be 1 or more, not {number}")
    token = _threads.set(min(usual() if number is None else number, MOST))
    try:
        yield
    finally:
        _threads.reset(token)


def usual() -> int:
    """MOCODEC_THREADS, or the number of processors that this process may use; 1 in a worker process."""
    text = os.environ.get("MOCODEC_THREADS", "")
    if text.isdigit() and int(text) > 0:
        return int(text)
    multiprocessing = sys.modules.get("multiprocessing.process")  # no worker has started without it
    if multiprocessing is not None and multiprocessing.parent_process() is not None:
        return 1
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


def blocks(length: int, most: int = 4096) -> list[slice]:
    """Consecutive slices of up to `most` items, for work on frames side by side."""
    return [slice(first, min(first + most, length)) for first in range(0, length, most)]


def over(function: Callable[[Item], Result], items: Iterable[Item], least: int = 2) -> Iterator[Result]:
    """The results of items in their order; in one thread if there are fewer than `least` items."""
    listed = list(items)
    number = min(_threads.get(), len(listed))
    if number < 2 or len(listed) < least:
        yield from map(function, listed)
        return
    with ThreadPoolExecutor(number, thread_name_prefix="mocodec") as pool:
        try:
            yield from pool.map(function, listed)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
