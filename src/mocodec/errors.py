"""Every error that mocodec raises on purpose, sorted by what the reader can do next.

    MocodecError
    ├── BadInput         the file or the arguments are not usable: mend the input
    ├── CannotEncode     the motion is fine, but this codec cannot do what was asked: ask for less, or another codec
    ├── UnknownCodec     the file names a codec that this package does not have
    ├── TooNew           the file was written by a later format version: upgrade mocodec
    ├── Truncated        the file ends too early: fetch it again; what is left can be salvaged
    └── Corrupt          bytes are damaged (a checksum or a bound does not hold): restore from a copy
    MissingExtra (BadInput)   an optional dependency is not installed; the message names the extra

A message says what is wrong, where, and what to do.
"""

from __future__ import annotations


class MocodecError(Exception):
    """Above every error that mocodec raises on purpose."""


class BadInput(MocodecError, ValueError):
    """The file or the arguments are not usable."""


class MissingExtra(BadInput):
    """An optional dependency is not installed."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs the [{extra}] extra: pip install 'mocodec[{extra}]'")


class CannotEncode(MocodecError):
    """The motion cannot be coded as asked; nothing was written."""


class UnknownCodec(MocodecError):
    """No codec of that name in this package."""


class TooNew(MocodecError):
    """Written by a later version of the format than this package reads."""


class Truncated(MocodecError):
    """The data ends before it should."""


class Corrupt(MocodecError):
    """Damaged data: a checksum, a length or a bound does not hold."""
