"""Leave-subjects-out: a prior learned from people is judged on other people.

    subject of a recording ──► its fold ──► a prior trained without the subjects of the fold ──► installed in tempo

The prior inside the package is trained on all people below `../shared/data/cmu/asfamc`. A recording of one of them is
coded with a prior trained without the people of its fold, any other recording with the prior inside the package.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mocodec import formats
from mocodec.codecs.tempo import prior as priors

from .datasets import SHARED, Recording

PEOPLE = SHARED / "cmu" / "asfamc"
FOLDS = (("01", "03"), ("02", "10", "16", "49", "64", "118", "131"))


def fold_of(recording: Recording) -> tuple[str, ...] | None:
    """The fold of a recording's person, by the number before the first underscore of its name; None if in no fold."""
    if recording.path is None:
        return FOLDS[0] if recording.group == "package" else None
    subject = recording.path.stem.split("_")[0]
    return next((fold for fold in FOLDS if subject in fold), None)


def prior_path(folder: Path, fold: Sequence[str]) -> Path:
    """The file of the prior trained without these people; the priors of limbs and bones are beside it."""
    return folder / f"prior-without-{'-'.join(fold)}.npz"


def train(fold: Sequence[str], path: Path) -> None:
    """Train the priors on everyone but these people and write them."""
    from mocodec.codecs.tempo import training

    path.parent.mkdir(parents=True, exist_ok=True)
    people = training.people(PEOPLE, fold)
    formats.replace_whole(limbs_path(path), training.train(people, with_limbs=True))
    learned = training.train(people)
    formats.replace_whole(bones_path(path), training.train_bones(people, training.read(learned)))
    formats.replace_whole(path, learned)


def limbs_path(path: Path) -> Path:
    """The file of the prior of limbs that belongs to this prior."""
    return path.with_name(f"limbs-{path.name}")


def bones_path(path: Path) -> Path:
    """The file of the prior of bones that belongs to this prior."""
    return path.with_name(f"bones-{path.name}")


@contextmanager
def unseen(prior: Path | None) -> Iterator[None]:
    """Within this, tempo uses the priors of this file and beside it; None: those of the package."""
    if prior is None:
        yield
        return
    files = (prior, limbs_path(prior), bones_path(prior))
    with priors.installed(*(f.read_bytes() for f in files)):
        yield
