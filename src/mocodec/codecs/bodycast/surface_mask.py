"""Which cells of the atlas are surface: computed from the density of points, and stored as a coded mask."""

from __future__ import annotations

import numpy as np

from ...typing import AnyInteger, Booleans, Bytes, Floats, Integers
from .binary_coder import BinaryDecoder, BinaryEncoder, ContextCounts
from .surface_sampling import SUBCELLS, subcell_areas
from .texture_atlas import Atlas, CellSums

SPARSE_POINTS = 8  # points per cell below which cells are counted together with their neighbours
MIN_DENSITY = 0.4  # of the median density: a cell with fewer points per area is no surface
MIN_NEIGHBOURS = 4  # of the nine cells in a 3 × 3 window, exceeded by a cell of the surface
MASK_CONTEXTS = 2 << 8
CODED_NEIGHBOURS = ((1, -2), (1, -1), (1, 0), (1, 1), (2, 0), (1, 2))  # rows above, columns to the right


def surface_cells(atlas: Atlas, planes: Bytes, sums: CellSums) -> Booleans:
    """(height, width): True for cells with a usual density of points, by majority of their 3 × 3 window.

    Cells inside joints, and cells that span two surfaces, hold fewer points for their area.
    """
    count, area = sums.values[0].reshape(atlas.height, atlas.width), np.zeros((atlas.height, atlas.width))
    displacement = planes[0, atlas.height :].astype(np.float64)
    for tile in atlas.tiles:
        fine, _ = subcell_areas(atlas, tile, displacement, np.ones(area.shape, bool))
        area[tile.region] = fine.reshape(tile.height, SUBCELLS, tile.width, SUBCELLS).sum(axis=(1, 3))
    occupied = (count > 0) & (area > 0)
    if not occupied.any():
        return occupied
    if count[occupied].mean() < SPARSE_POINTS:
        count, area = (_window_sums(atlas, values) for values in (count, area))
    occupied = (count > 0) & (area > 0)
    density = float(np.median(count[occupied] / area[occupied]))
    dense = (count >= MIN_DENSITY * density * area) & occupied
    surface = _window_sums(atlas, dense.astype(np.float64)) > MIN_NEIGHBOURS  # single cells would cost more bits
    return surface if surface.any() else dense


def _window_sums(atlas: Atlas, values: Floats) -> Floats:
    """(height, width): sums over 3 × 3 cells within each tile; columns close a ring, edge rows are repeated."""
    result = np.zeros_like(values)
    for t in atlas.tiles:
        padded = np.pad(np.pad(values[t.region], ((0, 0), (1, 1)), "wrap"), ((1, 1), (0, 0)), "edge")
        for i, j in np.ndindex(3, 3):
            result[t.region] += padded[i : i + t.height, j : j + t.width]
    return result


def pack_mask(mask: Booleans) -> bytes:
    """A mask (height, width), row by row: first the even columns of a row, then the odd ones."""
    encoder, counts = BinaryEncoder(), ContextCounts(MASK_CONTEXTS)
    padded = _empty_padded(mask.shape)
    for row, values in enumerate(mask.astype(np.int64)):
        for odd in (0, 1):
            encoder.encode(counts, _mask_contexts(padded, row, odd), values[odd::2])
            padded[row + 2, 2 + odd : 2 + mask.shape[1] : 2] = values[odd::2]
    return encoder.finish()


def unpack_mask(data: bytes, shape: tuple[int, int]) -> Booleans:
    """The inverse of `pack_mask`. Raises Corrupt."""
    decoder, counts = BinaryDecoder(data), ContextCounts(MASK_CONTEXTS)
    padded = _empty_padded(shape)
    for row in range(shape[0]):
        for odd in (0, 1):
            padded[row + 2, 2 + odd : 2 + shape[1] : 2] = decoder.decode(counts, _mask_contexts(padded, row, odd))
    decoder.finish()
    return padded[2:, 2:-2] != 0


def _empty_padded(shape: tuple[int, int]) -> Integers:
    """Zeros with two more rows above, and two more columns on either side."""
    return np.zeros((shape[0] + 2, shape[1] + 4), np.int64)


def _mask_contexts(padded: Integers, row: int, odd: int) -> AnyInteger:
    """The contexts of every second cell of a row: six cells above; for odd columns both neighbours in the row too."""
    width = padded.shape[1] - 4
    columns = np.arange(odd, width, 2) + 2
    context = np.full(len(columns), odd)
    for above, shift in CODED_NEIGHBOURS:
        context = context * 2 + padded[row + 2 - above][columns + shift]
    for shift in (-1, 1):
        context = context * 2 + (padded[row + 2][columns + shift] if odd else 0)
    return context
