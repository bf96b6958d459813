"""The next way where one fails: an error inside a codec never costs the user the recording.

ways in turn ─encode─► Encoded ─decode and check─► the first that keeps the promise, with a note if it is not the first

A file of the next way may be many times larger. So the note names an internal error and asks to report it, and with
MOCODEC_STRICT=1 in the environment, as in the tests, an internal error ends the encoding.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .. import metrics
from ..encoded import Encoded
from ..errors import BadInput, CannotEncode, MocodecError
from ..motion import Motion

Way = tuple[str, Callable[[], Encoded[Motion]]]
"""How a motion is coded, in words, and the function that codes it."""


def first_kept(
    motion: Motion,
    promise: Mapping[str, Any],
    ways: Sequence[Way],
    decode: Callable[[Encoded[Motion]], Motion],
    refusal_is_final: bool = False,
) -> Encoded[Motion]:
    """The encoding of the first way that keeps the promise (settings named in TARGETS), checked by decoding.

    refusal_is_final: a CannotEncode of the first way ends the search, since the caller asked for that way. Raises
    BadInput of any way, and CannotEncode, the first of all ways, if none keeps the promise. KeyboardInterrupt
    and MemoryError pass through.
    """
    failures: list[tuple[str, Exception]] = []
    for name, way in ways:
        try:
            with np.errstate(all="ignore"):
                encoded = way()
                require_kept(motion, promise, encoded, decode)
        except (BadInput, MemoryError):
            raise
        except Exception as error:
            if (refusal_is_final and isinstance(error, CannotEncode)) or not may_rescue(error):
                raise
            failures.append((name, error))
            continue
        if not failures:
            return encoded
        return with_note(encoded, f"{in_words(*failures[0])}; the motion is coded {name}")
    errors = [error for _, error in failures]
    known = next((e for e in errors if isinstance(e, MocodecError)), None)
    if known is not None:
        raise known
    raise CannotEncode(in_words(*failures[0])) from errors[0]


def require_kept(
    motion: Motion,
    promise: Mapping[str, Any],
    encoded: Encoded[Motion],
    decode: Callable[[Encoded[Motion]], Motion],
) -> None:
    """Raises CannotEncode unless the decoded motion has the gaps of the motion and keeps the promise."""
    decoded = decode(encoded)
    found = None
    if decoded.positions.shape == motion.positions.shape:
        with np.errstate(all="ignore"):
            found = metrics.errors(motion.positions, decoded.positions)
    if found is None or not found.same_gaps:
        raise CannotEncode(f"{encoded.codec} does not keep the gaps of this motion")
    measured = {"max_error": found.max, "mean_error": found.mean, "size": encoded.payload_bytes}
    for name, value in measured.items():
        if promise.get(name) and not value <= promise[name]:
            raise CannotEncode(
                f"{encoded.codec} cannot keep {name}={promise[name]:g} on this motion: it gives {value:g}"
            )
    if promise.get("ratio") and encoded.payload_bytes > motion.raw_bytes / promise["ratio"]:
        raise CannotEncode(f"{encoded.codec} cannot keep ratio={promise['ratio']:g} on this motion")


def may_rescue(error: Exception) -> bool:
    """Whether the next way may be taken after an error: not after an internal one if MOCODEC_STRICT is set."""
    return isinstance(error, MocodecError) or os.environ.get("MOCODEC_STRICT", "0") in ("", "0")


def in_words(name: str, error: Exception) -> str:
    """A failure as a sentence without end."""
    if isinstance(error, MocodecError):
        return f"coding {name} failed ({str(error)[:200]})"
    what = f"{type(error).__name__}: {error}"
    return f"coding {name} failed (an internal error of mocodec, {what[:200]}, please report it)"


def with_note(encoded: Encoded[Motion], note: str) -> Encoded[Motion]:
    """The encoding, with a sentence for the user in the notes of its source."""
    source = dict(encoded.about.source)
    kept = source.get("notes", [])
    source["notes"] = [*(kept if isinstance(kept, list | tuple) else []), note]
    return replace(encoded, about=replace(encoded.about, source=source))
