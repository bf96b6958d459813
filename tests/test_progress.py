"""Progress: fractions from 0 to 1 that only rise, through nested phases, and no cost without a listener."""

from __future__ import annotations

import pytest

import mocodec as mc
from mocodec import progress
from mocodec.testing import synthetic


def test_reports_are_heard_from_0_to_1() -> None:
    heard: list[float] = []
    with progress.listening(heard.append):
        for _ in progress.over(range(4)):
            pass
    assert heard == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_phases_nest() -> None:
    heard: list[float] = []
    with progress.listening(heard.append):
        with progress.phase(0.5, 1.0):
            progress.report(0.5)
            with progress.phase(0.5, 0.75):
                progress.report(0.5)
        assert heard == [0.0, 0.75, 0.8125, 0.875, 1.0]


def test_attempts_of_a_search_each_take_a_share_of_what_is_left() -> None:
    heard: list[float] = []

    def trial(setting: int) -> int:
        progress.report(0.5)
        return 2 * setting

    with progress.listening(heard.append):
        measure = progress.attempts(trial, share=0.5)
        assert [measure(1), measure(2)] == [2, 4]
    assert heard == [0.0, 0.25, 0.5, 0.625, 0.75, 1.0]


def test_a_lower_fraction_is_not_passed_on() -> None:
    heard: list[float] = []
    with progress.listening(heard.append):
        for fraction in (0.5, 0.2, 0.5001, 2.0, -1.0):
            progress.report(fraction)
    assert heard == [0.0, 0.5, 1.0]


def test_without_a_listener_nothing_happens() -> None:
    progress.report(0.5)
    with progress.phase(0.2, 0.4):
        assert list(progress.over([1, 2])) == [1, 2]


def test_work_that_fails_does_not_reach_1() -> None:
    heard: list[float] = []
    with pytest.raises(ZeroDivisionError), progress.listening(heard.append), progress.phase(0.0, 0.5):
        raise ZeroDivisionError
    assert heard == [0.0]
    progress.report(0.7)
    assert heard == [0.0]


def test_an_inner_call_without_a_callback_reports_to_the_outer_one() -> None:
    heard: list[float] = []
    with progress.listening(heard.append), progress.listening(None):
        progress.report(0.5)
    assert heard == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("codec", ["tempo", "hou2014", "liu2006", "lossless"])
def test_encode_and_decode_report(codec: str) -> None:
    motion = synthetic.markers(frames=700, seed=2)
    encoding: list[float] = []
    decoding: list[float] = []
    settings = {"chunk_seconds": 1.0} if codec == "lossless" else {"max_error": 0.01}
    blob = mc.encode(motion, codec, progress=encoding.append, **settings)
    mc.decode(blob, progress=decoding.append)
    for heard in (encoding, decoding):
        assert heard[0] == 0.0
        assert heard[-1] == 1.0
        assert heard == sorted(heard)


def test_a_callback_can_stop_the_work() -> None:
    def stop(fraction: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mc.encode(synthetic.markers(frames=50), "lossless", progress=stop)
