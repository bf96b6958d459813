"""Compression ratio of tempo without each of its parts: `scripts/bench tempo-parts`.

    a few recordings ──► tempo, whole and without one part at a time ──► docs/results/tempo_parts.json

`scripts/bench tempo --tables` writes the table from it. The priors' training data do not contain the person; they are
not trained again for the missing part. Settings of `Tempo` remove most parts; `patch` replaces the others.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click
import numpy as np

from mocodec import native
from mocodec.codecs.tempo import Tempo, header
from mocodec.codecs.tempo.coding import contexts, corrections, plan, quantise
from mocodec.codecs.tempo.models import MODELS, model
from mocodec.codecs.tempo.pose import leaps
from mocodec.errors import CannotEncode
from mocodec.motion import Motion

from . import datasets, folds
from .machine import machine_description
from .unknown import hold_samples

RESULTS = Path("docs/results/tempo_parts.json")
FILES = (
    "asfamc/118/118_05.amc", "asfamc/16/16_05.amc", "asfamc/131/131_04.amc",
    "asfamc/02/02_10.amc", "asfamc/03/03_02.amc", "c3d/85_02.c3d",
)  # fmt: skip
TARGETS: tuple[dict[str, float], ...] = (
    {"mean_error": 0.001},
    {"mean_error": 0.003},
    {"mean_error": 0.01},
    {"max_error": 0.003},
)
CHUNKS, WHOLE, REPEATED = "the chunks", "all of it", "all of it, each frame repeated once"
"""References of the comparison: tempo's chunks, with the fallback, and with the fallback on repeated frames."""

Encode = Callable[[Motion, dict[str, Any]], int]
"""Payload bytes of a motion at a target. Raises CannotEncode."""


@dataclass(frozen=True)
class Part:
    """encode: with or without the part; against: name of the row with the part; changes: patches of modules."""

    encode: Encode
    against: str
    changes: Callable[[], Sequence[Any]] = tuple


def chunks(motion: Motion, target: dict[str, Any]) -> int:
    """Bytes with all models, without fallback and deduplication."""
    return Tempo(**target).encode_chunks(motion).payload_bytes


def whole(motion: Motion, target: dict[str, Any]) -> int:
    """Bytes with default settings."""
    return Tempo(**target).encode(motion).payload_bytes


def repeated(motion: Motion, target: dict[str, Any]) -> int:
    """Bytes with each frame repeated once."""
    return whole(hold_samples(motion, 2), target)


def without_repeats(motion: Motion, target: dict[str, Any]) -> int:
    """Bytes with each frame repeated once, without deduplication."""
    return Tempo(**target).encode_without_repeats(hold_samples(motion, 2)).payload_bytes


def smallest_of(*models: str) -> Encode:
    """An encoder that keeps the smallest result of some models."""

    def encode(motion: Motion, target: dict[str, Any]) -> int:
        sizes = []
        for name in models:
            try:
                sizes.append(Tempo(**target, model=name).encode_without_repeats(motion).payload_bytes)
            except CannotEncode:  # the model does not fit the motion
                continue
        if not sizes:
            raise CannotEncode(f"none of these models fits: {', '.join(models)}")
        return min(sizes)

    return encode


def _single_frames(beyond: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    start = np.flatnonzero(beyond)
    return start, np.ones(len(start), np.int64)


def _nearest(model_: model.Model, scaled: np.ndarray, step: int, _: float = 0.0) -> quantise.Quantised:
    return QUANTISE(model_, scaled, step, 0.0)


QUANTISE = quantise.quantise
PARTS: dict[str, Part] = {
    CHUNKS: Part(chunks, CHUNKS),
    WHOLE: Part(whole, WHOLE),
    REPEATED: Part(repeated, REPEATED),
    "no heading": Part(
        chunks, CHUNKS, lambda: [patch.object(model, "smooth_heading", lambda angles, rate: np.zeros_like(angles))]
    ),
    "no bone directions": Part(smallest_of("points-prior", "points-stored"), CHUNKS),
    "no prior: a stored basis, always": Part(smallest_of("points-stored", "directions-stored"), CHUNKS),
    **{f"{name} only": Part(smallest_of(name), CHUNKS) for name in (*MODELS, "direct", "hou2014")},
    "numbers rounded to the nearest": Part(chunks, CHUNKS, lambda: [patch.object(quantise, "quantise", _nearest)]),
    "no groups of frequencies": Part(chunks, CHUNKS, lambda: [patch.object(contexts, "GROUPS", ((0, 1),))]),
    "corrections of single frames only": Part(
        chunks, CHUNKS, lambda: [patch.object(corrections, "_runs", _single_frames)]
    ),
    "no chunks at leaps": Part(chunks, CHUNKS, lambda: [patch.object(leaps, "discontinuities", lambda *_: [])]),
    "no fallback to hou2014": Part(chunks, WHOLE),
    "no repeats, each frame repeated once": Part(without_repeats, REPEATED),
}


@contextmanager
def replaced(changes: Sequence[Any]) -> Iterator[None]:
    """A context with patches, in which encoder and decoder run in NumPy: patches do not reach compiled kernels."""
    if not changes:
        yield
        return
    with ExitStack() as stack:
        stack.enter_context(native.without())
        for change in changes:
            stack.enter_context(change)
        _clear_caches()
        yield
    _clear_caches()


def _clear_caches() -> None:
    """Clear caches of values computed with other parts."""
    for cached in (
        contexts.groups, contexts.lookup, plan.plan, quantise._prediction, quantise.prices, header._read_model,
    ):  # fmt: skip
        cached.cache_clear()


@click.command("tempo-parts")
@click.option("--data", default=datasets.SHARED / "cmu", show_default=True, type=click.Path(path_type=Path))
@click.option(
    "--priors", default="build/priors", show_default=True, type=click.Path(path_type=Path), help="Their folder."
)
def command(data: Path, priors: Path) -> None:
    """Measure tempo without each of its parts; write docs/results/tempo_parts.json. Prints a line after each part."""
    results = []
    for file in FILES:
        recording = datasets.labelled(data / file, data)
        motion = replace(recording.load(), extras={}, rotations=None)
        unseen = folds.trained(priors, (Path(file).parent.name,)) if file.endswith(".amc") else None
        with folds.unseen(unseen):
            for name in PARTS:
                for target in TARGETS:
                    if value := ratio(name, motion, target):
                        row = {"file": recording.label, "without": name, "against": PARTS[name].against}
                        results.append({**row, **target, "ratio": value})
                click.echo(f"{recording.label}: {name}")
    RESULTS.write_text(json.dumps({"machine": machine_description(), "figures": results}, indent=0) + "\n")


def ratio(name: str, motion: Motion, target: dict[str, float]) -> float | None:
    """Float32 positions over payload bytes in a row of the table; None if no model of the row fits the motion."""
    part = PARTS[name]
    try:
        with replaced(part.changes()):
            return motion.raw_bytes / part.encode(motion, target)
    except CannotEncode:
        return None
