"""The shared bytes: one model, and flags for what is orthogonal to it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mocodec.codecs.tempo.header import DIRECT, FALLBACK, REPEATS, StreamHeader
from mocodec.codecs.tempo.models import MODELS
from mocodec.errors import Corrupt


@pytest.mark.parametrize("weights", [b"", b"\x00\x10\x20"])
@pytest.mark.parametrize("millihertz", [None, 59_940])
@pytest.mark.parametrize("model", [None, *MODELS])
def test_a_header_is_what_was_packed(model: str | None, millihertz: int | None, weights: bytes) -> None:
    header = StreamHeader(model, b"prior and model" if model else b"", weights, None, millihertz)
    assert StreamHeader.unpack((header.pack(),), 3) == header


def test_a_fallback_carries_the_other_codecs_bytes() -> None:
    header = StreamHeader(fallback=b"hou2014", millihertz=30_000)
    assert StreamHeader.unpack((header.pack(),), 3) == header
    assert StreamHeader.unpack((replace(header, millihertz=None).pack(),), 3).millihertz is None


@pytest.mark.parametrize(
    "shared", [(), (b"",), (b"", b""), (bytes([DIRECT | 1]),), (bytes([DIRECT | FALLBACK]),), (b"\x40",), (b"\xff",),
               (bytes([DIRECT]) + b"more",), (bytes([REPEATS]) + b"\x00",), (bytes([8]) + b"\x01",)],
)  # fmt: skip
def test_other_bytes_are_corrupt(shared: tuple[bytes, ...]) -> None:
    with pytest.raises(Corrupt):
        StreamHeader.unpack(shared, 3)
