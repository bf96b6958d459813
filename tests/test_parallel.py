"""Threads: results in order, errors of the items, and how many there are."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from mocodec import parallel
from mocodec.errors import BadInput


def test_without_threads_the_caller_works():
    assert list(parallel.over(lambda _: threading.current_thread(), range(3))) == [threading.current_thread()] * 3


def test_threads_work_side_by_side_in_order():
    meeting = threading.Barrier(2, timeout=30)

    def together(number: int) -> int:
        meeting.wait()
        return number

    with parallel.threads(2):
        assert list(parallel.over(together, range(6))) == list(range(6))
        assert (
            list(parallel.over(lambda _: threading.current_thread(), range(3), least=4))
            == [threading.current_thread()] * 3
        )


def test_an_error_of_an_item_is_raised():
    def fails(number: int) -> int:
        if number == 3:
            raise KeyError(number)
        return number

    with parallel.threads(2):
        results = parallel.over(fails, range(100))
        assert [next(results) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(KeyError):
            next(results)


def test_no_item_begins_after_an_error_or_the_end():
    begun: list[int] = []

    def work(number: int) -> None:
        begun.append(number)
        time.sleep(0.002)

    with parallel.threads(2):
        next(parallel.over(work, range(1000)))  # the rest is not asked for
    assert len(begun) < 1000
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("mocodec_")]


def test_items_of_items_are_worked_on_by_one_thread():
    def inner(_: int) -> bool:
        return list(parallel.over(lambda _: threading.current_thread(), range(3))) == [threading.current_thread()] * 3

    with parallel.threads(2):
        assert all(parallel.over(inner, range(8)))


def test_numbers_of_threads(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MOCODEC_THREADS", "5")
    assert parallel.usual() == 5
    monkeypatch.setenv("MOCODEC_THREADS", "many")
    assert parallel.usual() >= 1
    with pytest.raises(BadInput, match="threads must be 1 or more"), parallel.threads(0):
        pass


def test_worker_processes_use_one():
    code = (
        "from concurrent.futures import ProcessPoolExecutor; from multiprocessing import get_context\n"
        "from mocodec import parallel\n"
        "if __name__ == '__main__':\n"
        "    with ProcessPoolExecutor(1, get_context('forkserver')) as pool:\n"
        "        print(pool.submit(parallel.usual).result())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("1\n", "")


def _numbers(made: list[int], end: int) -> Iterator[int]:
    for number in range(end):
        made.append(number)
        yield number


def test_items_are_made_ahead_in_another_thread_in_order():
    threads: set[str] = set()

    def named() -> Iterator[int]:
        for number in range(20):
            threads.add(threading.current_thread().name)
            yield number

    with parallel.threads(2):
        assert list(parallel.ahead(named())) == list(range(20))
        assert threads == {"mocodec_ahead"}
    threads.clear()
    assert list(parallel.ahead(named())) == list(range(20))
    assert threads == {threading.current_thread().name}


def test_no_more_items_are_made_than_may_wait():
    made: list[int] = []
    with parallel.threads(2):
        items = parallel.ahead(_numbers(made, 100), waiting=3)
        assert next(items) == 0
        time.sleep(0.05)
        assert len(made) <= 1 + 3
        items.close()
    assert len(made) <= 1 + 3 + 1
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("mocodec_")]


def test_an_error_while_items_are_made_ahead_is_raised_after_those_before_it():
    def failing() -> Iterator[int]:
        yield 0
        yield 1
        raise KeyError(2)

    with parallel.threads(2):
        items = parallel.ahead(failing())
        assert [next(items), next(items)] == [0, 1]
        with pytest.raises(KeyError):
            next(items)
