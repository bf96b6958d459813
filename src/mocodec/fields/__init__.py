"""Stored records, described once as a list of fields: writing, reading and checking follow from it.

    BODY = Record(
        "a stored body",                                  # for error messages: "a stored body, scale, byte 2: …"
        signed("digits", most=60),
        unsigned("scale", least=1, most=4096),
        count("bones", of="lengths", most=256),           # hidden: written from `lengths`, known to later fields
        flag("has_pose"),
        *sized(                                           # the lengths of both in bytes, then both
            array("lengths", ("bones",), least=0),        # coded integers; a side may be a known name
            array("pose", ("points", 3), most=1 << 40, when=lambda known: known["has_pose"]),
        ),
        raw("basis"),                                     # all that is left
    )
    data = BODY.pack({"digits": 10, "scale": 64, "lengths": lengths, "has_pose": False, "basis": b"…"})
    values = BODY.unpack(data, points=41)                 # a dict; absent fields are None. Raises Corrupt

The container describes its parts in the same way. `BODY.read(cursor, known)` reads a record that others follow.
"""

from .cursor import Cursor
from .kinds import array, count, fixed, flag, nested, numbers, positive_float, raw, signed, sized, text, unsigned
from .record import Field, Record, Values

__all__ = [
    "Cursor", "Field", "Record", "Values", "array", "count", "fixed", "flag", "nested", "numbers", "positive_float",
    "raw", "signed", "sized", "text", "unsigned",
]  # fmt: skip
