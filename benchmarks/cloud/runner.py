"""Runs point cloud coders, ours and rivals, on synthetic sequences of people: `scripts/bench cloud`.

    scene ──► recorded PointClouds ──► encode ──► bytes ──► decode ──► compare with the original ──► CloudRecord
          └─► a second perfect sample of the same surface ───────────► compare with the original ──► its floor

Ratios count all bytes; ours are whole `.mocz` files. `ratio_1000` is the ratio for a sequence of 1,000 frames with the
same body model, header and index. Coders get the original without normals; D2 uses the true normals if the sequence
has them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from mocodec import __version__, api
from mocodec.codecs import CODECS, codec_class
from mocodec.errors import MocodecError
from mocodec.metrics import point_clouds, splats
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences
from mocodec.typing import Bytes

from .. import datasets
from . import makehuman, retarget
from .records import LONG, CloudRecord, Measured
from .rivals import RIVALS, CloudRival

POINTS = 10_000
RATE = 15.0
RESIDUALS = (0, 25, 100)
"""Residual settings of our codecs, in percent."""
CLIPS = ("01_01", "02_05", "03_03", "49_20", "118_30", "131_04", "salsa_09")


@dataclass(frozen=True, eq=False)
class Scene:
    """A performance and its kind of recording."""

    label: str
    perform: Callable[[], sequences.Performance]
    noise_m: float = 0.0
    rig: sequences.Rig | None = None
    points: int = POINTS

    def recorded(self, performance: sequences.Performance) -> PointClouds:
        """The recording to code; with true normals unless a camera rig records it."""
        normals = self.rig is None
        return sequences.record(performance, self.points, noise_m=self.noise_m, rig=self.rig, normals=normals)

    def second_sample(self, performance: sequences.Performance) -> PointClouds:
        """A second sample of the same surface without noise; with a rig, from the same cameras without errors."""
        ideal = None
        if self.rig is not None:
            ideal = replace(self.rig, noise_m=0.0, calibration_m=0.0, flying=0.0, holes=0.0)
        return sequences.record(performance, self.points, rig=ideal, seed=1)


@dataclass(frozen=True)
class Coding:
    """One coder at one setting. once: returns the number of a stream's bytes that do not grow with the frames."""

    coder: str
    setting: str
    ours: bool
    counted: str
    encode: Callable[[PointClouds, sequences.Performance], bytes]
    decode: Callable[[bytes], PointClouds]
    once: Callable[[bytes], int]
    version: Callable[[], str]


def our_codecs() -> list[str]:
    """Names of this package's codecs that decode to point clouds."""
    return [name for name in CODECS if get_type_hints(codec_class(name).decode).get("return") is PointClouds]


def coders() -> tuple[str, ...]:
    """Names of all coders, ours first."""
    return (*our_codecs(), *RIVALS)


def codings(names: Sequence[str], quick: bool = False) -> list[Coding]:
    """The settings of these coders to measure. quick: without the first setting of rivals with three."""
    result = list[Coding]()
    for name in names:
        if name in RIVALS:
            rival = RIVALS[name]
            knobs = rival.knobs if not quick or len(rival.knobs) < 3 else rival.knobs[1:]
            result += [rival_coding(rival, knob) for knob in knobs]
            continue
        options = {f.name for f in fields(codec_class(name))}
        settings: list[dict[str, Any]] = [{"residual": r} for r in RESIDUALS] if "residual" in options else [{}]
        result += [our_coding(name, setting) for setting in settings]
        if "skeleton" in options:
            result.append(our_coding(name, settings[0], with_skeleton=True))
    return result


def rival_coding(rival: CloudRival, knob: int) -> Coding:
    """A rival at one setting of its knob."""
    return Coding(
        rival.name,
        f"{rival.knob_name} {knob}",
        False,
        rival.counted,
        lambda clouds, _: rival.encode(clouds, knob),
        rival.decode,
        lambda _: 0,
        rival.version,
    )


def our_coding(name: str, settings: dict[str, Any], with_skeleton: bool = False) -> Coding:
    """One of our codecs. with_skeleton: it gets the true first pose instead of fitting one."""
    words = [f"{key} {value:g}{' %' if key == 'residual' else ''}" for key, value in settings.items()]

    def encode(clouds: PointClouds, performance: sequences.Performance) -> bytes:
        skeleton: dict[str, Any] = {"skeleton": performance.skeleton()[:1]} if with_skeleton else {}
        return api.encode(clouds, name, **settings, **skeleton)

    return Coding(
        name,
        ", ".join(words + ["first pose given"] * with_skeleton),
        True,
        "the whole .mocz: model of the body, poses, residuals, header, index",
        encode,
        lambda blob: api.decode(blob, PointClouds),
        once_bytes,
        lambda: __version__,
    )


def once_bytes(blob: bytes) -> int:
    """Bytes of a `.mocz` file that do not grow with the number of frames: all except its chunks."""
    with api.open(blob) as file:
        return len(blob) - sum(len(chunk.payload) for chunk in file.encoded.chunks)


def scenes(quick: bool) -> list[Scene]:
    """The sequences: jumping jacks; unless `quick`, also with noise and with a rig, turning, and CMU's clips."""
    actor = makehuman.find()
    frames = 20 if quick else 60

    def jumping_jacks() -> sequences.Performance:
        return sequences.jumping_jacks(actor, frames, RATE)

    def clip(path: Path) -> Callable[[], sequences.Performance]:
        return lambda: retarget.perform(actor, retarget.read_motion(path), RATE, frames=frames)

    result = [Scene("jumping jacks", jumping_jacks)]
    if quick:
        return result
    result += [
        Scene("jumping jacks, noise of 1 cm", jumping_jacks, noise_m=0.01),
        Scene("jumping jacks, ten depth cameras", jumping_jacks, rig=sequences.Rig()),
        Scene("turning", lambda: sequences.turning(actor, frames, RATE)),
    ]
    paths = [path for name in CLIPS if (path := retarget.clip_path(datasets.SHARED, name)) is not None]
    return result + [Scene(path.stem, clip(path)) for path in paths]


def run(chosen: Sequence[Scene], work: Sequence[Coding], measured_frames: int = 6) -> Iterator[Measured]:
    """Yields every coding of every scene, measured on `measured_frames` evenly spaced frames."""
    for scene in chosen:
        performance = scene.perform()
        original = scene.recorded(performance)
        count = min(measured_frames, len(original))
        frames = np.unique(np.linspace(0, len(original) - 1, count).round().astype(int)).tolist()
        floor = point_clouds.compare(original, scene.second_sample(performance), frames)
        middle = len(original) // 2
        for coding in work:
            record = CloudRecord(scene.label, coding.coder, coding.ours, coding.setting, len(original))
            record.points = float(np.mean([len(p) for p in original.positions]))
            record.actor, record.rate, record.floor = performance.actor.name, original.rate, floor
            decoded = measure(record, coding, performance, original, frames)
            image = None if decoded is None else two_sides(decoded, middle, original)
            yield Measured(record, two_sides(original, middle, original), image)


def measure(
    record: CloudRecord,
    coding: Coding,
    performance: sequences.Performance,
    original: PointClouds,
    frames: Sequence[int],
) -> PointClouds | None:
    """Encode, decode and compare these frames; write the results to the record and return the decoded clouds.

    If the coder fails or is not installed, the record's `problem` has the reason. Unexpected exceptions of our own
    codecs propagate, since they are bugs.
    """
    record.raw_bytes, record.counted = original.raw_bytes, coding.counted
    try:
        record.version = coding.version()
        started = time.perf_counter()
        data = coding.encode(replace(original, normals=None), performance)
        encoded = time.perf_counter()
        decoded = coding.decode(data)
        done = time.perf_counter()
    except MocodecError as error:
        record.problem = str(error)
        return None
    except Exception as error:
        if coding.ours:
            raise
        record.problem = f"{type(error).__name__}: {error}"
        return None
    record.bytes, record.once_bytes = len(data), coding.once(data)
    record.bytes_per_frame = len(data) / record.frames
    record.ratio = original.raw_bytes / len(data)
    moving = (len(data) - record.once_bytes) / record.frames
    record.ratio_1000 = original.raw_bytes / record.frames / (record.once_bytes / LONG + moving)
    record.decoded_points = float(np.mean([len(p) for p in decoded.positions]))
    record.quality = point_clouds.compare(original, decoded, frames)
    record.measured_frames = len(frames)
    record.encode_fps, record.decode_fps = record.frames / (encoded - started), record.frames / (done - encoded)
    return decoded


def two_sides(clouds: PointClouds, frame: int, like: PointClouds) -> Bytes:
    """Images of a frame from two opposite sides, one above the other, with the view of `like`."""
    return np.concatenate(splats.views(clouds, frame, like)[1::3])
