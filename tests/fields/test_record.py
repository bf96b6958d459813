"""Records: what is packed comes back, absent fields too, and any other bytes are Corrupt with the field's name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from mocodec import native
from mocodec.entropy import coder, varint
from mocodec.errors import Corrupt, Truncated
from mocodec.fields import (
    Cursor,
    Record,
    array,
    count,
    fixed,
    flag,
    nested,
    numbers,
    positive_float,
    raw,
    signed,
    sized,
    text,
    unsigned,
)
from mocodec.testing import corruption

BODY = Record(
    "a stored body",
    signed("digits", most=60),
    unsigned("scale", least=1, most=4096),
    count("bones", of="lengths", most=256),
    flag("has_pose"),
    *sized(
        array("lengths", ("bones",), least=0),
        array("pose", ("points", 3), most=1 << 40, when=lambda known: known["has_pose"]),
    ),
    raw("basis"),
)


def body(has_pose: bool = True) -> dict[str, object]:
    values: dict[str, object] = {
        "digits": -10,
        "scale": 64,
        "lengths": np.arange(7),
        "has_pose": has_pose,
        "basis": b"the rest",
    }
    return {**values, "pose": np.arange(15).reshape(5, 3) - 4} if has_pose else values


@pytest.mark.parametrize("has_pose", [False, True])
def test_values_come_back(has_pose: bool):
    values = BODY.unpack(BODY.pack(body(has_pose)), points=5)
    for name, value in body(has_pose).items():
        assert np.array_equal(values[name], value), name  # pyright: ignore
    assert "bones" not in values
    assert (values["pose"] is None) is not has_pose


def test_the_bytes_are_what_the_fields_say():
    lengths, pose = coder.pack(np.arange(7)[:, None]), coder.pack(np.arange(15).reshape(5, 3) - 4)
    head = varint.write([varint.signed(-10), 64, 7, 1, len(lengths), len(pose)])
    assert BODY.pack(body()) == head + lengths + pose + b"the rest"


def test_a_length_in_front_of_each_field_or_all_lengths_first():
    apart = Record("x", *sized(raw("a")), *sized(raw("b")), raw("c"))
    together = Record("x", *sized(raw("a"), raw("b")), raw("c"))
    values = {"a": b"12", "b": b"345", "c": b"6"}
    assert apart.pack(values) == b"\x0212\x033456"
    assert together.pack(values) == b"\x02\x03123456"
    assert apart.unpack(apart.pack(values)) == together.unpack(together.pack(values)) == values


def test_other_kinds_of_fields():
    inner = Record("inner", unsigned("n"), fixed("samples", ("n", "width"), "<u2"))
    record = Record("outer", text("name"), positive_float("length_m"), numbers("ends", 3), nested("inner", inner))
    values = {
        "name": "Ä",
        "length_m": 0.25,
        "ends": [1, 200, 2**62],
        "inner": {"n": 2, "samples": np.arange(6).reshape(2, 3)},
    }
    back = record.unpack(record.pack(values), width=3)
    assert np.array_equal(back["inner"].pop("samples"), np.arange(6).reshape(2, 3))
    assert back == {**values, "inner": {"n": 2}}


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("digits", {"digits": 61}),
        ("scale", {"scale": 0}),
        ("scale", {"scale": 4097}),
        ("bones", {"lengths": np.arange(257)}),
        ("lengths", {"lengths": np.array([-1, 3])}),
        ("pose", {"pose": np.full((5, 3), 1 << 41)}),
    ],
)
def test_a_value_beyond_its_limits_is_corrupt_and_named(field: str, values: dict[str, object]):
    data = BODY.pack({**body(), **values})
    with pytest.raises(Corrupt, match=f"a stored body, {field}"):
        BODY.unpack(data, points=5)


def test_other_damage_is_named_too():
    with pytest.raises(Corrupt, match=r"has_pose.* 2 is more than 1"):
        BODY.unpack(bytes([0, 1, 0, 2, 0]), points=5)
    with pytest.raises(Corrupt, match="scale ends at byte 1, 1 bytes too early"):
        BODY.unpack(b"\0", points=5)
    with pytest.raises(Corrupt, match="length_m"):
        Record("r", positive_float("length_m")).unpack(np.array([np.nan]).tobytes())
    with pytest.raises(Corrupt, match="2 bytes are left over"):
        Record("r", unsigned("n")).unpack(b"\1\2\3")
    with pytest.raises(Corrupt, match="r, pose, byte 3"):
        Record("r", *sized(array("pose", (2, 3)))).unpack(b"\2\1\1")
    with pytest.raises(Corrupt, match="badly written"):
        Record("r", unsigned("n")).unpack(b"\x80\x00")


def test_a_file_that_ends_early_is_truncated_rather_than_corrupt():
    with pytest.raises(Truncated):
        BODY.read(Cursor(b"\0", "the header"))


def test_what_follows_a_record_is_left_to_others():
    record = Record("r", unsigned("n"))
    cursor = Cursor(b"\1\2\3", "data")
    assert [record.read(cursor)["n"] for _ in range(3)] == [1, 2, 3]


def test_description_for_people():
    record = Record("r", unsigned("n", meaning="how many"), raw("rest"))
    assert record.describe({"n": 300, "rest": b"abc"}) == [
        {"field": "n", "bytes": 2, "meaning": "how many"},
        {"field": "rest", "bytes": 3, "meaning": ""},
    ]


def test_damaged_records_are_corrupt_or_within_their_limits():
    data = BODY.pack(body())
    for bad in [*(data[:size] for size in range(len(data))), *corruption.damaged(data, 200, seed=0)]:
        try:
            values = BODY.unpack(bad, points=5)
        except Corrupt:
            continue
        assert 1 <= values["scale"] <= 4096
        assert values["pose"] is None or values["pose"].shape == (5, 3)


@hypothesis_settings(deadline=None, derandomize=True, max_examples=100)
@given(st.binary(max_size=60))
def test_any_bytes_are_a_record_or_corrupt(data: bytes):
    try:
        values = BODY.unpack(data, points=2)
    except Corrupt:
        return
    assert len(values["lengths"]) <= 256


@given(st.lists(st.integers(0, 1 << 40), max_size=40), st.binary(max_size=6), st.integers(0, 50))
def test_many_varints_are_read_as_one_by_one(values: list[int], tail: bytes, most: int):
    data = varint.write(values) + tail
    found, ends = Cursor(data, "a list").plain(most)
    with native.without():
        again, ends_again = Cursor(data, "a list").plain(most)
    np.testing.assert_array_equal(found, again)
    np.testing.assert_array_equal(ends, ends_again)
    assert found.dtype == again.dtype == ends.dtype == ends_again.dtype == np.int64
    cursor = Cursor(data, "a list")
    assert cursor.varint_array(len(values)).tolist() == values
    assert cursor.at == len(data) - len(tail)
