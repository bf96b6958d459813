"""Positions of markers in the frame of the body, and back: sections 3.1 and 3.5."""

from __future__ import annotations

from ... import native
from ...geometry import body_frame
from ...typing import Floats, Integers


def to_body(positions: Floats, columns: Integers, frame: body_frame.BodyFrame) -> Floats:
    """Some points (columns,) of positions (frames, points, 3) in the body's frame, (frames, 3 columns)."""
    if (kernel := native.kernel("place_in_body")) is not None:
        return kernel(positions, columns, frame.origin, frame.heading, frame.up)
    return body_frame.to_body(positions[:, columns], frame).reshape(len(positions), -1)


def to_world(poses: Floats, columns: Integers, frame: body_frame.BodyFrame, positions: Floats) -> None:
    """The inverse of `to_body`, into positions."""
    if (kernel := native.kernel("place_in_world")) is not None:
        kernel(poses, columns, frame.origin, frame.heading, frame.up, positions)
    else:
        positions[:, columns] = body_frame.to_world(poses.reshape(len(poses), -1, 3), frame)
