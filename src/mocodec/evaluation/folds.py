"""Leave-subjects-out: what is learned from people is judged on other people.

    subject of a recording ─► its fold ─► a prior trained without anyone of that fold ─► installed while tempo is judged

The prior inside the package has learned from all the people below `../shared/data/cmu/asfamc`. A recording of one of
them is coded with a prior that has seen nobody of its fold; a recording of anyone else with the one inside the package.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from .datasets import SHARED, Recording

PEOPLE = SHARED / "cmu" / "asfamc"
FOLDS = (("01", "03"), ("02", "10", "16", "49", "64", "118", "131"))


def fold_of(recording: Recording) -> tuple[str, ...] | None:
    """The fold that this recording's person is in, by the number before the name's first underscore; else none."""
    if recording.path is None:
        return FOLDS[0] if recording.group == "package" else None
    subject = recording.path.stem.split("_")[0]
    return next((fold for fold in FOLDS if subject in fold), None)


def prior_path(folder: Path, fold: Sequence[str]) -> Path:
    """Where the prior without these people is kept; those of limbs and bones stand beside it."""
    return folder / f"prior-without-{'-'.join(fold)}.npz"


def train(fold: Sequence[str], path: Path) -> None:
    """Learn the priors from everyone but these people, and keep them."""
    from .. import formats
    from ..codecs.tempo import training

    path.parent.mkdir(parents=True, exist_ok=True)
    people = training.people(PEOPLE, fold)
    formats.replace_whole(limbs_path(path), training.train(people, with_limbs=True))
    learned = training.train(people)
    formats.replace_whole(bones_path(path), training.train_bones(people, training.read(learned)))
    formats.replace_whole(path, learned)


def limbs_path(path: Path) -> Path:
    """Where the prior of limbs is kept that was learned beside this one."""
    return path.with_name(f"limbs-{path.name}")


def bones_path(path: Path) -> Path:
    """Where the prior of bones is kept that was learned beside this one."""
    return path.with_name(f"bones-{path.name}")


@contextmanager
def unseen(prior: Path | None) -> Iterator[None]:
    """Within this, tempo uses the priors of this file and beside it, or the package's own where there is none."""
    if prior is None:
        yield
        return
    from ..codecs.tempo import prior as priors

    files = (prior, limbs_path(prior), bones_path(prior))
    with priors.installed(*(f.read_bytes() for f in files)):
        yield
