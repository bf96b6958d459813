"""Text files: bytes to text, and blocks of numbers parsed in one call."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..typing import Floats


def read_text(path: str | Path) -> str:
    """The text of a file, without byte-order mark, lines ended by "\n". Raises BadInput for binary files."""
    data = Path(path).read_bytes().replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\0" in data[:4096]:
        raise BadInput(f"{path}: not a text file")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def numbers(text: str, path: str | Path) -> Floats:
    """All numbers of a text, separated by white space. Raises BadInput for words that are not finite numbers."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            values = np.fromstring(text, sep=" ")
        except (DeprecationWarning, ValueError):
            values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise BadInput(f"{path}: {_first_invalid(text)!r} is not a number")
    return values


def _first_invalid(text: str) -> str:
    """The first word that is not a finite number."""
    for word in text.split():
        try:
            if np.isfinite(float(word)):
                continue
        except ValueError:
            pass
        return word[:40]
    return text.strip()[:40]
