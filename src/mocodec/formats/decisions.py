"""What a reader decided for the user: guesses, and how contradictions in a file were settled.

Contradictions are sentences in `source["notes"]`, which a .mocz stores. Guesses are common, so they are not stored as
text: `notes` makes their line again from the source, from a file and from a .mocz alike.
"""

from __future__ import annotations

from typing import Any

from ..motion import Motion
from ..pointcloud import PointClouds

ASSUMED_AMC_RATE = 120.0


def notes(recording: Motion | PointClouds) -> list[str]:
    """Sentences for the user: one with all guesses and their options, then the notes of the reader."""
    guessed = guesses(recording)
    kept: Any = recording.source.get("notes", [])
    sentences = [str(note) for note in kept] if isinstance(kept, list | tuple) else []
    return ([f"guessed: {', '.join(guessed)}"] if guessed else []) + sentences


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
