"""Residual maps (section 4): what the posed model misses of a frame, as images on the links' cylinders.

    model ──map_layout──► a tile of the map sheet for each link, with the model's own map there
    frame ──frame_maps──► the frame's map of each link ──residual_of──► difference from the model's map
    model, pose, difference ──reconstruct──► points of the frame

Rows of a map run along a link, columns around it. A cell holds a distance from the axis, "depth", and a colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...geometry import articulated_icp, articulation, cylinder_map
from ...geometry.articulation import Pose
from ...geometry.cylinder_map import Cylinder, CylinderMap
from ...typing import Booleans, Bytes, Floats
from ..clouds.raw_frames import Cloud
from .cylinder_model import DEPTH_STEP_M, CylinderTemplate

DEAD_ZONE_STEPS = 0.75  # smaller differences of depth are coded as zero
ZERO = 128  # level of depth and colour that means "no difference"; depth 0 means "no point"
COLOUR_STEP = 2  # levels of colour
MAX_DISTANCE_M = 0.25  # from a link's cylinder; points farther off belong to props or other people
MIN_LINK_POINTS = 6  # links with fewer model points have no map
MIN_MAP_LENGTH_M = 0.02
GREY = 128.0  # colour of clouds without colours


class ResidualMap(NamedTuple):
    """One frame minus the model, on the whole map sheet: depth (height, width), colour (height, width, 3).

    depth: 0 where the frame has no point; otherwise ZERO + steps of depth. colour: ZERO + steps of COLOUR_STEP levels.
    """

    depth: Bytes
    colour: Bytes


class MapTile(NamedTuple):
    """The map of one link: its place on the sheet, its cylinder, and the model's map on it."""

    top: int
    left: int
    cylinder: Cylinder
    expected: CylinderMap

    @property
    def shape(self) -> tuple[int, int]:
        height, width = self.expected.distance.shape
        return height, width

    @property
    def region(self) -> tuple[slice, slice]:
        """Rows and columns of the sheet."""
        height, width = self.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)


# --- layout ---------------------------------------------------------------------------------------------------------


def map_layout(model: CylinderTemplate, share: float) -> list[MapTile | None]:
    """(links,): the tile of each link on the map sheet; None for links with too few points. share: of the full maps."""
    tiles = [_tile(model, link, share) for link in range(len(model.body))]
    shapes = [tile.shape if tile else (0, 0) for tile in tiles]
    width = max(max(w for _, w in shapes), int(1.1 * np.sqrt(sum(h * w for h, w in shapes))))
    left = top = shelf_height = 0
    for link in sorted(range(len(tiles)), key=lambda link: -shapes[link][0]):
        tile, (height, tile_width) = tiles[link], shapes[link]
        if tile is None:
            continue
        if left + tile_width > width:
            left, top, shelf_height = 0, top + shelf_height, 0
        tiles[link] = tile._replace(top=top, left=left)
        left, shelf_height = left + tile_width, max(shelf_height, height)
    return tiles


def _tile(model: CylinderTemplate, link: int, share: float) -> MapTile | None:
    """A link's map at the corner of the sheet; its size is the paper's, with `share` of the cells."""
    own = model.links == link
    if own.sum() < MIN_LINK_POINTS:
        return None
    body, points = model.body, model.points[own]
    along = (points - body.origins[link]) @ body.axes[link]
    low, high = float(along.min()), max(float(along.max()), float(along.min()) + MIN_MAP_LENGTH_M)
    cylinder = cylinder_map.cylinder(body.origins[link], body.tips[link], low, high)
    shape = cylinder_map.grid_size(int(own.sum()), float(body.radii[link]), high - low, share)
    colours = _colours_as_floats(None if model.colours is None else model.colours[own], len(points))
    return MapTile(0, 0, cylinder, cylinder_map.filled(cylinder_map.forward(cylinder, points, colours, shape)))


def sheet_size(tiles: Sequence[MapTile | None]) -> tuple[int, int]:
    """(height, width) of the whole map sheet."""
    ends = [(tile.region[0].stop, tile.region[1].stop) for tile in tiles if tile]
    return max(h for h, _ in ends), max(w for _, w in ends)


def _colours_as_floats(colours: Bytes | None, points: int) -> Floats:
    return np.full((points, 3), GREY) if colours is None else colours.astype(float)


# --- forward --------------------------------------------------------------------------------------------------------


def frame_maps(
    model: CylinderTemplate, tiles: Sequence[MapTile | None], pose: Pose, frame: Cloud
) -> list[CylinderMap | None]:
    """(links,): the frame's points as maps on the links, which stand where the decoded pose puts them."""
    points, colours = frame
    a, b = articulation.transforms(model.body, pose)
    links = articulated_icp.segment(model.body, a, b, points, None)
    colours = _colours_as_floats(colours, len(points))
    maps = list[CylinderMap | None]()
    for link, tile in enumerate(tiles):
        if tile is None:
            maps.append(None)
            continue
        own = links == link
        local, own_colours = (points[own] - b[link]) @ a[link], colours[own]
        along, _, distance = cylinder_map.coordinates(tile.cylinder, local)
        beyond = np.abs(along - np.clip(along, tile.cylinder.low, tile.cylinder.high))
        near = (distance < model.body.radii[link] + MAX_DISTANCE_M) & (beyond < MAX_DISTANCE_M)
        maps.append(cylinder_map.forward(tile.cylinder, local[near], own_colours[near], tile.shape))
    return maps


def residual_of(tiles: Sequence[MapTile | None], maps: Sequence[CylinderMap | None]) -> ResidualMap:
    """The difference of a frame's maps from the model's."""
    depth = np.zeros(sheet_size(tiles), np.uint8)
    colour = np.full((*depth.shape, 3), ZERO, np.uint8)
    for tile, frame_map in zip(tiles, maps, strict=True):
        if tile is None or frame_map is None:
            continue
        occupied = np.isfinite(frame_map.distance)
        steps = np.where(occupied, frame_map.distance - tile.expected.distance, 0) / DEPTH_STEP_M
        steps = np.where(np.abs(steps) < DEAD_ZONE_STEPS, 0, np.round(steps))
        depth[tile.region] = np.where(occupied, np.clip(steps + ZERO, 1, 255), 0)
        difference = np.where(occupied[..., None], frame_map.colour - tile.expected.colour, 0)
        colour[tile.region] = np.clip(np.round(difference / COLOUR_STEP) + ZERO, 0, 255)
    return ResidualMap(depth, colour)


# --- inverse --------------------------------------------------------------------------------------------------------


def reconstruct(
    model: CylinderTemplate,
    tiles: Sequence[MapTile | None],
    pose: Pose,
    residual: ResidualMap | None,
    depth_step_m: float,
) -> Cloud:
    """A frame's points: those of the posed model, moved by the residual map if there is one."""
    a, b = articulation.transforms(model.body, pose)
    if residual is None:
        return np.einsum("nij,nj->ni", a[model.links], model.points) + b[model.links], model.colours
    points, colours = list[Floats](), list[Floats]()
    for link, tile in enumerate(tiles):
        if tile is None:
            continue
        occupied = residual.depth[tile.region] > 0
        depth = (residual.depth[tile.region].astype(np.float64) - ZERO) * depth_step_m
        colour = COLOUR_STEP * (residual.colour[tile.region].astype(np.float64) - ZERO)
        local, local_colours = _corrected_points(model, link, tile, occupied, depth, colour)
        points.append(local @ a[link].T + b[link])
        colours.append(local_colours)
    if model.colours is None:
        return np.concatenate(points), None
    return np.concatenate(points), np.clip(np.round(np.concatenate(colours)), 0, 255).astype(np.uint8)


def _corrected_points(
    model: CylinderTemplate, link: int, tile: MapTile, occupied: Booleans, depth: Floats, colour: Floats
) -> tuple[Floats, Floats]:
    """A link's points in the canonical pose, and their colours, after the residual.

    occupied (height, width), depth (height, width) metres, colour (height, width, 3): the residual. Each model point
    in an occupied cell moves by the cell's difference; an occupied cell without a model point gets one. A cell of a
    small grid holds several model points and moves all of them: so a quarter of the full maps still yields as many
    points as the model has.
    """
    own = model.links == link
    points = model.points[own]
    cell, distance = cylinder_map.cells(tile.cylinder, points, tile.shape)
    kept = occupied.ravel()[cell]
    along, _, _ = cylinder_map.coordinates(tile.cylinder, points)
    outward = points - tile.cylinder.origin - along[:, None] * tile.cylinder.axis
    outward /= np.maximum(distance, 1e-6)[:, None]
    moved = points[kept] + (outward * depth.ravel()[cell][:, None])[kept]
    colours = _colours_as_floats(None if model.colours is None else model.colours[own], len(points))
    colours = (colours + colour.reshape(-1, 3)[cell])[kept]
    empty_in_model = occupied.copy()
    empty_in_model.reshape(-1)[cell] = False
    distances = np.where(empty_in_model, tile.expected.distance + depth, np.nan)
    added, added_colours = cylinder_map.inverse(tile.cylinder, CylinderMap(distances, tile.expected.colour + colour))
    return np.concatenate([moved, added]), np.concatenate([colours, added_colours])
