"""Runs coders, ours and rivals, on recordings to equal errors: `scripts/bench eval`.

    recording ──► encode at a knob ──► decode ──► measure ──► change the knob until the target is met ──► Record

A target is a mean error or a hard maximum, in metres. Our codecs have settings for it (`mean_error=`, `max_error=`);
for rivals, this module searches the knob. Bytes are those of the whole file: ours is the `.mocz` without the
recording's extras, a rival's is the stream and the deflated gap mask.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from mocodec import __version__, api, container, metrics
from mocodec.codecs.liu2006 import statistics
from mocodec.errors import MocodecError
from mocodec.motion import Motion
from mocodec.typing import Floats

from .. import datasets, folds
from . import rivals
from .records import LOSSLESS, OURS, TARGETS, Record

SEARCH_STEPS = 9
"""Largest number of encodings in the search of a rival's knob."""
MEAN_WITHIN = 0.01
"""The search stops at this relative difference from a mean error."""


@dataclass(frozen=True)
class Task:
    """One coder on one recording, at all targets."""

    coder: str
    recording: datasets.Recording
    targets: tuple[tuple[str, float], ...] = TARGETS
    prior: Path | None = None
    """Folder of the priors trained without this recording's person, for tempo."""


@dataclass(frozen=True)
class Outcome:
    """One encoding and decoding: total bytes and bytes by part, decoded positions, times and settings."""

    data_bytes: int
    positions: Floats
    encode_s: float
    decode_s: float
    settings: dict[str, Any]
    parts: dict[str, int]


def run_codec(codec: str, motion: Motion, **settings: Any) -> Outcome:
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
    """Bytes of the container's parts; for liu2006 and hou2014, also of the codec's parts."""
    parts = {name: size for name, size in file.info["bytes_by_part"].items() if size}
    if file.encoded.codec == "liu2006":
        own = statistics(file.encoded).bytes_by_part
        unassigned = parts.get("shared", 0) + parts["chunks"] - sum(own.values())
        own["framing"] = parts["framing"] + unassigned
    elif file.encoded.codec == "hou2014":
        own = {"transforms": parts.get("shared", 0), "coefficients": parts.get("chunks", 0)}
    else:
        return parts
    return {name: size for name, size in {**parts, "shared": 0, "chunks": 0, **own}.items() if size}


def run_rival(rival: rivals.Rival, motion: Motion, knob: float) -> Outcome:
    """Encode and decode with a rival; bytes include the deflated gap mask."""
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
    """The error for this kind of target: mean or largest distance, metres."""
    error = metrics.distances(motion.positions, outcome.positions)
    return float(np.nanmean(error) if target == "mean_error" else np.nanmax(error))


def search(run: Callable[[float], Outcome], motion: Motion, target: str, wanted: float, guess: float) -> Outcome | None:
    """Search the knob for a target: an error within 1 % of a mean; or below a hard maximum, with the fewest bytes.

    Bracketed secant steps on log error against log knob. None if no step keeps the hard maximum.
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
        goal = wanted * (0.985 if target == "max_error" else 1.0)
        if error < goal:
            low = (knob, error)
        else:
            high = (knob, error)
        if low and high and high[0] > low[0]:
            span = np.log(high[1] / low[1])
            share = np.clip(np.log(goal / low[1]) / span if span > 0 else 0.5, 0.1, 0.9)
            knob = float(np.exp(np.log(low[0]) + share * np.log(high[0] / low[0])))
        else:
            knob *= float(np.clip(goal / error, 0.1, 10.0))
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
                outcome = encode_to_target(task.coder, rival, motion, target, wanted)
            if outcome is None:
                record.problem = "no setting keeps the target"
            else:
                fill(record, motion, outcome)
                if task.prior is not None:
                    record.settings = {**record.settings, "prior": task.prior.name}
        except MocodecError as error:
            record.problem = str(error)
        except Exception as error:  # a failure of a rival is a result
            record.problem = f"{type(error).__name__}: {error}"
        records.append(record)
    return records


def encode_to_target(
    coder: str, rival: rivals.Rival | None, motion: Motion, target: str, wanted: float
) -> Outcome | None:
    """One coder at one target; None if a rival cannot meet it."""
    if rival is not None:
        if target == "lossless":
            return run_rival(rival, motion, 0.0)
        guess = rival.knob_of(wanted if target == "mean_error" else wanted / 3)
        return search(lambda knob: run_rival(rival, motion, knob), motion, target, wanted, guess)
    return run_codec(coder, motion, **({} if target == "lossless" else {target: wanted}))


def fill(record: Record, motion: Motion, outcome: Outcome) -> None:
    """Write the measurements of an outcome to its record."""
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
    """A frame without gaps from the front: (points, 2) metres, parents and mean errors; empty without such a frame."""
    complete = np.flatnonzero(~motion.gaps.any(axis=1))
    if motion.skeleton is None or not len(complete) or len(set(motion.names)) < motion.points:
        return {}
    pose = motion.positions[complete[len(complete) // 2]]
    up = "xyz".index(motion.up)
    across = [axis for axis in range(3) if axis != up]
    side = max(across, key=lambda axis: float(np.ptp(pose[:, axis])))
    return {
        "positions": np.round(pose[:, [side, up]], 4).tolist(),
        "parents": list(motion.skeleton.parents),
        "mean_error_m": [compared.per_point[name]["mean_error"] for name in motion.names],
    }


def unreadable(task: Task, problem: str) -> Record:
    """The record of an unreadable recording."""
    return Record(
        codec=task.coder, ours=task.coder in OURS, settings={}, target="", target_m=0.0, file=task.recording.label,
        content="", frames=0, points=0, rate=0.0, problem=problem,
    )  # fmt: skip


def tasks(recordings: Sequence[datasets.Recording], coders: Sequence[str], priors: Path | None = None) -> list[Task]:
    """One task for each coder and recording. Our codecs come first because they take longest.

    priors: folder of priors by fold; tempo uses those trained without the recording's person.
    """
    order = sorted(coders, key=lambda coder: coder not in OURS)
    return [
        Task(coder, recording, prior=prior_for(recording, priors) if coder == "tempo" else None)
        for recording in recordings
        for coder in order
    ]


def prior_for(recording: datasets.Recording, priors: Path | None) -> Path | None:
    """The folder of the priors trained without this person; None if the person is in no fold."""
    fold = folds.fold_of(recording)
    return folds.prior_folder(priors, fold) if priors is not None and fold is not None else None


def run(work: Sequence[Task], workers: int, known: Sequence[Record] = ()) -> Iterator[list[Record]]:
    """Run tasks in `workers` processes and yield their records. Records of an earlier run (`known`) are reused."""
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
    """Coder and recording."""
    return task.coder, task.recording.label


def known_tasks(known: Sequence[Record]) -> dict[tuple[str, str], list[Record]]:
    """Earlier records by task, for tasks with all records from the installed versions."""
    by_task: dict[tuple[str, str], list[Record]] = {}
    for record in known:
        by_task.setdefault((record.codec, record.file), []).append(record)
    return {key: records for key, records in by_task.items() if all(current(r) for r in records)}


def current(record: Record) -> bool:
    """Whether a record has a result from the installed version of its coder."""
    try:
        now = rivals.RIVALS[record.codec]().version() if record.codec in rivals.RIVALS else __version__
    except Exception:
        return False
    return record.version == now and not record.problem
