"""docs/payloads/signals.md holds all that a decoder of signals needs."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest

import mocodec
from mocodec.channels import signals as all_signals
from mocodec.container.stored_signals import StoredSignal
from mocodec.signals import codec
from mocodec.testing.signals import cases

from . import signals
from .integers import Bytes

SIGNALS = cases()
GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.mark.parametrize("name", SIGNALS)
def test_a_decoder_from_the_page_gives_the_same_bits(name: str) -> None:
    values = SIGNALS[name]
    encoded = codec.encode(values, 1000.0)
    assert encoded is not None
    head, chunks = encoded
    stored = b"".join(chunk + zlib.crc32(chunk).to_bytes(4, "little") for chunk in chunks)
    found = signals.signal(Bytes(codec.pack(head)), Bytes(stored), values.dtype, values.shape)
    assert found.tobytes() == values.tobytes()


@pytest.mark.parametrize("name", ["signals-exact", "signals-12bit"])
def test_the_golden_files_hold_what_the_page_says(name: str) -> None:
    path = GOLDEN / f"{name}.mocz"
    twin = json.loads(path.with_suffix(".json").read_text())["signals"]
    kinds: set[int] = set()
    with mocodec.open(path) as f:
        for label, signal in all_signals(f[:].extras):
            assert isinstance(signal, StoredSignal)
            head = signal.stored.head
            chunks = [signal.stored.payload(number) for number in range(len(head.chunk_bytes))]
            stored = b"".join(chunk + zlib.crc32(chunk).to_bytes(4, "little") for chunk in chunks)
            found = signals.signal(Bytes(codec.pack(head)), Bytes(stored), head.dtype, head.shape)
            assert found.tobytes() == np.array(twin[label]["values"], twin[label]["dtype"]).tobytes()
            kinds |= {form.kind for form in head.forms}
    if name == "signals-exact":
        assert kinds == set(range(6))
