"""A recording as a film, without a browser: frames drawn by Pillow, coded by PyAV. Needs the [cloud] extra.

    positions ─► view (across the widest side, from a little above) ─► pixels ─► links, points ─► .mp4

The original, if there is one, is drawn in grey under the recording, whose points have the colours of their errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from .. import metrics, progress
from ..errors import BadInput, MissingExtra
from ..formats import replace_whole
from ..geometry import views
from ..motion import Motion
from ..typing import Floats
from .facts import motion_errors, motion_links
from .recording import Shown

SIZE = (1280, 720)
FINEST = 2
"""Pictures are drawn this many times larger and made smaller, for smooth edges."""
MOST_RATE = 30.0
TILT = np.radians(14.0)
"""Angle of the view from above, radians, which shows the ground."""
PAPER, INK, GHOST, GRID = (251, 251, 248), (29, 36, 48), (176, 180, 188), (226, 226, 220)
RAMP = np.array([[63, 110, 168], [224, 160, 48], [200, 68, 46]], np.float64)
"""Colours of no error, half of the scale, and the whole scale."""


def write(path: str | PathLike[str], shown: Shown, original: Shown | None = None) -> None:
    """Write a film of a recording as .mp4, 1280 × 720, at most 30 frames a second.

    Raises BadInput for another suffix and for recordings without frames, MissingExtra without PyAV and Pillow.
    """
    if Path(path).suffix.lower() != ".mp4":
        raise BadInput(f"{fspath(path)}: the suffix of a film must be .mp4")
    if not shown.frames:
        raise BadInput(f"{shown.name} has no frames to film")
    try:
        import av
        import PIL  # noqa: F401
    except ImportError as error:
        raise MissingExtra("a film", "cloud") from error
    step = max(1, round(shown.about.rate / MOST_RATE))
    pictures = (
        motion_pictures(shown, original, step) if isinstance(shown.about, Motion) else cloud_pictures(shown, step)
    )
    made = BytesIO()
    with av.open(made, "w", format="mp4") as film:
        stream: Any = film.add_stream("libx264", rate=round(max(1.0, shown.about.rate / step)))
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "20", "preset": "medium"}
        count = -(-shown.frames // step)
        for done, picture in enumerate(pictures, 1):
            film.mux(stream.encode(av.VideoFrame.from_image(picture)))
            progress.report(done / count)
        film.mux(stream.encode())
    replace_whole(path, made.getvalue())


class Camera:
    """Follows the middle of the points over the ground.

    view: directions to the right, up and away (3, 3). metres: height of the picture; ground: height of the floor.
    """

    def __init__(self, up: str, view: Floats, metres: float, ground: float, middle: float) -> None:
        self.up, self.view, self.metres, self.ground, self.middle = up, view, metres, ground, middle
        self.centre = np.zeros(3)

    def look_at(self, points: Floats) -> None:
        """Put the centre of these points (n, 3) in the middle of the picture; its height stays."""
        present = points[~np.isnan(points[:, 0])]
        if len(present):
            self.centre = present.mean(axis=0)
            self.centre["xyz".index(self.up)] = self.middle

    def seen(self, points: Floats) -> Floats:
        """Points (…, 3) from the centre: right, up, away (…, 3), metres."""
        return (points - self.centre) @ self.view.T

    def pixels(self, points: Floats) -> Floats:
        """Points (…, 3) as pixels (…, 2) of the large picture."""
        scale = FINEST * SIZE[1] / self.metres
        flat = self.seen(points)
        half = FINEST * np.array(SIZE) / 2
        return np.stack([half[0] + scale * flat[..., 0], half[1] - scale * flat[..., 1]], axis=-1)

    def grid(self) -> Floats:
        """Lines (n, 2, 2) of the ground, one metre apart (or a tenth or ten for small and large recordings), pixels."""
        spacing = 10.0 ** round(np.log10(self.metres) - 0.3)
        (right, back), height = views.level_axes(self.up), "xyz".index(self.up)
        ticks = np.arange(-8, 9) * spacing
        middle = np.round(self.centre / spacing) * spacing
        ends = np.empty((2 * len(ticks), 2, 3))
        ends[...] = middle
        ends[..., height] = self.ground
        ends[: len(ticks), :, right] = middle[right] + ticks[:, None]
        ends[: len(ticks), :, back] = middle[back] + ticks[[0, -1]]
        ends[len(ticks) :, :, back] = middle[back] + ticks[:, None]
        ends[len(ticks) :, :, right] = middle[right] + ticks[[0, -1]]
        return self.pixels(ends)


def camera_for(sample: Floats, up: str) -> Camera:
    """A camera that shows all of a sample (frames, points, 3) of a recording, each frame in the middle."""
    axis = "xyz".index(up)
    present = sample[~np.isnan(sample[..., 0])]
    if not len(present):
        return empty_camera(up)
    middle = (
        np.nanmean(np.where(np.isnan(sample), np.nan, sample), axis=1, keepdims=True) if sample.shape[1] else sample
    )
    level = np.delete(sample - middle, axis, axis=-1)
    low, high = np.percentile(present[:, axis], [0.5, 99.5])
    extent = max(high - low, np.nanpercentile(np.abs(level), 99), 1e-3)
    return Camera(up, views.directions(sample, up, TILT), 1.35 * float(extent), float(low), float((low + high) / 2))


def empty_camera(up: str) -> Camera:
    """A camera for frames without points."""
    return Camera(up, views.directions(np.zeros((0, 1, 3)), up, TILT), 2.0, 0.0, 0.0)


def new_picture(camera: Camera) -> tuple[Any, Any]:
    """An empty picture with the ground, and its drawing tool."""
    from PIL import Image, ImageDraw

    picture = Image.new("RGB", (FINEST * SIZE[0], FINEST * SIZE[1]), PAPER)
    pen = ImageDraw.Draw(picture)
    for line in camera.grid():
        pen.line([tuple(end) for end in line], fill=GRID, width=FINEST)
    return picture, pen


def finished(picture: Any, lines: list[str]) -> Any:
    """The picture at its size, with lines of text in the corner."""
    from PIL import ImageDraw, ImageFont

    small = picture.reduce(FINEST)
    pen = ImageDraw.Draw(small)
    for row, text in enumerate(lines):
        pen.text((24, 20 + 30 * row), text, fill=INK, font=ImageFont.load_default(22))
    return small


def motion_pictures(shown: Shown, original: Shown | None, step: int) -> Iterator[Any]:
    """A picture of every `step`-th frame of a motion."""
    about = shown.about
    assert isinstance(about, Motion)
    links = motion_links(shown, about)
    sample = np.concatenate([shown.positions(f, f + 1) for f in np.linspace(0, shown.frames - 1, 24).astype(int)])
    camera = camera_for(sample, about.up)
    facts = None if original is None else motion_errors(shown, original)
    scale = 1.0 if facts is None else shown.promise.get("max_error") or facts["max"] or 1.0
    radius = FINEST * 0.0065 * SIZE[1]
    for frame in range(0, shown.frames, step):
        points = shown.positions(frame, frame + 1)[0]
        camera.look_at(points)
        picture, pen = new_picture(camera)
        text = [shown.name, f"{frame / about.rate:.2f} s"]
        colours = np.repeat(RAMP[:1], about.points, axis=0)
        if original is not None:
            before = original.positions(frame, frame + 1)[0]
            error = metrics.distances(before[None], points[None])[0]
            colours = colours_of(error / scale)
            draw(pen, camera.pixels(before), links, np.full((about.points, 3), GHOST), 1.3 * radius)
            worst = "–" if np.isnan(error).all() else f"{1000 * np.nanmax(error):.2f} mm"
            text[1] += f"   largest error {worst}"
        draw(pen, camera.pixels(points), links, colours, radius)
        yield finished(picture, text)


def draw(pen: Any, pixels: Floats, links: list[list[int]], colours: Floats, radius: float) -> None:
    """Links and points in pixels (points, 2); colours (points, 3), 0 to 255; missing points are left out."""
    shown = ~np.isnan(pixels[:, 0])
    for a, b in links:
        if shown[a] and shown[b]:
            colour = tuple(np.round((colours[a] + colours[b]) / 2).astype(int).tolist())
            pen.line([tuple(pixels[a]), tuple(pixels[b])], fill=colour, width=max(1, round(0.9 * radius)))
    for (x, y), colour in zip(pixels[shown].tolist(), colours[shown].round().astype(int).tolist(), strict=True):
        pen.ellipse([x - radius, y - radius, x + radius, y + radius], fill=tuple(colour))


def colours_of(shares: Floats) -> Floats:
    """Colours (n, 3) of errors as shares of the scale; that of no error where they are NaN."""
    place = 2 * np.clip(np.nan_to_num(shares), 0.0, 1.0)
    return np.stack([np.interp(place, [0, 1, 2], RAMP[:, channel]) for channel in range(3)], axis=1)


def cloud_pictures(shown: Shown, step: int) -> Iterator[Any]:
    """A picture of every `step`-th frame of point clouds, near points over far ones."""
    first = shown.clouds(0, 1)
    camera: Camera | None = None
    for frame in range(0, shown.frames, step):
        clouds = shown.clouds(frame, frame + 1)
        points = np.asarray(clouds.positions[0])
        points = points[np.isfinite(points).all(axis=1)]
        if camera is None and len(points):
            camera = camera_for(points[None], first.up)
        camera_now = camera or empty_camera(first.up)
        camera_now.look_at(points)
        picture, _ = new_picture(camera_now)
        paint(picture, camera_now, points, None if clouds.colours is None else np.asarray(clouds.colours[0]))
        yield finished(picture, [shown.name, f"{frame / first.rate:.2f} s"])


def paint(picture: Any, camera: Camera, points: Floats, colours: Any) -> None:
    """Points (n, 3) as squares of three pixels, the far ones first."""
    from PIL import Image

    canvas = np.array(picture)
    order = np.argsort(-camera.seen(points)[:, 2])
    shades = np.full((len(points), 3), RAMP[0]) if colours is None or len(colours) != len(points) else colours
    column, row = np.round(camera.pixels(points[order])).astype(int).T
    for dx in range(-2, 3):
        for dy in range(-2, 3):
            x, y = column + dx, row + dy
            inside = (x >= 0) & (x < canvas.shape[1]) & (y >= 0) & (y < canvas.shape[0])
            canvas[y[inside], x[inside]] = shades[order][inside]
    picture.paste(Image.fromarray(canvas))
