"""A record: named fields in their order on disk, described once for writing, reading and printing.

fields ─Record.pack(values)─► bytes ─Record.unpack(bytes, what the reader knows)─► values
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import Corrupt
from .cursor import Cursor, varint

Values = dict[str, Any]
Known = Mapping[str, Any]


@dataclass(frozen=True)
class Field:
    """One field of a record. `fields.kinds` has functions that make the usual ones.

    write(value, values) gives the bytes; read(cursor, known) the value. `known` has what the caller of `unpack` passed
    and the fields before this one. meaning: one line for people. when(known): whether the field is present; always by
    default. hidden: it follows from other fields (a count, a length), so it is neither given to `pack` nor returned by
    `unpack`. length_of: it is the length in bytes of that field; length: the field that holds this one's length.
    """

    name: str
    write: Callable[[Any, Known], bytes]
    read: Callable[[Cursor, Known], Any]
    meaning: str = ""
    when: Callable[[Known], bool] | None = None
    hidden: bool = False
    length_of: str | None = None
    length: str | None = None

    def present(self, known: Known) -> bool:
        return self.when is None or self.when(known)


class Record:
    """Fields in their order on disk. what: the record's name in error messages."""

    def __init__(self, what: str, *fields: Field) -> None:
        self.what = what
        self.fields = fields

    def pack(self, values: Known) -> bytes:
        """The bytes. values: every present field that is not hidden, and all that conditions and limits look at."""
        return b"".join(data for _, data in self.parts(values))

    def parts(self, values: Known) -> list[tuple[str, bytes]]:
        """Name and bytes of each present field, in order."""
        present = [f for f in self.fields if f.present(values)]
        written = {
            f.name: f.write(None if f.hidden else values[f.name], values) for f in present if f.length_of is None
        }
        return [
            (f.name, written[f.name] if f.length_of is None else varint(len(written[f.length_of]))) for f in present
        ]

    def unpack(self, data: bytes, **known: Any) -> Values:
        """The values of `pack`, None for a field that is absent. Raises Corrupt, also for bytes that are left over.

        known: values for shapes and limits that the reader has from elsewhere, by name (points=41).
        """
        cursor = Cursor(data, self.what, ends_early=Corrupt)
        values = self.read(cursor, known)
        cursor.field = ""
        cursor.done()
        return values

    def read(self, cursor: Cursor, known: Known | None = None) -> Values:
        """The values, from a cursor that may have more bytes behind the record. Raises Corrupt, or what the cursor
        raises where its bytes end early."""
        given: Known = known or {}
        values: Values = {}
        seen: Values = dict(given)
        for f in self.fields:
            value = None
            if f.present(seen):
                cursor.field = f.name
                value = _read_field(f, cursor, seen)
            seen[f.name] = value
            if not f.hidden:
                values[f.name] = value
        cursor.field = ""
        return values

    def describe(self, values: Known) -> list[Values]:
        """For each present field its name, size in bytes and meaning."""
        meanings = {f.name: f.meaning for f in self.fields}
        return [{"field": name, "bytes": len(data), "meaning": meanings[name]} for name, data in self.parts(values)]


def _read_field(field: Field, cursor: Cursor, known: Known) -> Any:
    if field.length is None:
        return field.read(cursor, known)
    inside = cursor.part(known[field.length])
    value = field.read(inside, known)
    inside.done()
    return value
