"""Names of points on disk: a common prefix once, then runs of the vocabulary, numbered names, or deflated text.

names ──► prefix "Male:" · the rest ──► the shortest of   runs: (start in VOCABULARY, length) or a string, repeatedly
                                                         numbered: stem and first number: P1 P2 … P41
                                                         text: joined by newlines, deflate with NAME_DICTIONARY
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from ..errors import CannotEncode
from .tables import NAME_DICTIONARY, VOCABULARY
from .wire import Cursor, blob, deflate, inflate, text, varint

RUNS, NUMBERED, TEXT = 0, 1, 2
MAX_NAMES = 1 << 16
MAX_TEXT_BYTES = 1 << 22


def pack(names: Sequence[str]) -> bytes:
    """varint 8·count + 4·(has prefix) + form, the prefix, the form's fields. Raises CannotEncode above MAX_NAMES."""
    if len(names) > MAX_NAMES:
        raise CannotEncode(f"{len(names)} points; a file holds at most {MAX_NAMES}")
    candidates = []
    for prefix in {"", _common_prefix(names)}:
        rest = [name[len(prefix) :] for name in names]
        for form, body in ((RUNS, _pack_runs(rest)), (NUMBERED, _pack_numbered(rest)), (TEXT, _pack_text(rest))):
            if body is not None:
                head = varint(len(names) << 3 | bool(prefix) << 2 | form)
                candidates.append(head + (text(prefix) if prefix else b"") + body)
    return min(candidates, key=lambda data: (len(data), data))


def unpack(cursor: Cursor) -> tuple[str, ...]:
    """The inverse of `pack`. Raises Corrupt, Truncated."""
    head = cursor.varint()
    count, form = head >> 3, head & 3
    if count > MAX_NAMES:
        raise cursor.corrupt(f"{count} points; a file holds at most {MAX_NAMES}")
    prefix = cursor.text() if head & 4 else ""
    if form == RUNS:
        rest = _unpack_runs(cursor, count)
    elif form == NUMBERED:
        prefix, first = prefix + cursor.text(), cursor.varint()
        rest = [str(first + i) for i in range(count)]
    elif form == TEXT:
        rest = _unpack_text(cursor, count)
    else:
        raise cursor.corrupt("names have a reserved form")
    if len(prefix) * count > MAX_TEXT_BYTES:
        raise cursor.corrupt("names are too long")
    return tuple([prefix + name for name in rest] if prefix else rest)


def _common_prefix(names: Sequence[str]) -> str:
    """The prefix up to the last colon that all names share (a subject, a namespace), or ""."""
    prefixes = {name[: name.rfind(":") + 1] for name in names}
    return prefixes.pop() if len(prefixes) == 1 else ""


def _pack_runs(names: Sequence[str]) -> bytes:
    out, at = bytearray(), 0
    while at < len(names):
        start, length = _longest_run(names, at)
        if length:
            out += varint(start + 1) + varint(length)
            at += length
        else:
            out += b"\0" + text(names[at])
            at += 1
    return bytes(out)


def _longest_run(names: Sequence[str], at: int) -> tuple[int, int]:
    """(start in VOCABULARY, length) of the longest run that names[at:] begins with; length 0 if there is none."""
    best = (0, 0)
    for start in INDICES.get(names[at], ()):
        length = 1
        while (
            at + length < len(names)
            and start + length < len(VOCABULARY)
            and names[at + length] == VOCABULARY[start + length]
        ):
            length += 1
        if length > best[1]:
            best = (start, length)
    return best


def _unpack_runs(cursor: Cursor, count: int) -> list[str]:
    names: list[str] = []
    while len(names) < count:
        start = cursor.varint()
        if start == 0:
            names.append(cursor.text())
            continue
        length = cursor.varint()
        if length == 0 or start - 1 + length > len(VOCABULARY) or len(names) + length > count:
            raise cursor.corrupt("a run of names exceeds the vocabulary or the number of points")
        names.extend(VOCABULARY[start - 1 : start - 1 + length])
    return names


def _pack_numbered(names: Sequence[str]) -> bytes | None:
    match = re.fullmatch(r"(.*?)(0|[1-9][0-9]{0,8})", names[0], re.DOTALL | re.ASCII) if names else None
    if match is None:
        return None
    stem, first = match[1], int(match[2])
    if any(name != f"{stem}{first + i}" for i, name in enumerate(names)):
        return None
    return text(stem) + varint(first)


def _pack_text(names: Sequence[str]) -> bytes | None:
    joined = "\n".join(names).encode("utf-8", "surrogatepass")
    if not names or joined.count(b"\n") != len(names) - 1:
        return None
    if len(joined) > MAX_TEXT_BYTES:
        raise CannotEncode(f"the names are {len(joined)} bytes long; a file holds at most {MAX_TEXT_BYTES}")
    return varint(len(joined)) + blob(deflate(joined, NAME_DICTIONARY))


def _unpack_text(cursor: Cursor, count: int) -> list[str]:
    size = cursor.varint()
    if size > MAX_TEXT_BYTES:
        raise cursor.corrupt("names are too long")
    joined = inflate(cursor.blob(), size, f"{cursor.what}, names", NAME_DICTIONARY)
    try:
        names = joined.decode("utf-8", "surrogatepass").split("\n")
    except UnicodeDecodeError:
        raise cursor.corrupt("a name is not UTF-8") from None
    if len(names) != count:
        raise cursor.corrupt(f"{len(names)} names for {count} points")
    return names


INDICES: dict[str, list[int]] = {}
"""Every index of a name in VOCABULARY."""
for _index, _name in enumerate(VOCABULARY):
    INDICES.setdefault(_name, []).append(_index)
