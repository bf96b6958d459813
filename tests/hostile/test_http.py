"""Web servers that send too much, or too slowly, are given up."""

from __future__ import annotations

import io
from email.message import Message
from typing import Any
from urllib import request
from urllib.error import HTTPError

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


class Part:
    """The answer of a server with range requests: the file `data`, of the version `tag`."""

    status = 206

    def __init__(self, asked: str, data: bytes, tag: str) -> None:
        first, last = map(int, asked.removeprefix("bytes=").split("-"))
        last = min(last, len(data) - 1)
        self.headers = {"Content-Range": f"bytes {first}-{last}/{len(data)}", "ETag": tag}
        self.body = io.BytesIO(data[first : last + 1])
        self.read1 = self.body.read1

    def __enter__(self) -> Part:
        return self

    def __exit__(self, *_: object) -> None: ...


def test_a_file_that_is_replaced_by_one_of_its_size_is_not_mixed_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    tags = ["old"]

    def urlopen(question: request.Request, **_: Any) -> Part:
        asked = question.get_header("Range") or ""
        if "," in asked:
            raise HTTPError(question.full_url, 501, "one range only", Message(), None)
        return Part(asked, bytes(1_000_000), tags[-1])

    monkeypatch.setattr(request, "urlopen", urlopen)
    file = remote_sources.Url("http://example.invalid/x.mocz")
    assert file.read(300_000, 10) == bytes(10)
    tags.append("new")
    assert file.read(300_000, 10) == bytes(10), "what was fetched stays"
    with pytest.raises(BadInput, match="changed while it was being read"):
        file.read(600_000, 10)
