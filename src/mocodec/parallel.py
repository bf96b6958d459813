# pyright: strict
"""Threads for work that leaves the interpreter free: chunks that the compiled module decodes.

    with parallel.threads(None):           as many as there are processors
        parallel.over(function, items)     the results, in the order of the items
        parallel.over(function, blocks(n)) the same of slices of n frames
        parallel.ahead(items)              the items, each made while the one before it is used

Without `threads` around them, `over` and `ahead` work in the calling thread. MOCODEC_THREADS in the environment sets
another number for None; processes that were started as workers of another count one, since their siblings have the
other processors.
"""

from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import Context, ContextVar
from functools import partial
from queue import SimpleQueue
from threading import Semaphore, Thread
from typing import Generic, NoReturn, TypeVar

from .errors import BadInput

MOST = 64
"""More threads than this wait for memory."""

Item = TypeVar("Item")
Result = TypeVar("Result")

_threads: ContextVar[int] = ContextVar("mocodec_threads", default=1)


@contextmanager
def threads(number: int | None) -> Generator[None, None, None]:
    """Within this context, `over` uses this number of threads; None: `usual`. Raises BadInput for a number below 1."""
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
    """The results of items in their order; in one thread if there are fewer than `least` items.

    The calling thread works too, and every thread takes the next item when it is free: with a future for each item, the
    calling thread would wake for each.
    """
    listed = list(items)
    number = min(_threads.get(), len(listed))
    if number < 2 or len(listed) < least:
        yield from map(function, listed)
        return
    shared = _Shared(function, listed)
    others = [Thread(target=shared.work, name=f"mocodec_{i}") for i in range(1, number)]
    try:
        for other in others:
            other.start()
        for i in range(len(listed)):
            while i not in shared.done:
                if not shared.work_once():
                    for other in others:
                        other.join()
            yield shared.done.pop(i)()
    finally:
        shared.stopped = True
        for other in others:
            other.join()


def ahead(items: Iterable[Item], waiting: int = 1) -> Generator[Item, None, None]:
    """The items in their order. Another thread makes the next ones while the caller uses one; at most `waiting` are
    made before the caller asks for them. With one thread, each is made when it is asked for.
    """
    if _threads.get() < 2:
        yield from items
        return
    made = _MadeAhead(items, waiting)
    other = Thread(target=lambda: Context().run(made.work), name="mocodec_ahead")
    other.start()
    try:
        yield from made.results()
    finally:
        made.stop()
        other.join()


class _MadeAhead(Generic[Item]):
    """Items that another thread makes."""

    def __init__(self, items: Iterable[Item], waiting: int) -> None:
        self._items, self._room, self._stopped = items, Semaphore(waiting - 1), False
        self._made: SimpleQueue[Callable[[], Item] | None] = SimpleQueue()

    def work(self) -> None:
        """Makes all items, each when there is room for it."""
        try:
            for item in self._items:
                self._made.put(partial(_same, item))
                self._room.acquire()
                if self._stopped:
                    return
            self._made.put(None)
        except BaseException as error:
            self._made.put(partial(_raise, error))
            if not isinstance(error, Exception):
                raise

    def results(self) -> Iterator[Item]:
        """The items as they are made; an exception of the thread that makes them."""
        while (result := self._made.get()) is not None:
            self._room.release()
            yield result()

    def stop(self) -> None:
        """No item is made any more but the one that is being made."""
        self._stopped = True
        self._room.release()


class _Shared(Generic[Item, Result]):
    """Items that several threads work on. done: by number of item, what returns its result or raises its exception."""

    def __init__(self, function: Callable[[Item], Result], items: Sequence[Item]) -> None:
        self._function, self._items = function, items
        self._numbers = itertools.count()
        self.done: dict[int, Callable[[], Result]] = {}
        self.stopped = False

    def work(self) -> None:
        """All items that are left."""
        while self.work_once():
            pass

    def work_once(self) -> bool:
        """The next item; False if there is none."""
        number = next(self._numbers)
        if self.stopped or number >= len(self._items):
            return False
        try:
            # an empty context, as in a thread of its own: `over` within the function uses one thread
            result = Context().run(self._function, self._items[number])
        except BaseException as error:
            self.done[number] = partial(_raise, error)
            if not isinstance(error, Exception):
                raise
        else:
            self.done[number] = lambda: result
        return True


def _same(item: Item) -> Item:
    return item


def _raise(error: BaseException) -> NoReturn:
    raise error
