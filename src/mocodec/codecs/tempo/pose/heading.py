"""The frame that follows the body: where it is and which way it faces.

    positions (frames, points, 3) ─to_y_up─► ──► place (frames, 3) · heading (frames,) · pose (frames, points, 3)
    pose = positions less their mean, rotated back by the heading

Only the vertical axis and a mean pose are needed, so this works for any set of points: the heading of a frame is the
rotation about the vertical that brings the mean pose nearest to it (Procrustes analysis in the plane, closed form).
Inside tempo y is up; x and z are horizontal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .... import parallel
from ....typing import Floats


def to_y_up(positions: Floats, up: str) -> Floats:
    """Positions in right-handed axes with y up."""
    if up == "y":
        return positions
    order = (1, 2, 0) if up == "z" else (2, 0, 1)
    out = np.empty(positions.shape, positions.dtype)

    def turn(block: slice) -> None:
        for axis, source in enumerate(order):
            out[block, ..., axis] = positions[block, ..., source]

    list(parallel.over(turn, parallel.blocks(len(positions))))
    return out


def from_y_up(positions: Floats, up: str) -> Floats:
    """The inverse of `to_y_up`."""
    if up == "y":
        return positions
    order = (2, 0, 1) if up == "z" else (1, 2, 0)
    return positions[..., order]


def centred(pieces: Sequence[Floats]) -> Floats:
    """Pieces of motion (frames, points, 3), one after the other, less the mean of each frame: (all frames, points, 3).

    In the order of memory of (3, frames, points), along which NumPy is fastest.
    """
    stops = np.cumsum([len(piece) for piece in pieces]).tolist()
    out = np.empty((3, stops[-1], pieces[0].shape[1]))

    def centre(number: int) -> None:
        piece, stop = pieces[number], stops[number]
        place = piece.mean(axis=1)
        for axis, of_axis in enumerate(out[:, stop - len(piece) : stop]):
            np.subtract(piece[..., axis], place[:, axis, None], out=of_axis)

    list(parallel.over(centre, range(len(pieces))))
    return np.moveaxis(out, 0, 2)


def heading(centred: Floats, mean_pose: Floats) -> Floats:
    """Rotation about y, radians, unwrapped, that brings the mean pose (points, 3) nearest to each frame."""
    return np.unwrap(_headings(centred[..., 0], centred[..., 2], mean_pose))


def _headings(x: Floats, z: Floats, mean_pose: Floats) -> Floats:
    cosine = x @ mean_pose[:, 0] + z @ mean_pose[:, 2]
    sine = x @ mean_pose[:, 2] - z @ mean_pose[:, 0]
    return np.arctan2(sine, cosine)


def rotate(points: Floats, angle: Floats) -> Floats:
    """Points (frames, points, 3) rotated about y by an angle a frame, (frames,), radians."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out = np.empty_like(points)
    out[..., 0] = c * points[..., 0] + s * points[..., 2]
    out[..., 1] = points[..., 1]
    out[..., 2] = c * points[..., 2] - s * points[..., 0]
    return out


def align(centred: Floats, mean_pose: Floats) -> Floats:
    """Each frame rotated so that it faces the way the mean pose does."""
    return rotate(centred, -heading(centred, mean_pose))


def mean_pose(centred: Floats, rounds: int = 10) -> Floats:
    """The mean (points, 3) of all frames, each rotated to it (generalised Procrustes analysis).

    Work is done in blocks of frames, whose sums do not depend on the number of threads.
    """
    horizontal = [
        (np.ascontiguousarray(centred[block, :, 0]), np.ascontiguousarray(centred[block, :, 2]))
        for block in parallel.blocks(len(centred))
    ]
    height = centred[..., 1].mean(axis=0)
    pose = centred[len(centred) // 2]
    for _ in range(rounds):
        x, z = np.zeros((2, len(pose)))
        for of_x, of_z in parallel.over(lambda block, to=pose: _sums_rotated_to(to, *block, len(centred)), horizontal):
            x, z = x + of_x, z + of_z
        pose = np.stack([x, height, z], axis=1)
    return pose


def _sums_rotated_to(pose: Floats, x: Floats, z: Floats, frames: int) -> tuple[Floats, Floats]:
    """Sums (points,) of x and of z (frames, points), over a number of frames, each rotated to a pose (points, 3)."""
    angle = _headings(x, z, pose)
    c, s = np.cos(angle) / frames, np.sin(angle) / frames
    return c @ x - s @ z, c @ z + s @ x
