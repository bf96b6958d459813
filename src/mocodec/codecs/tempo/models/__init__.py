"""Models: what the coefficients of a recording are, and how large they are expected to be.

MODELS is the table of them: each combination of two parts.

    coordinates     positions of points · directions of bones
    statistics      the prior's, by way of a correspondence · a basis stored with the recording

    recording         what a model is fitted to, and the protocol of a fitted model
    model             coordinates and statistics to coefficients, and back
    coordinates       positions, directions
    prior             what ships with the package
    points            the two models of positions          directions   the two models of bone directions
    stored_basis      statistics stored with the recording
    predicted_motion  statistics of the prior for other coordinates than its own
    markers_on_bones, marker_fitting                markers of any names placed on the prior's bones
    skeleton_correspondence, skeleton_matching, tree_matching    skeletons of any names matched to the prior's
    build             proportions of a body
    ordered           linear algebra in a fixed order of operations
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from ....motion import Motion
from . import directions, points
from .prior import Prior
from .recording import FittedModel, Recording


class ModelType(NamedTuple):
    """number: on disk, never to change. fit yields models to choose from, none if the recording has none of the type.
    unpack is the inverse of a fitted model's pack; it raises Corrupt."""

    number: int
    fit: Callable[[Recording], Iterator[FittedModel]]
    unpack: Callable[[bytes, Prior, Motion], FittedModel]


MODELS = {
    "points-prior": ModelType(0, points.fit_with_prior, points.unpack_with_prior),
    "points-stored": ModelType(1, points.fit_stored, points.unpack_stored),
    "directions-prior": ModelType(2, directions.fit_with_prior, directions.unpack_with_prior),
    "directions-stored": ModelType(3, directions.fit_stored, directions.unpack_stored),
}
"""Coordinates and statistics, by name."""

WITH_STORED_BASIS = ("points-stored", "directions-stored")

__all__ = ["MODELS", "WITH_STORED_BASIS", "FittedModel", "ModelType", "Recording"]
