"""Web servers that send too much, or too slowly, are given up."""

from __future__ import annotations

from typing import Any
from urllib import request

import pytest

from mocodec import container
from mocodec.container import remote_sources
from mocodec.errors import BadInput, Truncated


class Answer:
    """An answer without range support that sends `part` for ever."""

    status = 200

    def __init__(self, part: bytes) -> None:
        self.part = part
        self.headers: dict[str, str] = {}

    def read1(self, count: int) -> bytes:
        return self.part[:count]

    def __enter__(self) -> Answer:
        return self

    def __exit__(self, *_: object) -> None: ...


def answer_with(monkeypatch: pytest.MonkeyPatch, part: bytes) -> None:
    def urlopen(*_: Any, **__: Any) -> Answer:
        return Answer(part)

    monkeypatch.setattr(request, "urlopen", urlopen)


def test_an_endless_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, b"mocz" * 1000)
    monkeypatch.setattr(remote_sources, "MAX_DOWNLOAD_BYTES", 100_000)
    with pytest.raises(BadInput, match="without range requests"):
        container.Reader("http://example.invalid/x.mocz")


def test_a_slow_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, b"m")
    monkeypatch.setattr(remote_sources, "DEADLINE_S", -1.0)
    with pytest.raises(BadInput, match="no complete answer"):
        container.Reader("http://example.invalid/x.mocz")


def test_an_address_is_printed_without_control_characters(monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, b"")
    with pytest.raises(Truncated, match="empty") as caught:
        container.Reader("http://example.invalid/\x07x.mocz")
    assert str(caught.value).isprintable()
