"""What each part of tempo is worth: `python -m mocodec.evaluation.tempo_parts`.

    a few recordings ─► tempo whole, and with one part taken out at a time ─► bytes ─► docs/results/tempo_parts.json

The tables of docs/tempo.md are drawn from it by `python -m mocodec.evaluation.tempo --tables`. The prior is not trained
anew for what is taken out; it has not seen the person.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from .. import native
from ..codecs.tempo import Tempo, coefficients, contexts, corrections, jumps, model, prior, tempo
from ..motion import Motion
from . import datasets, folds, runner

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
    """Within this, one part is taken out, on both sides. In NumPy: what is compiled knows of no parts."""
    with ExitStack() as stack:
        stack.enter_context(native.without())
        for change in PARTS[name]():
            stack.enter_context(change)
        _forget()
        yield
    _forget()


def _forget() -> None:
    for cached in (contexts.groups, coefficients.plan, tempo._model_of):
        cached.cache_clear()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=datasets.SHARED / "cmu")
    parser.add_argument("--priors", type=Path, default=Path("build/priors"))
    chosen = parser.parse_args()
    figures = []
    for file in FILES:
        recording = datasets.labelled(chosen.data / file, chosen.data)
        motion = replace(recording.load(), extras={}, rotations=None)
        unseen = None
        if file.endswith(".amc"):
            who = Path(file).parent.name
            unseen = folds.prior_path(chosen.priors, (who,))
            if not unseen.is_file():
                folds.train((who,), unseen)
        with folds.unseen(unseen):
            for name in PARTS:
                for target in TARGETS:
                    with without(name):
                        figures.append(
                            {"file": recording.label, "without": name, **target, "ratio": ratio(motion, target)}
                        )
        print(recording.label, flush=True)
    RESULTS.write_text(json.dumps({"machine": runner.machine(), "figures": figures}, indent=0))


def ratio(motion: Motion, target: dict[str, float]) -> float:
    return motion.raw_bytes / Tempo(**target).in_chunks(motion).payload_bytes  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
