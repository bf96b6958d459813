"""docs/payloads/signals.md holds all that a decoder of signals needs."""

from __future__ import annotations

import zlib

import pytest

from mocodec.signals import codec
from mocodec.testing.signals import cases

from . import signals
from .integers import Bytes

SIGNALS = cases()


@pytest.mark.parametrize("name", SIGNALS)
def test_a_decoder_from_the_page_gives_the_same_bits(name: str) -> None:
    values = SIGNALS[name]
    encoded = codec.encode(values, 1000.0)
    assert encoded is not None
    head, chunks = encoded
    stored = b"".join(chunk + zlib.crc32(chunk).to_bytes(4, "little") for chunk in chunks)
    found = signals.signal(Bytes(codec.pack(head)), Bytes(stored), values.dtype, values.shape)
    assert found.tobytes() == values.tobytes()
