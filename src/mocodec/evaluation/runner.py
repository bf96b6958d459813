"""Codecs × targets × recordings → records: what `mocodec eval` measures, ours and the rivals by one search.

    recording ─► each coder: encode at a knob ─► decode ─► measure ─► move the knob until the target is met ─► record

A target is a mean error or a hard maximum, in metres. Ours are asked for it by name (`mean_error=`, `max_error=`) and
held to their word; where a codec cannot steer to it, and for every rival, the knob is searched here. Bytes are those of
the whole file: for ours the `.mocz` without the recording's extras, for rivals the stream plus the deflated gap mask.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__, api, container, metrics
from ..errors import MocodecError
from ..motion import Motion
from . import datasets, folds, rivals

OURS = ("tempo", "hou2014", "liu2006", "lossless")
TARGETS = (("mean_error", 0.001), ("mean_error", 0.003), ("mean_error", 0.01),
           ("max_error", 0.001), ("max_error", 0.003), ("max_error", 0.01))  # fmt: skip
LOSSLESS = ("lossless", 0.0)
SEARCH_STEPS = 9
MEAN_WITHIN = 0.01


@dataclass(frozen=True)
class Task:
    """One coder on one recording, for all its targets."""

    coder: str
    recording: datasets.Recording
    targets: tuple[tuple[str, float], ...] = TARGETS
    prior: Path | None = None
    """For tempo: a prior that has not seen this recording's person."""


@dataclass
class Record:
    """What came out of one coder at one target on one recording. Errors in metres, times in seconds."""

    codec: str
    ours: bool
    settings: dict[str, Any]
    target: str
    target_m: float
    file: str
    content: str
    frames: int
    points: int
    rate: float
    bytes: int = 0
    bytes_by_part: dict[str, int] = field(default_factory=dict)
    ratio: float = 0.0
    mean_error_m: float = 0.0
    p99_error_m: float = 0.0
    max_error_m: float = 0.0
    d_percent: float = 0.0
    rms_m: float = 0.0
    gaps_equal: bool = True
    encode_s: float = 0.0
    decode_s: float = 0.0
    encode_fps: float = 0.0
    decode_fps: float = 0.0
    peak_memory_mb: float = 0.0
    version: str = ""
    problem: str = ""
    figure: dict[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str, float, str, str]:
        """What makes a record the same measurement: a second run does not repeat it."""
        return self.codec, self.target, self.target_m, self.content, self.version


@dataclass(frozen=True)
class Outcome:
    """One encode and decode: bytes, decoded positions and the two times."""

    data_bytes: int
    positions: np.ndarray
    encode_s: float
    decode_s: float
    settings: dict[str, Any]
    parts: dict[str, int]


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "mocodec": __version__,
    }


def ours(codec: str, motion: Motion, **settings: Any) -> Outcome:
    """Encode and decode with a codec of this package."""
    started = time.perf_counter()
    data = container.pack(api.with_options(codec, **settings).encode(motion))
    encoded = time.perf_counter()
    decoded = api.decode(data, Motion)
    done = time.perf_counter()
    with api.open(data) as f:
        parts = bytes_by_part(f)
    return Outcome(len(data), decoded.positions, encoded - started, done - encoded, settings, parts)


def bytes_by_part(file: api.File) -> dict[str, int]:
    """The container's parts, and inside the codec's own bytes what it can tell apart."""
    parts = {name: size for name, size in file.info["bytes_by_part"].items() if size}
    if file.encoded.codec == "liu2006":
        from ..codecs.liu2006 import statistics

        own = statistics(file.encoded).bytes_by_part
        around = parts.get("shared", 0) + parts["chunks"] - sum(own.values())
        own["framing"] = parts["framing"] + around
    elif file.encoded.codec == "hou2014":
        own = {"transforms": parts.get("shared", 0), "coefficients": parts.get("chunks", 0)}
    else:
        return parts
    return {name: size for name, size in {**parts, "shared": 0, "chunks": 0, **own}.items() if size}


def theirs(rival: rivals.Rival, motion: Motion, knob: float) -> Outcome:
    """Encode and decode with a rival; gaps travel as a deflated mask."""
    positions, mask = datasets.filled(motion)
    started = time.perf_counter()
    data = rival.encode(positions, knob)
    encoded = time.perf_counter()
    decoded = rival.decode(data, positions.shape)
    done = time.perf_counter()
    decoded = np.where(np.isnan(motion.positions), np.nan, decoded)
    parts = {"stream": len(data), "gaps": len(mask)}
    return Outcome(len(data) + len(mask), decoded, encoded - started, done - encoded, {"knob": knob}, parts)


def measured(target: str, motion: Motion, outcome: Outcome) -> float:
    """The error that a target speaks of."""
    error = metrics.distances(motion.positions, outcome.positions)
    return float(np.nanmean(error) if target == "mean_error" else np.nanmax(error))


def search(run: Callable[[float], Outcome], motion: Motion, target: str, wanted: float, guess: float) -> Outcome | None:
    """The outcome whose error is the target: within 1 % for a mean; the largest knob found that keeps a maximum.

    Secant steps on log error against log knob, bracketed; none if no knob keeps a hard maximum.
    """
    low: tuple[float, float] | None = None  # knob and error below the target
    high: tuple[float, float] | None = None
    best: Outcome | None = None
    knob = guess
    for _ in range(SEARCH_STEPS):
        outcome = run(knob)
        error = max(measured(target, motion, outcome), wanted * 1e-6)
        if target == "max_error":
            if error <= wanted and (best is None or outcome.data_bytes < best.data_bytes):
                best = outcome
            if error <= wanted and error > wanted * 0.97:
                break
        else:
            if best is None or abs(error - wanted) < abs(measured(target, motion, best) - wanted):
                best = outcome
            if abs(error / wanted - 1) < MEAN_WITHIN:
                break
        aim = wanted * (0.985 if target == "max_error" else 1.0)
        if error < aim:
            low = (knob, error)
        else:
            high = (knob, error)
        if low and high and high[0] > low[0]:
            span = np.log(high[1] / low[1])
            share = np.clip(np.log(aim / low[1]) / span if span > 0 else 0.5, 0.1, 0.9)
            knob = float(np.exp(np.log(low[0]) + share * np.log(high[0] / low[0])))
        else:
            knob *= float(np.clip(aim / error, 0.1, 10.0))
    return best


def run_task(task: Task) -> list[Record]:
    """All records of one coder on one recording."""
    motion, problem = datasets.loaded(task.recording)
    if motion is None:
        return [unreadable(task, problem)]
    motion = replace(motion, extras={}, rotations=None)
    rival = rivals.RIVALS[task.coder]() if task.coder in rivals.RIVALS else None
    version = rival.version() if rival else __version__
    content = datasets.content_hash(motion)
    records = []
    without_loss = rivals.is_lossless(rival) if rival else task.coder == "lossless"
    for target, wanted in (LOSSLESS,) if without_loss else task.targets:
        record = Record(
            codec=task.coder, ours=rival is None, settings={}, target=target, target_m=wanted, version=version,
            file=task.recording.label, content=content, frames=len(motion), points=motion.points, rate=motion.rate,
        )  # fmt: skip
        try:
            with folds.unseen(task.prior):
                outcome = one(task.coder, rival, motion, target, wanted)
            if outcome is None:
                record.problem = "no setting keeps the target"
            else:
                fill(record, motion, outcome)
                if task.prior is not None:
                    record.settings = {**record.settings, "prior": task.prior.stem}
        except MocodecError as error:
            record.problem = str(error)
        except Exception as error:  # a rival's own failure is a result, not ours to hide
            record.problem = f"{type(error).__name__}: {error}"
        records.append(record)
    return records


def one(coder: str, rival: rivals.Rival | None, motion: Motion, target: str, wanted: float) -> Outcome | None:
    """One coder at one target."""
    if rival is not None:
        if target == "lossless":
            return theirs(rival, motion, 0.0)
        guess = rival.knob_of(wanted if target == "mean_error" else wanted / 3)
        return search(lambda knob: theirs(rival, motion, knob), motion, target, wanted, guess)
    return ours(coder, motion, **({} if target == "lossless" else {target: wanted}))


def fill(record: Record, motion: Motion, outcome: Outcome) -> None:
    """Write an outcome's figures into its record."""
    decoded = replace(motion, positions=outcome.positions)
    compared = metrics.compare(motion, decoded, outcome.data_bytes)
    record.settings, record.bytes, record.bytes_by_part = outcome.settings, outcome.data_bytes, outcome.parts
    record.ratio = float(compared.ratio or 0.0)
    record.mean_error_m, record.p99_error_m, record.max_error_m = (
        compared.mean_error, compared.p99_error, compared.max_error)  # fmt: skip
    record.d_percent, record.rms_m, record.gaps_equal = compared.d_percent, compared.rms, compared.gaps_equal
    record.encode_s, record.decode_s = outcome.encode_s, outcome.decode_s
    record.encode_fps = len(motion) / max(outcome.encode_s, 1e-9)
    record.decode_fps = len(motion) / max(outcome.decode_s, 1e-9)
    if record.codec == "tempo" and (record.target, record.target_m) == ("mean_error", 0.003):
        record.figure = stick_figure(motion, compared)
    record.peak_memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def stick_figure(motion: Motion, compared: metrics.Comparison) -> dict[str, Any]:
    """One frame from the front, (points, 2) in metres, with each point's mean error; empty where none is whole."""
    whole = np.flatnonzero(~motion.gaps.any(axis=1))
    if motion.skeleton is None or not len(whole) or len(set(motion.names)) < motion.points:
        return {}
    pose = motion.positions[whole[len(whole) // 2]]
    up = "xyz".index(motion.up)
    across = [axis for axis in range(3) if axis != up]
    side = max(across, key=lambda axis: float(np.ptp(pose[:, axis])))
    return {
        "positions": np.round(pose[:, [side, up]], 4).tolist(),
        "parents": list(motion.skeleton.parents),
        "mean_error_m": [compared.per_point[name]["mean_error"] for name in motion.names],
    }


def unreadable(task: Task, problem: str) -> Record:
    return Record(
        codec=task.coder, ours=task.coder in OURS, settings={}, target="", target_m=0.0, file=task.recording.label,
        content="", frames=0, points=0, rate=0.0, problem=problem,
    )  # fmt: skip


def tasks(recordings: Sequence[datasets.Recording], coders: Sequence[str], priors: Path | None = None) -> list[Task]:
    """One task for every coder and recording, ours first, whose work is longest.

    priors: folder of priors by fold; tempo is judged with the one that has not seen a recording's person.
    """
    order = sorted(coders, key=lambda coder: coder not in OURS)
    return [
        Task(coder, recording, prior=prior_for(recording, priors) if coder == "tempo" else None)
        for recording in recordings
        for coder in order
    ]


def prior_for(recording: datasets.Recording, priors: Path | None) -> Path | None:
    """The file of the prior that has not seen this person, where the person is one of the folds."""
    fold = folds.fold_of(recording)
    return folds.prior_path(priors, fold) if priors is not None and fold is not None else None


def run(work: Sequence[Task], workers: int, known: Sequence[Record] = ()) -> Iterator[list[Record]]:
    """Records as they come. Tasks whose records are all in `known` (an earlier run's) are not run again."""
    done = known_tasks(known)
    left = [task for task in work if task_key(task) not in done]
    finished = [task for task in work if task_key(task) in done]
    for task in finished:
        yield done[task_key(task)]
    if workers <= 1:
        yield from map(run_task, left)
        return
    threads = {name: os.environ.get(name) for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")}
    os.environ.update(dict.fromkeys(threads, "1"))
    try:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for future in as_completed([pool.submit(run_task, task) for task in left]):
                yield future.result()
    finally:
        for name, value in threads.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def task_key(task: Task) -> tuple[str, str]:
    return task.coder, task.recording.label


def known_tasks(known: Sequence[Record]) -> dict[tuple[str, str], list[Record]]:
    """Earlier records by task, if they were made by the versions that are installed now."""
    by_task: dict[tuple[str, str], list[Record]] = {}
    for record in known:
        by_task.setdefault((record.codec, record.file), []).append(record)
    return {key: records for key, records in by_task.items() if all(current(r) for r in records)}


def current(record: Record) -> bool:
    """Whether this record would come out again: same version of its coder."""
    try:
        now = rivals.RIVALS[record.codec]().version() if record.codec in rivals.RIVALS else __version__
    except Exception:
        return False
    return record.version == now and not record.problem


def save(path: Path, records: Sequence[Record]) -> None:
    """Records as JSON: a list, a line for each record, so that a changed figure is one changed line."""
    from .. import formats

    ordered = sorted(records, key=lambda r: (r.file, not r.ours, r.codec, r.target, r.target_m))
    lines = [json.dumps(rounded(asdict(record)), ensure_ascii=False) for record in ordered]
    formats.replace_whole(path, ("[\n" + ",\n".join(lines) + "\n]\n").encode())


def rounded(value: Any) -> Any:
    """Floats to six digits, in whatever holds them: what was measured is not better than that."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {name: rounded(item) for name, item in value.items()}
    return [rounded(item) for item in value] if isinstance(value, list | tuple) else value


def load(path: Path) -> list[Record]:
    """Records from JSON; none where there is no such file."""
    if not path.is_file():
        return []
    return [Record(**record) for record in json.loads(path.read_text())]
