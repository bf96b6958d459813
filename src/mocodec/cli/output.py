"""Options of `convert` and `decode` that change the motion on its way out: rate, unit, vertical axis, points.

They are named `--to-…`, since `--unit` and `--up` say how the input is read; `--rate` is another name of `--to-rate`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import click

from ..encoded import Recording
from ..errors import BadInput
from ..motion import UP_AXES, Motion, Signal
from ..selection import counted
from . import quantities, sections

CHANGES = ("points", "to_rate", "to_up")
WRITERS = {"to_unit": "unit", "keys": "keys"}
"""Options that are those of a format's writer, and their names there."""


def _option(*names: str, **attributes: Any) -> Callable[..., Any]:
    return sections.option(*names, section=sections.WRITING, **attributes)


OPTIONS = (
    _option(
        "--to-rate",
        "--rate",
        type=quantities.HERTZ,
        metavar="HZ",
        help="Resample to this rate, in frames per second: rotations by slerp, positions by splines; gaps stay gaps.",
    ),
    _option("--to-unit", metavar="UNIT", help="Unit of lengths in the output, where its format has one: mm, cm, in."),
    _option("--to-up", type=click.Choice(UP_AXES), help="Turn the motion so that this axis is vertical."),
    _option(
        "--points",
        "--joints",
        multiple=True,
        metavar="NAMES",
        help="Only these points or joints, separated by commas. The skeleton is kept if no joint between two of them "
        "is left out.",
    ),
    _option(
        "--keys",
        type=quantities.LENGTH,
        metavar="LENGTH",
        help="Of a .glb: few key frames in place of every frame, every joint within this distance: 1mm.",
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


def prepared(recording: Recording, suffix: str, changes: dict[str, Any]) -> tuple[Recording, list[str]]:
    """The recording with the changes, for a file with this suffix, and notes on the parts left out. Raises BadInput."""
    return _in_whole_frames(_changed(recording, **changes), suffix, changes)


def _changed(
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


def _in_whole_frames(recording: Recording, suffix: str, changes: dict[str, Any]) -> tuple[Recording, list[str]]:
    """A resampled motion for a C3D, which has a whole number of analog samples a frame; and what that leaves out.

    Raises BadInput if the rate of the analog channels is no multiple of the frame rate.
    """
    analog = recording.extras.get("analog") if isinstance(recording, Motion) and changes.get("to_rate") else None
    if suffix != ".c3d" or not isinstance(recording, Motion) or not isinstance(analog, Signal):
        return recording, []
    per_frame = round(analog.rate / recording.rate)
    if per_frame < 1 or not math.isclose(per_frame * recording.rate, analog.rate, rel_tol=1e-6):
        raise BadInput(
            f"a C3D has a whole number of analog samples a frame, and {analog.rate:g} Hz is no multiple of "
            f"{recording.rate:g} Hz: choose another rate, or a format without analog channels"
        )
    frames = min(len(recording), len(analog.values) // per_frame)
    samples = len(analog.values) - frames * per_frame
    left_out = [f"the last {counted(len(recording) - frames, 'frame')}"] if frames < len(recording) else []
    left_out += [f"{counted(samples, 'analog sample')} after the last frame"] if samples else []
    kept = replace(analog, values=analog.values[: frames * per_frame])
    recording = replace(recording[:frames], extras={**recording[:frames].extras, "analog": kept})
    return recording, [f"left out, for a whole number of analog samples a frame: {', '.join(left_out)}"] * bool(
        left_out
    )


def names_in(texts: Sequence[str], known: Sequence[str]) -> list[str]:
    """The names in texts, separated by commas; a text that is a name itself may contain some."""
    names: list[str] = []
    for text in texts:
        names += [text] if text in known else [name for part in text.split(",") if (name := part.strip())]
    return list(dict.fromkeys(names))
