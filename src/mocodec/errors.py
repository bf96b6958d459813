# pyright: strict
"""Every error that mocodec raises on purpose, sorted by what the user can do next.

    MocodecError
    ├── BadInput             the file or the arguments are not usable: correct the input
    │   ├── FrameOutOfRange  there is no frame of this number; an IndexError too
    │   └── MissingExtra     an optional dependency is not installed; the message names the extra to install
    ├── CannotEncode         the data is fine, but this codec cannot meet the settings: relax them or change the codec
    ├── UnknownCodec         the file names a codec that this version of mocodec does not have
    ├── TooNew               the file has a later format version: upgrade mocodec
    ├── Truncated            the file ends too early: fetch it again; the remaining frames can be salvaged
    └── Corrupt              bytes are damaged (a checksum or a bound does not hold): restore the file from a copy

A message says what is wrong, where, and what to do.
"""

from __future__ import annotations


def _printable(character: str) -> str:
    """The character; a space for line ends and tabs, and U+FFFD for what is not printable."""
    return character if character.isprintable() else " " if character.isspace() else "\N{REPLACEMENT CHARACTER}"


class MocodecError(Exception):
    """Base class of every error that mocodec raises on purpose. Its text has no control characters.

    A message may quote names that come from a file, which could otherwise move the cursor of a terminal.
    """

    def __str__(self) -> str:
        text = super().__str__()
        return text if text.isprintable() else "".join(map(_printable, text))


class BadInput(MocodecError, ValueError):
    """The file or the arguments are not usable."""


class FrameOutOfRange(BadInput, IndexError):
    """There is no frame of this number."""


class MissingExtra(BadInput):
    """An optional dependency is not installed."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(
            f"{what} needs the [{extra}] extra: pip install 'mocodec[{extra}]', or '.[{extra}]' in a checkout"
        )


class CannotEncode(MocodecError):
    """The data cannot be coded with these settings; nothing was written."""


class UnknownCodec(MocodecError):
    """This version of mocodec has no codec of that name."""


class TooNew(MocodecError):
    """The file has a later format version than this version of mocodec reads."""


class Truncated(MocodecError):
    """The data ends before it should."""


class Corrupt(MocodecError):
    """Damaged data: a checksum, a length or a bound does not hold."""
