"""Pictures of point clouds and of their coding error. Needs matplotlib: the [plot] extra.

errors          D1 and the largest error of each frame, over time
side_by_side    the original above, the decoded points below, at a few times
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from . import plots
from .metrics import point_clouds, splats
from .pointcloud import PointClouds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VIEW_PIXELS = 320


def errors(
    original: PointClouds, decoded: PointClouds, title: str = "", promise: Mapping[str, float] | None = None
) -> Figure:
    """D1 and the largest distance between nearest points of each frame, over time; promised errors as lines.

    promise: of the compressed file; `max_error` and `mean_error`, metres. Raises BadInput, MissingExtra.
    """
    found = point_clouds.errors(original, decoded)
    picture = plots.figure(9, 3.5)
    picture.suptitle(title, fontsize=10)
    axes = picture.subplots()
    seconds = np.array(found.frames) / original.rate
    axes.plot(
        seconds,
        1000 * found.max_of_frame,
        color=plots.FAINT,
        linewidth=0.8,
        label="largest distance to the nearest point",
    )
    axes.plot(seconds, 1000 * found.d1_of_frame, color=plots.OURS, linewidth=1.2, label="D1")
    plots.draw_promise(axes.axhline, promise)
    axes.set_xlabel("time, s")
    axes.set_ylabel("error, mm")
    axes.set_ylim(bottom=0)
    axes.margins(x=0)
    axes.spines[["top", "right"]].set_visible(False)
    plots.legend_above(axes)
    return picture


def side_by_side(original: PointClouds, decoded: PointClouds, title: str = "", poses: int = 5) -> Figure:
    """Views of both point clouds at `poses` times. Raises MissingExtra."""
    filled = [frame for frame in range(len(original)) if point_clouds.has_points(original, frame)]
    chosen = (
        [filled[i] for i in np.unique(np.linspace(0, len(filled) - 1, poses).round().astype(int))] if filled else []
    )
    picture = plots.figure(2 * max(len(chosen), 1), 4.6)
    picture.suptitle(title, fontsize=10)
    grid = picture.subplots(2, max(len(chosen), 1), squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    decimals = 1 if original.seconds > len(chosen) else 2
    for column, frame in enumerate(chosen):
        for row, clouds in enumerate((original, decoded)):
            view = splats.views(clouds, frame, like=original, count=1, size=VIEW_PIXELS)[0]
            grid[row, column].imshow(view)
        grid[0, column].set_title(f"{frame / original.rate:.{decimals}f} s", fontsize=8)
    for row, name in enumerate(("original", "decoded")):
        grid[row, 0].text(-0.05, 0.5, name, rotation=90, va="center", transform=grid[row, 0].transAxes, fontsize=8)
    return picture
