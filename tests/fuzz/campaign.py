"""Many calls in worker processes: counts of the outcomes, and minimised inputs of the findings."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import mutations, resigned, seeds
from .worker import Outcome, serve

LONGEST_SECONDS = 120
"""A worker that does not answer for so long is stopped: it hangs outside Python."""
MINIMISING_CALLS, MINIMISING_SECONDS = 150, 60
CALLS_A_WORKER = 2000
"""A worker is replaced after so many calls."""
Call = tuple[str, str, bytes, dict[str, bytes]]
"""Kind, name, data and the files beside them."""


class Worker:
    """One worker process, started again after a crash."""

    def __init__(self, pure: bool, limit_memory: bool) -> None:
        self.pure, self.limit_memory = pure, limit_memory
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs, self.pure, self.limit_memory), daemon=True)
        self.process.start()
        theirs.close()
        self.calls = 0

    def run(self, call: Call) -> Outcome:
        """The outcome of one call."""
        if self.calls >= CALLS_A_WORKER:
            self.close()
            self._start()
        self.calls += 1
        start = time.perf_counter()
        first = 60 if self.calls == 1 else 0  # the process may still be importing
        try:
            self.connection.send(call)
            if self.connection.poll(LONGEST_SECONDS + first):
                return self.connection.recv()
            outcome = Outcome("time", "no answer", time.perf_counter() - start)
        except (EOFError, OSError):
            self.process.join(5)
            outcome = Outcome("crash", f"exit code {self.process.exitcode}", time.perf_counter() - start)
        self.close()
        self._start()
        return outcome

    def close(self) -> None:
        self.connection.close()
        self.process.join(1)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


@dataclass
class Campaign:
    """Runs calls, counts outcomes, and stores findings as files in a folder."""

    worker: Worker
    folder: Path
    counts: dict[str, Counter[str]] = field(default_factory=dict[str, Counter[str]])
    findings: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])
    slowest: dict[str, float] = field(default_factory=dict[str, float])

    def run(self, calls: Iterator[Call], until: Callable[[], bool]) -> None:
        """Run calls until there are none left, or until it is time."""
        for call in calls:
            outcome = self.worker.run(call)
            self.counts.setdefault(call[0], Counter())[outcome.kind] += 1
            self.slowest[call[0]] = max(self.slowest.get(call[0], 0.0), outcome.seconds)
            if outcome.is_finding:
                self._keep(call, outcome)
            if until():
                return

    def _keep(self, call: Call, outcome: Outcome) -> None:
        """Store a finding once: of those that end at the same place, the first, minimised."""
        key = f"{call[0]} {outcome.kind} {outcome.what.split(':', 2)[0:2]}"
        if key in self.findings:
            self.findings[key]["times"] += 1
            return
        data = call[2] if call[0] == "code" else self._minimised(call, outcome)
        digest = hashlib.sha256(data).hexdigest()[:12]
        self.folder.mkdir(parents=True, exist_ok=True)
        name = f"{call[0]}-{digest}-{Path(call[1]).name}"
        (self.folder / name).write_bytes(data)
        self.findings[key] = {"file": name, "outcome": outcome.kind, "what": outcome.what, "times": 1}
        print(f"{outcome.kind}: {outcome.what} ({self.folder / name})", flush=True)

    def _minimised(self, call: Call, outcome: Outcome) -> bytes:
        """The data with as many blocks left out as the outcome allows."""
        kind, name, data, beside = call
        stop, left = time.perf_counter() + MINIMISING_SECONDS, MINIMISING_CALLS
        size = len(data) // 2
        while size and left and time.perf_counter() < stop:
            at = 0
            while at < len(data) and left and time.perf_counter() < stop:
                shorter = data[:at] + data[at + size :]
                left -= 1
                again = self.worker.run((kind, name, shorter, beside))
                if (again.kind, again.what.split(":")[0:2]) == (outcome.kind, outcome.what.split(":")[0:2]):
                    data = shorter
                else:
                    at += size
            size //= 2
        return data

    def as_json(self, seconds: float) -> dict[str, Any]:
        """Counts and findings, for docs/results."""
        return {
            "minutes": round(seconds / 60, 1),
            "calls": {kind: dict(sorted(count.items())) for kind, count in sorted(self.counts.items())},
            "slowest_seconds": {kind: round(value, 2) for kind, value in sorted(self.slowest.items())},
            "findings": sorted(self.findings.values(), key=lambda finding: str(finding["file"])),
        }


def read_calls(seed: int) -> Iterator[Call]:
    """Damaged files of every format, without end."""
    random = np.random.default_rng([seed, 1])
    known = seeds.files()
    while True:
        one, other = known[random.integers(len(known))], known[random.integers(len(known))]
        yield "read", one.name, mutations.mutate(one.data, random, other.data), one.beside


def decode_calls(seed: int) -> Iterator[Call]:
    """Re-signed containers of every codec, without end."""
    random = np.random.default_rng([seed, 2])
    known = list(seeds.containers().items())
    while True:
        name, data = known[random.integers(len(known))]
        yield "decode", f"{name}.mocz", resigned.mutate(data, random), {}


def code_calls(first: int, count: int | None = None) -> Iterator[Call]:
    """Strange motions, by number."""
    number = first
    while count is None or number < first + count:
        yield "code", f"{number}.txt", str(number).encode(), {}
        number += 1


def store(path: Path, key: str, result: dict[str, Any]) -> None:
    """Put a result under a key of a JSON file."""
    results = json.loads(path.read_text()) if path.exists() else {}
    results[key] = result
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=2, sort_keys=True) + "\n")
