"""Options of `convert` and `decode` that change the motion on its way out: rate, unit, vertical axis, points.

They are named `--to-…`, since `--unit` and `--up` say how the input is read; `--rate` is another name of `--to-rate`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import click

from ..encoded import Recording
from ..errors import BadInput
from ..motion import UP_AXES, Motion
from . import quantities

CHANGES = ("points", "to_rate", "to_up")
WRITERS = {"to_unit": "unit", "keys": "keys"}
"""Options that are those of a format's writer, and their names there."""

OPTIONS = (
    click.option(
        "--to-rate",
        "--rate",
        type=click.FloatRange(0, min_open=True),
        metavar="HZ",
        help="Resample to so many frames per second: rotations by slerp, positions by splines; gaps stay gaps.",
    ),
    click.option(
        "--to-unit", metavar="UNIT", help="Unit of lengths in the output, where its format has one: mm, cm, in."
    ),
    click.option("--to-up", type=click.Choice(UP_AXES), help="Turn the motion so that this axis is vertical."),
    click.option(
        "--points",
        "--joints",
        multiple=True,
        metavar="NAMES",
        help="Only these points or joints, separated by commas; leaving out leaves or limbs keeps the skeleton.",
    ),
    click.option(
        "--keys", type=quantities.LENGTH, metavar="LENGTH", help="Of a .glb: few key frames, within this distance: 1mm."
    ),
)


def options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options to a command."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


def split(given: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The changes of the motion, and the options for the writer, of a command's options that the user gave."""
    changes = {name: given[name] for name in CHANGES if given.get(name)}
    return changes, {writer: given[name] for name, writer in WRITERS.items() if given.get(name) is not None}


def changed(
    recording: Recording, points: Sequence[str] = (), to_rate: float | None = None, to_up: str | None = None
) -> Recording:
    """The recording with the changes. Raises BadInput for point clouds and for names that it does not have."""
    if not (points or to_rate or to_up):
        return recording
    if not isinstance(recording, Motion):
        raise BadInput("--to-rate, --to-up and --points are for motions, and this file holds point clouds")
    if points:
        recording = recording.select(names_in(points, recording.names))
    if to_rate is not None:
        recording = recording.resample(to_rate)
    return recording if to_up is None else recording.turned(to_up)


def names_in(texts: Sequence[str], known: Sequence[str]) -> list[str]:
    """The names in texts, separated by commas; a text that is a name itself may contain some."""
    names: list[str] = []
    for text in texts:
        names += [text] if text in known else [name for part in text.split(",") if (name := part.strip())]
    return list(dict.fromkeys(names))
