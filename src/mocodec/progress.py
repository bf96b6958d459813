# pyright: strict
"""How far long work has come: codecs report, a caller listens, and neither needs to know the other.

    with progress.listening(print):                 the caller: fractions from 0 to 1, rising
        for chunk in progress.over(chunks): …       a codec: after each of them
        with progress.phase(0.2, 0.9): work()       reports within `work` fall into this part of the whole
        with progress.attempt(3): work()            the fourth attempt of a search
        search(progress.attempts(trial))            a search whose trials are attempts

Without a listener a report does nothing. Threads that a codec starts have no listener, unless they run in a copy of the
context (`contextvars.copy_context`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import TypeVar

Callback = Callable[[float], object]
Item = TypeVar("Item")
Setting = TypeVar("Setting")
Result = TypeVar("Result")

SMALLEST_RISE = 0.001
"""Reports that rise by less than this are not passed on: a callback may be slow."""


class _Listener:
    """A callback, the fraction it was last called with, and the part of the whole that reports now fall into."""

    def __init__(self, callback: Callback) -> None:
        self.callback = callback
        self.last_reported = -1.0
        self.start, self.stop = 0.0, 1.0

    def report(self, fraction: float) -> None:
        """Call back, where the fraction has risen."""
        rises = (
            self.last_reported < fraction if fraction in (0.0, 1.0) else self.last_reported + SMALLEST_RISE <= fraction
        )
        if rises:
            self.last_reported = fraction
            self.callback(fraction)


_current: ContextVar[_Listener | None] = ContextVar("mocodec progress listener", default=None)


@contextmanager
def listening(callback: Callback | None) -> Generator[None, None, None]:
    """Within this context, `callback` is called with rising fractions: 0 at its start, 1 at its end unless it fails.

    An exception that the callback raises ends the work. Without a callback, a listener from outside keeps listening.
    """
    if callback is None:
        yield
        return
    listener = _Listener(callback)
    token = _current.set(listener)
    try:
        listener.report(0.0)
        yield
        listener.report(1.0)
    finally:
        _current.reset(token)


def report(fraction: float) -> None:
    """Say that this fraction, 0 to 1, of the current phase is done."""
    listener = _current.get()
    if listener is not None:
        within = min(max(fraction, 0.0), 1.0)
        listener.report(listener.start + within * (listener.stop - listener.start))


@contextmanager
def phase(start: float, stop: float) -> Generator[None, None, None]:
    """Within this context, reports from 0 to 1 mean `start` to `stop` of the phase around it. Phases nest."""
    listener = _current.get()
    if listener is None:
        yield
        return
    outer = listener.start, listener.stop
    width = listener.stop - listener.start
    listener.start, listener.stop = outer[0] + start * width, outer[0] + stop * width
    try:
        yield
        report(1.0)
    finally:
        listener.start, listener.stop = outer


def attempt(number: int) -> AbstractContextManager[None]:
    """The phase of one attempt, from 0, of a search of unknown length: each takes half of the rest."""
    return phase(1 - 0.5**number, 1 - 0.5 ** (number + 1))


def attempts(trial: Callable[[Setting], Result], share: float = 0.5) -> Callable[[Setting], Result]:
    """`trial`, where each call is the next attempt of a search and takes this share of the rest."""
    left = 1.0

    def next_attempt(setting: Setting) -> Result:
        nonlocal left
        start, left = 1 - left, left * (1 - share)
        with phase(start, 1 - left):
            return trial(setting)

    return next_attempt


def over(items: Collection[Item]) -> Iterator[Item]:
    """The items one by one, with a report after each."""
    for done, item in enumerate(items, 1):
        yield item
        report(done / len(items))
