"""A process that runs calls one after the other, within limits of memory and time."""

from __future__ import annotations

import os
import resource
import signal
import time
import traceback
import warnings
from contextlib import nullcontext
from multiprocessing.connection import Connection
from typing import NamedTuple

from mocodec import native
from mocodec.errors import MocodecError

from .calls import CALLS

MEMORY_BYTES = 1 << 30
"""Address space that a call may take beyond what the process has at its start."""
SECONDS = 10
"""Processor time that a call may take: other work on the machine does not count."""


class Outcome(NamedTuple):
    """kind: "ok", "refused" (a MocodecError), "foreign", "broken promise", "memory", "time" or "crash".

    what: error and place, empty for "ok". seconds: processor time of the call.
    """

    kind: str
    what: str
    seconds: float

    @property
    def is_finding(self) -> bool:
        return self.kind not in ("ok", "refused")


class OutOfTime(BaseException):
    """The call took too long."""


def serve(connection: Connection, pure: bool, limit_memory: bool) -> None:
    """Run the calls that come through the connection until it closes."""
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if limit_memory:
        limit = _address_space() + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with native.without() if pure else nullcontext():
        while True:
            try:
                call = connection.recv()
            except EOFError:
                return
            connection.send(run(*call))


def run(kind: str, name: str, data: bytes, beside: dict[str, bytes]) -> Outcome:
    """Run one call."""
    start = time.process_time()

    def outcome(kind: str, error: BaseException | None = None) -> Outcome:
        return Outcome(kind, "" if error is None else _in_words(error), time.process_time() - start)

    before = signal.signal(signal.SIGPROF, _out_of_time)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        CALLS[kind](name, data, beside)
        return outcome("ok")
    except MocodecError as error:
        return outcome("refused", error)
    except AssertionError as error:
        return outcome("broken promise", error)
    except MemoryError as error:
        return outcome("memory", error)
    except OutOfTime as error:
        return outcome("time", error)
    except Exception as error:
        return outcome("foreign", error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _in_words(error: BaseException) -> str:
    """Type, place and message of an error."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{os.path.basename(frames[-1].filename)}:{frames[-1].lineno}" if frames else "?"
    return f"{type(error).__name__} at {place}: {str(error)[:200]}"


def _out_of_time(*_: object) -> None:
    raise OutOfTime


def _address_space() -> int:
    """Bytes of address space that this process has."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()
