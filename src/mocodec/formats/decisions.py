"""What a reader decided for the user: guesses, and how contradictions in a file were settled.

Contradictions are sentences in `source["notes"]`, which a .mocz stores. Guesses and what a reader leaves out or keeps
apart are common, so they are not stored as text: `notes` makes their lines again from the source, from a file and from
a .mocz alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from ..encoded import RecordingT
from ..motion import Motion
from ..pointcloud import PointClouds

ASSUMED_AMC_RATE = 120.0


def notes(recording: Motion | PointClouds) -> list[str]:
    """Sentences for the user: one with all guesses and their options, the parts left out, the notes of the reader."""
    guessed = guesses(recording)
    kept: Any = recording.source.get("notes", [])
    sentences = [str(note) for note in kept] if isinstance(kept, list | tuple) else []
    return ([f"guessed: {', '.join(guessed)}"] if guessed else []) + [*kept_apart(recording)] + sentences


def kept_apart(recording: Motion | PointClouds) -> Iterator[str]:
    """What of the file the reader left out, or kept beside the positions, by the facts in the source."""
    source = recording.source
    outputs: Any = source.get("model_outputs")
    if isinstance(outputs, Mapping) and outputs:
        kinds = ", ".join(f"{count} {kind}" for kind, count in outputs.items())
        yield f"its points include model outputs, which are not positions and are stored exactly beside them: {kinds}"
    if missing := source.get("missing_numbers"):
        yield f"{missing} numbers are missing in the sequence of file names; the files are read as consecutive frames"
    ignored: Any = source.get("ignored")
    if isinstance(ignored, list | tuple) and ignored:
        yield f"these properties of points are left out: {', '.join(map(str, ignored))}"
    if source.get("residuals") == "left out":
        yield "residuals and camera masks of samples are left out; --residuals keeps them"


def without_extras(recording: RecordingT) -> RecordingT:
    """The recording without extras. Its source says so, so that a file promises nothing about them (`left_out`)."""
    source = {name: value for name, value in recording.source.items() if name != "model_outputs"}
    source |= {"residuals": "left out"} if "residuals" in recording.extras else {}
    return replace(recording, source=source | {"extras": "left out"}, extras={})


def left_out(original: Motion, kept: Motion) -> list[str]:
    """The names of extras of the original that `kept` lacks and says to lack, sorted."""
    missing = set(original.extras) - set(kept.extras)
    if kept.source.get("extras") != "left out":
        missing &= {"residuals"} if kept.source.get("residuals") == "left out" else set()
    return sorted(missing)


def guesses(recording: Motion | PointClouds) -> list[str]:
    """Each property that the file does not store and the reader guessed, with the option that overrides it.

    A BVH has neither unit nor vertical axis and an AMC usually no rate, so there the source records what was given.
    """
    source = recording.source
    format_ = source.get("format")
    found: list[str] = []
    if source.get("up_guessed") or (format_ == "bvh" and not source.get("up_given")):
        found.append(f"up {recording.up} (--up)")
    if source.get("unit_guessed") or (format_ == "bvh" and not source.get("unit_given")):
        found.append(f"unit {source.get('units')} (--unit)")
    if source.get("rate_guessed"):
        found.append(f"rate {recording.rate:g} Hz (--rate)")
    if format_ == "amc" and recording.rate == ASSUMED_AMC_RATE and not source.get("rate_given"):
        found.append(f"rate {recording.rate:g} Hz (--rate)")
    return found
