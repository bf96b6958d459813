"""Searches reach their targets in few trials, on rough functions too, and never try a setting twice."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec.stages import search


class Counted:
    """A function that remembers its arguments."""

    def __init__(self, of) -> None:
        self.of, self.seen = of, []

    def __call__(self, x):
        self.seen.append(x)
        return self.of(x)


def octaves_64(log: float) -> int:
    return max(1, min(round(abs(log) * 90), 384))


@settings(deadline=None, derandomize=True, max_examples=150)
@given(st.integers(-600, 600), st.floats(0.5, 2.0), st.integers(-200, 200), st.booleans(), st.floats(0.0, 0.004))
def test_closest_within_a_limit(root: int, power: float, start: int, rising: bool, rough: float):
    sign = 1 if rising else -1

    def measure(x: float) -> tuple[float, float]:
        return 2 ** (sign * power * (x - root) / 64) * (1 + rough * math.sin(x)), x

    counted = Counted(measure)
    found = search.closest_within(counted, start, rising=rising, stride=octaves_64, farthest=1920)
    assert found is not None
    assert found.result == found.setting == round(found.setting)
    assert found.value <= 1
    assert found.value >= 0.985 or measure(found.setting + sign)[0] > 1
    assert len(counted.seen) == len(set(counted.seen)) <= 24


def test_closest_within_on_a_continuous_scale():
    found = search.closest_within(
        lambda x: (math.exp(x) / 7, None),
        0.0,
        rising=True,
        stride=lambda log: min(abs(log), 3.0),
        farthest=25.0,
        near=0.98,
        whole=False,
    )
    assert found is not None
    assert 0.98 <= found.value <= 1


@pytest.mark.parametrize("rising", [False, True])
def test_nothing_within_a_limit(rising: bool):
    counted = Counted(lambda x: (2.0, None))
    found = search.closest_within(counted, 0, rising=rising, stride=octaves_64, farthest=200)
    assert found is None
    assert all(abs(x) <= 200 for x in counted.seen)
    assert (counted.seen[-1] < 0) == rising


def test_values_of_zero_are_within_every_limit():
    found = search.closest_within(
        lambda x: (0.0 if x < 100 else 3.0, None), 0, rising=True, stride=octaves_64, farthest=1920
    )
    assert found is not None
    assert found.setting < 100


@settings(deadline=None, derandomize=True, max_examples=150)
@given(st.floats(-900, 900), st.floats(0.5, 1.9), st.integers(-200, 200), st.floats(0, 0.2))
def test_nearest_root(root: float, slope: float, start: int, rough: float):
    def excess(x: int) -> tuple[float, int]:
        return slope * (x - root) + rough * math.sin(7 * x), x

    counted = Counted(excess)
    best, tried = search.nearest_root(counted, start, -1000, 1000, near=0.1)
    assert best.result == best.setting
    assert tried[int(best.setting)] == best.value
    assert abs(best.value) == min(map(abs, tried.values()))
    assert abs(best.value) <= slope / 2 + rough * 2 + 0.6
    assert len(counted.seen) == len(set(counted.seen)) == len(tried) <= 12


def test_a_root_beyond_the_range():
    best, _ = search.nearest_root(lambda x: (x - 5000.0, None), 0, -1000, 1000)
    assert best.setting == 1000
    best, _ = search.nearest_root(lambda x: (x + 5000.0, None), 0, -1000, 1000)
    assert best.setting == -1000


@settings(deadline=None, derandomize=True, max_examples=200)
@given(st.integers(-3000, 3000), st.integers(-3000, 3000), st.integers(-2000, 0), st.integers(1, 2000))
def test_largest_true(last: int, start: int, low: int, high: int):
    counted = Counted(lambda x: x <= last)
    found = search.largest_true(counted, start, low, high)
    assert found == (min(last, high) if last >= low else None)
    assert all(low <= x <= high for x in counted.seen)
    assert len(counted.seen) == len(set(counted.seen)) <= 30


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.integers(-300, 300), st.integers(-100, 100))
def test_minimum_of_a_valley(valley: int, start: int):
    counted = Counted(lambda x: abs(x - valley) ** 1.5)
    found = search.minimum(counted, start, (32, 12), farthest=1920, tries=60)
    assert abs(found - valley) <= 12
    assert len(counted.seen) == len(set(counted.seen))


def test_a_minimum_where_nothing_is_finite():
    assert search.minimum(lambda _: math.inf, 5, (32, 12), farthest=100) in range(-95, 106)
