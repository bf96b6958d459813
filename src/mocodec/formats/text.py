"""Text of the field's files: bytes to text, and whole blocks of numbers at once."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..motion import Floats


def decoded(path: str | Path) -> str:
    """A text file, with or without a byte-order mark, its lines ended by "\n". Raises BadInput for what is not text."""
    data = Path(path).read_bytes().replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\0" in data[:4096]:
        raise BadInput(f"{path}: this is not a text file")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def numbers(text: str, path: str | Path) -> Floats:
    """All numbers of a text, separated by white space. Raises BadInput for a word that is not a finite number."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            values = np.fromstring(text, sep=" ")
        except (DeprecationWarning, ValueError):
            values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise BadInput(f"{path}: {_first_bad(text)!r} stands where a number should be")
    return values


def _first_bad(text: str) -> str:
    for word in text.split():
        try:
            if np.isfinite(float(word)):
                continue
        except ValueError:
            pass
        return word[:40]
    return text.strip()[:40]
