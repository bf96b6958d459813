"""Compression ratio of tempo without each of its parts: `scripts/bench tempo-parts`.

    a few recordings ──► tempo, whole and with one part replaced at a time ──► docs/results/tempo_parts.json

`scripts/bench tempo --tables` writes the table of docs/tempo.md from it. The prior has not seen the person; it is not
trained again for the missing part.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click
import numpy as np

from mocodec import native
from mocodec.codecs.tempo import Tempo, coefficients, contexts, corrections, jumps, model, prior, tempo
from mocodec.motion import Motion

from . import datasets, folds
from .machine import machine_description

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


def _single_frames(beyond: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    where = np.flatnonzero(beyond)
    return where, np.ones(len(where), np.int64)


def _nearest(model_: model.Model, scaled: np.ndarray, step: int, _: float = 0.0) -> tuple[np.ndarray, int, float]:
    return QUANTISE(model_, scaled, step, 0.0)


QUANTISE = coefficients.quantise
PARTS: dict[str, Callable[[], list[Any]]] = {
    "all of it": list,
    "no heading": lambda: [patch.object(model, "smooth_heading", lambda h, rate: np.zeros_like(h))],
    "no slopes of the place": lambda: [patch.object(model, "SLOPE_FIT", (1 << 30, 1 << 30))],
    "no basis of its own, where the prior knows the points": lambda: [patch.object(tempo, "OWN_FRAMES", 1 << 40)],
    "no limbs": lambda: [patch.object(prior, "of_limbs", lambda: None)],
    "no limbs, and no points on bones": lambda: [
        patch.object(prior, "of_limbs", lambda: None),
        patch.object(prior, "of_bones", lambda: None),
    ],
    "no prior: a basis of its own, always": lambda: [
        patch.object(model, "of_names", lambda *_: None),
        patch.object(prior, "of_limbs", lambda: None),
        patch.object(prior, "of_bones", lambda: None),
    ],
    "numbers rounded to the nearest": lambda: [patch.object(coefficients, "quantise", _nearest)],
    "no groups of frequencies": lambda: [patch.object(contexts, "GROUPS", ((0, 1),))],
    "corrections of single frames only": lambda: [patch.object(corrections, "_runs", _single_frames)],
    "no chunks at leaps": lambda: [patch.object(jumps, "cuts", lambda *_: [])],
}


@contextmanager
def without(name: str) -> Iterator[None]:
    """Within this, encoder and decoder lack one part. They run in NumPy: compiled kernels cannot be patched."""
    with ExitStack() as stack:
        stack.enter_context(native.without())
        for change in PARTS[name]():
            stack.enter_context(change)
        _clear_caches()
        yield
    _clear_caches()


def _clear_caches() -> None:
    """Forget models that were made with other parts."""
    for cached in (contexts.groups, coefficients.plan, tempo._model_of):
        cached.cache_clear()


@click.command("tempo-parts")
@click.option("--data", default=datasets.SHARED / "cmu", show_default=True, type=click.Path(path_type=Path))
@click.option(
    "--priors", default="build/priors", show_default=True, type=click.Path(path_type=Path), help="Their folder."
)
def command(data: Path, priors: Path) -> None:
    """Measure tempo without each of its parts; write docs/results/tempo_parts.json."""
    results = []
    for file in FILES:
        recording = datasets.labelled(data / file, data)
        motion = replace(recording.load(), extras={}, rotations=None)
        unseen = None
        if file.endswith(".amc"):
            subject = Path(file).parent.name
            unseen = folds.prior_path(priors, (subject,))
            if not unseen.is_file():
                folds.train((subject,), unseen)
        with folds.unseen(unseen):
            for name in PARTS:
                for target in TARGETS:
                    with without(name):
                        value = ratio(motion, target)
                    results.append({"file": recording.label, "without": name, **target, "ratio": value})
        click.echo(recording.label)
    RESULTS.write_text(json.dumps({"machine": machine_description(), "figures": results}, indent=0))


def ratio(motion: Motion, target: dict[str, float]) -> float:
    """Float32 positions over payload bytes at a target."""
    return motion.raw_bytes / Tempo(**target).in_chunks(motion).payload_bytes  # type: ignore[arg-type]
