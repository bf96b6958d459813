"""Codecs and rivals × sequences → records: what `mocodec eval cloud` measures.

    sequence ─► record: PointClouds ──► encode ─► bytes ─► decode ─► compare ──► record
             └► a second perfect sample of the same surface ───────► compare ──► its floor

Every record says what its bytes hold and over how many frames. Ours are whole `.mocz` files: what is sent once (the
body's model, header, index) is in every ratio, and `ratio_1000` says what it would be were the sequence 1,000 frames
long. Originals are given to coders without normals; D2 is taken along the true ones where the sequence has them.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from ... import __version__, api, formats, plots
from ...codecs import CODECS, codec_class
from ...errors import BadInput, MissingExtra, MocodecError
from ...motion import Motion
from ...pointcloud import PointClouds
from .. import datasets, runner
from . import actors, measures, sequences, splats
from .rivals import RIVALS, Rival

POINTS = 10_000
RATE = 15.0
RESIDUALS = (0, 25, 100)  # percent, of codecs that have the setting
LONG = 1000  # frames that `ratio_1000` is for
CLIPS = (
    "cmu/asfamc/01/01_01.amc", "cmu/asfamc/02/02_05.amc", "cmu/asfamc/03/03_03.amc", "cmu/asfamc/49/49_20.amc",
    "cmu/asfamc/118/118_30.amc", "cmu/asfamc/131/131_04.amc", "cmu/bvh/salsa_09.bvh",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scene:
    """A performance as it is recorded, and a second perfect sample of the same surface."""

    label: str
    perform: Callable[[], sequences.Performance]
    noise_m: float = 0.0
    rig: sequences.Rig | None = None
    points: int = POINTS

    def recorded(self, performance: sequences.Performance) -> PointClouds:
        given = {"noise_m": self.noise_m, "rig": self.rig, "normals": self.rig is None}
        return sequences.record(performance, self.points, **given)

    def again(self, performance: sequences.Performance) -> PointClouds:
        """Other points of the same surface, without noise; of a rig, what the same cameras would see without errors."""
        clean = None
        if self.rig is not None:
            clean = replace(self.rig, noise_m=0.0, calibration_m=0.0, flying=0.0, holes=0.0)
        return sequences.record(performance, self.points, rig=clean, seed=1)


@dataclass
class Record:
    """What came out of one coder at one setting on one sequence. Lengths in metres, times in seconds.

    bytes: all, over `frames` frames. once_bytes: the part of them that does not grow with the frames. quality and
    floor: the measures of `measures.compare` against the original, of the decoded and of a second perfect sample,
    averaged over `measured_frames` frames.
    """

    sequence: str
    coder: str
    ours: bool
    setting: str
    frames: int
    actor: str = ""
    rate: float = 0.0
    points: float = 0.0
    raw_bytes: int = 0
    counted: str = ""
    bytes: int = 0
    once_bytes: int = 0
    bytes_per_frame: float = 0.0
    ratio: float = 0.0
    ratio_1000: float = 0.0
    decoded_points: float = 0.0
    measured_frames: int = 0
    quality: dict[str, float] = field(default_factory=dict)
    floor: dict[str, float] = field(default_factory=dict)
    encode_fps: float = 0.0
    decode_fps: float = 0.0
    version: str = ""
    problem: str = ""

    @property
    def label(self) -> str:
        return f"{self.coder} {self.setting}".strip()


class Measured(NamedTuple):
    """A record with what to look at beside it: the middle frame from two sides, original and decoded."""

    record: Record
    original: splats.Image
    decoded: splats.Image | None


@dataclass(frozen=True)
class Coding:
    """One coder at one setting: PointClouds → all bytes and how many of them are sent once; bytes → PointClouds."""

    coder: str
    setting: str
    ours: bool
    counted: str
    encode: Callable[[PointClouds, sequences.Performance], bytes]
    decode: Callable[[bytes], PointClouds]
    once: Callable[[bytes], int]
    version: Callable[[], str]


def our_codecs() -> list[str]:
    """The codecs of this package that give point clouds back."""
    return [name for name in CODECS if get_type_hints(codec_class(name).decode).get("return") is PointClouds]


def coders() -> tuple[str, ...]:
    """Every name that can be measured."""
    return (*our_codecs(), *RIVALS)


def codings(names: Sequence[str], quick: bool = False) -> list[Coding]:
    """What these coders are run at. quick: a rival's middle setting, or its only ones where there are two."""
    result = list[Coding]()
    for name in names:
        if name in RIVALS:
            rival = RIVALS[name]
            knobs = rival.knobs if not quick or len(rival.knobs) < 3 else rival.knobs[1:]
            result += [of_rival(rival, knob) for knob in knobs]
            continue
        has = {f.name for f in fields(codec_class(name))}
        settings: list[dict[str, Any]] = [{"residual": r} for r in RESIDUALS] if "residual" in has else [{}]
        result += [of_ours(name, chosen) for chosen in settings]
        if "skeleton" in has:
            result.append(of_ours(name, settings[0], skeleton=True))
    return result


def of_rival(rival: Rival, knob: int) -> Coding:
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


def of_ours(name: str, settings: dict[str, Any], skeleton: bool = False) -> Coding:
    """One of our codecs. skeleton: the true skeleton's first pose is given; it is fitted to the points otherwise."""
    words = [f"{key} {value:g}{' %' if key == 'residual' else ''}" for key, value in settings.items()]

    def encode(clouds: PointClouds, performance: sequences.Performance) -> bytes:
        given: dict[str, Any] = {"skeleton": performance.skeleton()[:1]} if skeleton else {}
        return api.encode(clouds, name, **settings, **given)

    def once(blob: bytes) -> int:
        with api.open(blob) as f:
            return len(blob) - sum(len(chunk.payload) for chunk in f.encoded.chunks)

    return Coding(
        name,
        ", ".join(words + ["first pose given"] * skeleton),
        True,
        "the whole .mocz: model of the body, poses, residuals, header, index",
        encode,
        lambda blob: api.decode(blob, PointClouds),
        once,
        lambda: __version__,
    )


def scenes(quick: bool) -> list[Scene]:
    """The sequences to measure on: jumping jacks alone, or all, with noise, a rig of cameras and CMU's clips."""
    actor = actors.find()
    frames = 20 if quick else 60
    jacks = lambda: sequences.jumping_jacks(actor, frames, RATE)  # noqa: E731
    chosen = [Scene("jumping jacks", jacks)]
    if quick:
        return chosen
    chosen += [
        Scene("jumping jacks, noise of 1 cm", jacks, noise_m=0.01),
        Scene("jumping jacks, ten depth cameras", jacks, rig=sequences.Rig()),
        Scene("turning", lambda: sequences.turning(actor, frames, RATE)),
    ]
    for path in (datasets.SHARED / clip for clip in CLIPS):
        if path.is_file():
            chosen.append(Scene(path.stem, lambda path=path: _performed(actor, path, frames)))
    return chosen


def _performed(actor: actors.Actor, path: Path, frames: int) -> sequences.Performance:
    motion = api.read(path)
    if not isinstance(motion, Motion):
        raise BadInput(f"{path} holds point clouds, not motion")
    return sequences.perform(actor, motion, RATE, frames=frames)


def run(chosen: Sequence[Scene], work: Sequence[Coding], measured: int = 6) -> Iterator[Measured]:
    """Each coding of each scene, measured on this many frames spread over it."""
    for scene in chosen:
        performance = scene.perform()
        original = scene.recorded(performance)
        at = np.unique(np.linspace(0, len(original) - 1, min(measured, len(original))).round().astype(int)).tolist()
        floor = measures.compare(original, scene.again(performance), at)
        for coding in work:
            record = Record(scene.label, coding.coder, coding.ours, coding.setting, len(original))
            record.points = float(np.mean([len(p) for p in original.positions]))
            record.actor, record.rate, record.floor = performance.actor.name, original.rate, floor
            decoded = measure(record, coding, performance, original, at)
            middle = len(original) // 2
            seen = None if decoded is None else sides(decoded, middle, original)
            yield Measured(record, sides(original, middle, original), seen)


def measure(
    record: Record, coding: Coding, performance: sequences.Performance, original: PointClouds, at: Sequence[int]
) -> PointClouds | None:
    """Encode, decode, compare, into the record; the decoded.

    What a coder cannot do, or is not installed to do, is the record's `problem`.
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
    except Exception as error:  # a rival's own failure is a result; one of ours is a fault that must be seen
        if coding.ours:
            raise
        record.problem = f"{type(error).__name__}: {error}"
        return None
    record.bytes, record.once_bytes = len(data), coding.once(data)
    record.bytes_per_frame = len(data) / record.frames
    record.ratio = original.raw_bytes / len(data)
    running = (len(data) - record.once_bytes) / record.frames
    record.ratio_1000 = original.raw_bytes / record.frames / (record.once_bytes / LONG + running)
    record.decoded_points = float(np.mean([len(p) for p in decoded.positions]))
    record.quality = measures.compare(original, decoded, at)
    record.measured_frames = len(at)
    record.encode_fps, record.decode_fps = record.frames / (encoded - started), record.frames / (done - encoded)
    return decoded


def sides(clouds: PointClouds, frame: int, like: PointClouds) -> splats.Image:
    """A frame from two sides, one above the other."""
    return np.concatenate(splats.views(clouds, frame, like)[1::3])


def write(folder: Path, measured: Sequence[Measured]) -> list[Path]:
    """DIR/cloud.json, DIR/cloud.md and, where matplotlib is installed, DIR/cloud.png and DIR/cloud_views.png.

    Returns what was written.
    """
    from . import report

    records, machine = [m.record for m in measured], runner.machine()
    content = {"machine": machine, "peak_m": measures.PEAK_M, "records": [asdict(r) for r in records]}
    paths = [folder / "cloud.json", folder / "cloud.md"]
    formats.replace_whole(paths[0], (json.dumps(rounded(content), indent=1) + "\n").encode())
    formats.replace_whole(paths[1], report.markdown(records, machine).encode())
    with contextlib.suppress(MissingExtra):
        for name, picture in (("cloud.png", report.picture(records)), ("cloud_views.png", report.views(measured))):
            plots.save(picture, folder / name)
            paths.append(folder / name)
    return paths


def rounded(value: Any) -> Any:
    """Numbers with six digits: what a table or a reader can use."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: rounded(v) for key, v in value.items()}
    return [rounded(v) for v in value] if isinstance(value, list) else value
