"""Text files: bytes to text, and blocks of numbers parsed in one call."""

from __future__ import annotations

import codecs
import re
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..typing import Floats

GAP_WORD = re.compile(
    r"[-+]?(nan(\(\w*\))?|1\.?#\w+)|-+|n/?a|#n/a|null|none|missing",  # 1.#QNAN and -nan(ind) come from C libraries
    re.IGNORECASE,
)
"""What programs write in place of a number that is missing."""


COMMENT = re.compile(r"^[ \t]*(?:#|//).*$", re.MULTILINE)
DECIMAL_POINT, DECIMAL_COMMA = re.compile(r"\d\.\d"), re.compile(r"(?<=\d),(?=\d)")


def plain(text: str) -> str:
    """The text without lines of comments (# or //), and with decimal points if all its decimals have commas."""
    if "#" in text or "//" in text:
        text = COMMENT.sub("", text)
    if "," in text and not DECIMAL_POINT.search(text):
        text = DECIMAL_COMMA.sub(".", text)
    return text


def is_gap(cell: str) -> bool:
    """Whether a cell of a table stands for a missing number."""
    if cell[-1:].isdecimal() and "#" not in cell:
        return False
    return not cell or cell.isspace() or GAP_WORD.fullmatch(cell.strip()) is not None


def read_text(path: str | Path) -> str:
    """The text of a file, without byte-order mark, lines ended by "\n". Raises BadInput for binary files.

    UTF-16 needs a byte-order mark. Text that is not UTF-8 is taken as `legacy_text`.
    """
    data = re.sub(rb"\x1a\s*\Z", b"", Path(path).read_bytes())
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        with suppress(UnicodeDecodeError):
            data = data.decode("utf-16").encode("utf-8")
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\0" in data[:4096]:
        raise BadInput(f"{path}: not a text file")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return legacy_text(data)


def legacy_text(raw: bytes) -> str:
    """Text of before Unicode: Shift-JIS where that is valid and Latin-1 has no letters, else Windows-1252 or Latin-1.

    Latin-1 has no letters at bytes 0x80 to 0x9F, where the first bytes of Japanese characters are.
    """
    if re.search(rb"[\x80-\x9f]", raw):
        for encoding in ("cp932", "cp1252"):
            with suppress(UnicodeDecodeError):
                return raw.decode(encoding)
    return raw.decode("latin-1")


def numbers(text: str, path: str | Path) -> Floats:
    """All numbers of a text, separated by white space. Raises BadInput for words that are not finite numbers."""
    if not text or text.isspace():
        return np.empty(0)
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
