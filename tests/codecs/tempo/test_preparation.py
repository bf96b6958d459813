"""What one compiled pass over positions finds is what NumPy finds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from mocodec import metrics, native
from mocodec.codecs.tempo.coding import direct
from mocodec.codecs.tempo.preparation import prepare
from mocodec.errors import CannotEncode
from mocodec.testing import synthetic
from mocodec.typing import Floats


def recordings() -> Iterator[tuple[str, Floats]]:
    plain = synthetic.markers(frames=300, seed=4).positions
    yield "plain", plain
    for name, where, value in (
        ("gap", (slice(40, 60), 3), np.nan),
        ("parked", (slice(100, 160), 5), 0.0),
        ("spike", (120, 7), 3.0),
        ("spikes in a row", (slice(120, 122), 7), 3.0),
        ("spike at the end", (299, 7), 3.0),
    ):
        changed = plain.copy()
        changed[where] = value
        yield name, changed
    leap = plain.copy()
    leap[170:] += 1.0
    leap[200:, 4] += 0.5
    yield "leaps", leap
    yield "repeated frames", np.repeat(plain, 2, axis=0)
    yield "one frame", plain[:1]
    yield "three frames", leap[169:172]
    yield "still", np.broadcast_to(plain[:1], (50, *plain.shape[1:])).copy()
    yield "without points", np.zeros((10, 0, 3))


@pytest.mark.parametrize("up", ["y", "z"])
def test_preparation_is_that_of_numpy(up: str) -> None:
    for name, positions in recordings():
        found = prepare(positions, up, 0.001)
        with native.without():
            expected = prepare(positions, up, 0.001)
        for field in ("positions", "smooth", "spikes"):
            np.testing.assert_array_equal(getattr(found, field), getattr(expected, field), name)
        np.testing.assert_array_equal(found.apart.missing, expected.apart.missing, name)
        np.testing.assert_array_equal(found.apart.frozen, expected.apart.frozen, name)
        leaps = found.discontinuities(120.0)
        with native.without():
            assert leaps == expected.discontinuities(120.0), name
        assert leaps == ([170, 200] if name == "leaps" else leaps)


def test_errors_are_those_of_numpy() -> None:
    for name, positions in recordings():
        decoded = positions + np.random.default_rng(0).normal(0, 0.01, positions.shape)
        for other in (decoded, np.where(np.arange(len(positions))[:, None, None] == 0, np.nan, decoded)):
            found = metrics.errors(positions, other)
            with native.without():
                expected = metrics.errors(positions, other)
            assert found[:2] == expected[:2], name
            np.testing.assert_allclose(found[2:], expected[2:], rtol=1e-12, err_msg=name)


def test_estimates_of_the_direct_engine_are_those_of_numpy() -> None:
    positions = synthetic.markers(frames=301, seed=4).positions
    for some in (positions, positions[:1], positions[:2], positions[:3]):
        for every in (1, 6):
            found = direct.estimate(some, 0.003, every)
            with native.without():
                assert found == pytest.approx(direct.estimate(some, 0.003, every), rel=1e-12)
    for pure in (False, True):
        with pytest.raises(CannotEncode), native.without() if pure else pytest.MonkeyPatch.context():
            direct.estimate(positions * 1e15, 1e-6)
