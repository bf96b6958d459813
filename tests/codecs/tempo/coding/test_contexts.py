"""Encoder and decoder select the same tables."""

from __future__ import annotations

import numpy as np

from mocodec.codecs.tempo.coding import contexts


def test_the_decoders_neighbours_weigh_what_the_encoders_do() -> None:
    rng = np.random.default_rng(3)
    magnitudes = contexts.ceiling(rng.geometric(0.02, (40, 23)) - 1)
    encoders = contexts.neighbourhood(contexts.bordered(magnitudes))
    below = np.concatenate([np.zeros((contexts.DEPTH, 23)), magnitudes]).astype(np.float32)
    starts = contexts.groups(40)[0]
    decoders = np.stack([below[k : k + contexts.DEPTH].ravel() for k in starts]) @ contexts.weights(23)
    np.testing.assert_array_equal(decoders, encoders)
