"""Signals that stop a command (SIGINT, SIGTERM, SIGHUP): unfinished files are removed, and one line is printed.

    first signal ─► KeyboardInterrupt ─► `finally` blocks clean up ─► exit code 128 + signal

Signals within a second after the first are ignored, so that they do not interrupt the cleaning up. Before a command
runs and after it has ended, a signal ends the process at once.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from types import FrameType
from typing import Any

GRACE_S = 1.0

_received: list[int] = []
_ignored_until = 0.0


def exit_code() -> int:
    """The exit code of a command that was stopped: 128 + the signal, SIGINT if none was noted."""
    return 128 + (_received[0] if _received else signal.SIGINT)


def was_stopped() -> bool:
    """Whether a signal has stopped the command: an exception may have taken the place of KeyboardInterrupt since."""
    return bool(_received)


def install(ignore_keyboard: bool = False) -> None:
    """From now on these signals raise KeyboardInterrupt. ignore_keyboard: SIGINT is for another process."""
    _set(_stop)
    if ignore_keyboard:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.unraisablehook = _unraisable


def leave_quietly() -> None:
    """From now on these signals end the process at once, as nothing is left to clean up."""
    _set(_leave)


def _set(handler: Any) -> None:
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # nohup ignores SIGHUP
            signal.signal(number, handler)


def _stop(number: int, _: FrameType | None) -> None:
    global _ignored_until
    now = time.monotonic()
    if now < _ignored_until:
        return
    _ignored_until = now + GRACE_S
    _received.append(number)
    raise KeyboardInterrupt


def _leave(number: int, _: FrameType | None) -> None:
    os._exit(128 + number)


def _unraisable(unraisable: Any) -> None:
    """An interrupt that arrived where no exception can be raised (a destructor) is delivered again."""
    global _ignored_until
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _ignored_until = 0.0
        signal.raise_signal(_received[0] if _received else signal.SIGINT)
    elif not was_stopped():
        sys.__unraisablehook__(unraisable)
