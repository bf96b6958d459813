"""A few seconds of each kind of fuzzing, and the tools themselves. `scripts/fuzz` runs longer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import native
from mocodec.errors import MocodecError

from . import calls, campaign, motions, mutations, resigned, seeds, worker


@pytest.fixture(params=[False, True], ids=["compiled", "pure"])
def mode(request: pytest.FixtureRequest) -> Any:
    return native.without if request.param else nullcontext


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("make", "count"),
    [
        (lambda: campaign.read_calls(7), 150),
        (lambda: campaign.decode_calls(7), 50),
        (lambda: campaign.code_calls(7), 16),
    ],
    ids=["read", "decode", "code"],
)
def test_some_calls(make: Any, count: int, mode: Any) -> None:
    """Fewer without the compiled module, which takes several times as long."""
    with mode():
        for kind, name, data, beside in islice(make(), count if mode is nullcontext else count // 2):
            try:
                calls.CALLS[kind](name, data, beside)
            except MocodecError:
                continue


def test_every_seed_is_read_or_refused() -> None:
    for seed in seeds.files():
        try:
            calls.read(seed.name, seed.data, seed.beside)
        except MocodecError:
            continue
    for name, data in seeds.containers().items():
        calls.decode(name, data, {})


def test_mutations_and_motions_are_the_same_each_time() -> None:
    data = seeds.containers()["tempo"]
    for mutate in (mutations.mutate, resigned.mutate, mutations.same_length):
        first, second = (mutate(data, np.random.default_rng(3)) for _ in range(2))
        assert first == second != data
    assert np.array_equal(motions.motion(11).positions, motions.motion(11).positions, equal_nan=True)


def test_every_chunk_of_a_signal_has_its_checksum_after_damage() -> None:
    data = seeds.containers()["golden-signals-exact"]
    refusals: list[str] = []
    for seed in range(60):
        try:
            with mc.open(resigned.mutate(data, np.random.default_rng(seed))) as file:
                file.verify()
        except MocodecError as error:
            refusals.append(str(error))
    assert refusals
    assert not any("of a signal are damaged" in text for text in refusals)


def test_a_worker_reports_each_kind_of_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    def slow(*_: Any) -> None:
        while True:
            pass

    def raises(error: BaseException) -> Any:
        def call(*_: Any) -> None:
            raise error

        return call

    monkeypatch.setattr(worker, "SECONDS", 0.2)
    wanted = {
        "refused": MocodecError("x"),
        "foreign": KeyError("x"),
        "memory": MemoryError(),
        "broken promise": AssertionError(),
    }
    for kind, error in wanted.items():
        monkeypatch.setitem(calls.CALLS, "read", raises(error))
        assert worker.run("read", "", b"", {}).kind == kind
    monkeypatch.setitem(calls.CALLS, "read", slow)
    assert worker.run("read", "", b"", {}).kind == "time"


class _Worker:
    """Finds what contains b"bad"."""

    def run(self, call: campaign.Call) -> worker.Outcome:
        return worker.Outcome("foreign" if b"bad" in call[2] else "ok", "KeyError at x.py:1: y", 0.1)

    def close(self) -> None:
        pass


def test_findings_are_minimised_counted_and_stored(tmp_path: Path) -> None:
    def inputs() -> Iterator[campaign.Call]:
        yield from (("read", "a.trc", data, {}) for data in (b"x" * 500 + b"bad" + b"y" * 500, b"good", b"bad again"))

    found = campaign.Campaign(_Worker(), tmp_path)  # type: ignore[arg-type]
    found.run(inputs(), lambda: False)
    result = found.as_json(60.0)
    assert result["calls"] == {"read": {"foreign": 2, "ok": 1}}
    assert [f["times"] for f in result["findings"]] == [2]
    assert (tmp_path / result["findings"][0]["file"]).read_bytes() == b"bad"
    for key in ("compiled", "pure"):
        campaign.store(tmp_path / "fuzz.json", key, result)
