"""Whole numbers for headers."""

from __future__ import annotations

import pytest

from mocodec.entropy import varint
from mocodec.errors import Corrupt


def test_numbers_come_back():
    numbers = [0, 1, 127, 128, 300, 2**31, 2**63 - 1]
    data = varint.write(numbers)
    assert varint.read(b"x" + data + b"y", len(numbers), 1) == (numbers, len(data) + 1)
    assert len(varint.write([127])) == 1


def test_either_sign():
    for number in (0, -1, 1, -2, 2, -(2**40), 2**40):
        assert varint.unsigned(varint.signed(number)) == number
    assert [varint.signed(n) for n in (0, -1, 1, -2)] == [0, 1, 2, 3]


@pytest.mark.parametrize("data", [b"", b"\x80", b"\xff" * 12, b"\xff" * 9 + b"\x7f" + b"\xff"])
def test_bytes_that_are_no_number_are_corrupt(data: bytes):
    with pytest.raises(Corrupt):
        varint.read(data, 2)
