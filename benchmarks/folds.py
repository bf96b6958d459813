"""Leave-subjects-out cross-validation: a prior is tested on people outside its training data.

    subject of a recording ──► its fold ──► priors trained without the subjects of the fold ──► installed in tempo

The priors in the package are trained on all people in `../shared/data/cmu/asfamc`. A recording of one of them uses
priors trained without the people of its fold; any other recording uses the priors in the package.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mocodec import formats
from mocodec.codecs.tempo import training
from mocodec.codecs.tempo.models import prior as priors

from .datasets import SHARED, Recording

PEOPLE = SHARED / "cmu" / "asfamc"
FOLDS = (("01", "03"), ("02", "10", "16", "49", "64", "118", "131"))


def fold_of(recording: Recording) -> tuple[str, ...] | None:
    """The fold of a recording's person, by the number before the first underscore of its name; None: no fold."""
    if recording.path is None:
        return FOLDS[0] if recording.group == "package" else None
    subject = recording.path.stem.split("_")[0]
    return next((fold for fold in FOLDS if subject in fold), None)


def prior_folder(folder: Path, fold: Sequence[str]) -> Path:
    """The folder of the priors trained without these people: points.npz and directions.npz."""
    return folder / f"prior-without-{'-'.join(fold)}"


def is_trained(prior: Path) -> bool:
    """Whether the folder has both priors."""
    return all((prior / file).is_file() for file in (priors.POINTS_FILE, priors.DIRECTIONS_FILE))


def train(fold: Sequence[str], prior: Path) -> None:
    """Train both priors without these people, and write them to the folder."""
    prior.mkdir(parents=True, exist_ok=True)
    people = training.people(PEOPLE, fold)
    formats.replace_whole(prior / priors.POINTS_FILE, training.train_points(people))
    formats.replace_whole(prior / priors.DIRECTIONS_FILE, training.train_directions(people))


def trained(folder: Path, fold: Sequence[str]) -> Path:
    """The folder of the priors without these people; trains missing ones."""
    prior = prior_folder(folder, fold)
    if not is_trained(prior):
        train(fold, prior)
    return prior


@contextmanager
def unseen(prior: Path | None) -> Iterator[None]:
    """A context in which tempo uses the priors of this folder; None: those of the package."""
    if prior is None:
        yield
        return
    files = {"points": priors.POINTS_FILE, "directions": priors.DIRECTIONS_FILE}
    with priors.installed(**{kind: (prior / file).read_bytes() for kind, file in files.items()}):
        yield
