"""Clouds with other content than one person, within a bound, against a reference octree: `scripts/bench cloud-objects`.

    scene ─┬─ bodycast, max_error so that D1 is 2 or 0.5 mm ─► whole file
           ├─ its points without bodies: with references between frames, and each frame alone
           └─ the yardstick, an octree of each frame alone ─► bytes at equal D1

Also the cost of an object beside a body: (person and chair − person) / chair alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import api, formats
from mocodec.codecs.bodycast import Bodycast, lattice
from mocodec.codecs.bodycast.chunk_payload import unpack_chunk
from mocodec.codecs.bodycast.point_encoder import PointEncoder
from mocodec.codecs.bodycast.point_layer import split_references
from mocodec.codecs.bodycast.point_scene import ChunkBodies
from mocodec.codecs.bodycast.reference_points import Reference
from mocodec.encoded import Encoded
from mocodec.errors import BadInput
from mocodec.metrics import point_clouds
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences
from mocodec.typing import Floats

from .. import markdown as md
from ..machine import machine_description, measured_on
from ..progress import progress
from ..results import read_json, rounded, write_json
from . import makehuman, objects, octree_yardstick

D1_MM = (2.0, 0.5)
BRACKET = (0.9, 1.1)  # yardstick steps, relative to the step with the expected D1
LIMIT = 1.1  # largest accepted ratio to the yardstick's bytes


@dataclass
class SceneResult:
    """A scene at one D1. Bits are per point of the recording. bodies: found and used; referring: frames with
    references; hiding: frames without their bodies; alone_bits: without bodies; apart_bits: also without references.
    """

    scene: str
    d1_mm: float
    frames: int
    points: float
    bodies: int
    bytes: int
    bits: float
    alone_bits: float
    apart_bits: float
    yardstick_bits: float
    referring: int
    hiding: int


@dataclass
class ThingResult:
    """Bits per point of a chair, beside a person with given first pose and alone, at one D1."""

    d1_mm: float
    beside_bits: float
    alone_bits: float


def measure(scene: str, clouds: PointClouds, d1_mm: float) -> SceneResult:
    """Measures a scene at one D1. Raises BadInput for a broken promise."""
    bound = d1_mm / 1000 / lattice.RMS_PER_BOUND
    blob = api.encode(clouds, Bodycast(max_error=bound))
    decoded = api.decode(blob, PointClouds)
    if point_clouds.errors(clouds, decoded).max_error > bound:
        raise BadInput(f"{scene}: a promise of {1000 * bound:g} mm is broken")
    with api.open(blob) as file:
        encoded = file.encoded
    points = sum(map(len, clouds.positions))
    own_d1 = _mean_d1(clouds, decoded)
    references = _references(encoded)
    return SceneResult(
        scene, d1_mm, len(clouds), points / len(clouds), len(encoded.shared), len(blob), 8 * len(blob) / points,
        8 * _alone(clouds, bound, len(clouds)) / points, 8 * _alone(clouds, bound, 1) / points,
        8 * yardstick_bytes(clouds, own_d1) / points,
        sum(r.frames > 0 for r in references), sum(r.hides_bodies for r in references),
    )  # fmt: skip


def _references(encoded: Encoded[Any]) -> list[Reference]:
    """The reference of each frame."""
    found = list[Reference]()
    for chunk in encoded.chunks:
        part = unpack_chunk(chunk, len(encoded.shared)).exact_points
        found += split_references(part, chunk.frames)[1]
    return found


def _mean_d1(clouds: PointClouds, decoded: PointClouds) -> float:
    """Mean D1 over the frames with points, metres."""
    filled = [k for k, p in enumerate(clouds.positions) if len(p)]
    return float(np.mean([point_clouds.d1(clouds, decoded, k) for k in filled]))


def _alone(clouds: PointClouds, bound: float, chunk_frames: int) -> int:
    """Bytes of the points, coded without bodies."""
    frames = [(np.asarray(p), None) for p in clouds.positions]
    spans = [slice(s, min(s + chunk_frames, len(frames))) for s in range(0, len(frames), chunk_frames)]
    nobody = [ChunkBodies.nobody(s.stop - s.start) for s in spans]
    return sum(map(len, PointEncoder(frames, spans, nobody, False).coded(bound)))


def yardstick_bytes(clouds: PointClouds, d1_m: float) -> float:
    """Bytes of the yardstick at this D1, interpolated logarithmically between two steps."""
    d1, size = list[float](), list[int]()
    for factor in BRACKET:
        step = 2 * d1_m * factor
        of_grid = [octree_yardstick.decoded(np.asarray(p), step) for p in clouds.positions]
        d1.append(_mean_d1(clouds, PointClouds(of_grid, clouds.rate)))
        size.append(sum(octree_yardstick.frame_bytes(np.asarray(p), step) for p in clouds.positions))
    slope = (size[1] - size[0]) / np.log(d1[1] / d1[0])
    return float(size[0] + slope * np.log(d1_m / d1[0]))


def measure_thing(frames: int, d1_mm: float) -> ThingResult:
    """Measures the cost of a chair beside a person."""
    bound, actor = d1_mm / 1000 / lattice.RMS_PER_BOUND, makehuman.find()
    performance = sequences.jumping_jacks(actor, frames, objects.RATE)
    scene = objects.person_and_chair(actor, frames)
    chairs = [np.asarray(p)[objects.PERSON_POINTS :] for p in scene.positions]
    person = [np.asarray(p)[: objects.PERSON_POINTS] for p in scene.positions]
    codec = Bodycast(max_error=bound, skeleton=performance.skeleton()[:1], people=1)

    def payload(positions: Sequence[Floats]) -> int:
        return codec.encode(PointClouds(positions, objects.RATE, up="y")).payload_bytes

    points = sum(map(len, chairs))
    beside = payload([np.asarray(p) for p in scene.positions]) - payload(person)
    alone = _alone(PointClouds(chairs, objects.RATE, up="y"), bound, frames)
    return ThingResult(d1_mm, 8 * beside / points, 8 * alone / points)


def write_tables(folder: Path) -> Path:
    """Write cloud_objects.md from cloud_objects.json; return its path."""
    content = read_json(folder / "cloud_objects.json")
    scenes = [SceneResult(**record) for record in content["scenes"]]
    things = [ThingResult(**record) for record in content["things"]]
    parts = [
        "# Clouds that are not one person alone\n",
        f"Bits a point at equal D1. {measured_on(content['machine'])} Made by `scripts/bench cloud-objects`.\n",
        "*Whole file*: bodycast with a bound, all bytes. *Without bodies*: its points alone, which refer to earlier "
        "frames of the chunk. *Frame by frame*: the same, each frame by itself. *Yardstick*: an octree of each frame, "
        "with the neighbours that G-PCC's octree uses as contexts. *Referring*, *without*: frames that refer to "
        "earlier ones, and that are coded without their bodies.\n",
        md.table(
            ["scene", "D1 mm", "points", "bodies", "whole file", "without bodies", "frame by frame", "yardstick",
             "file / yardstick", "referring", "without"],
            [
                [r.scene, f"{r.d1_mm:g}", f"{r.points:,.0f}", r.bodies, f"{r.bits:.2f}", f"{r.alone_bits:.2f}",
                 f"{r.apart_bits:.2f}", f"{r.yardstick_bits:.2f}", f"{r.bits / r.yardstick_bits:.2f}",
                 f"{r.referring} of {r.frames}", r.hiding]
                for r in scenes
            ],
        ),
        "\nThe price of a chair beside a tracked person, and alone:\n",
        md.table(
            ["D1 mm", "beside", "alone", "ratio"],
            [
                [f"{t.d1_mm:g}", f"{t.beside_bits:.2f}", f"{t.alone_bits:.2f}", f"{t.beside_bits / t.alone_bits:.2f}"]
                for t in things
            ],
        ),
    ]  # fmt: skip
    formats.replace_whole(folder / "cloud_objects.md", ("\n".join(parts) + "\n").encode())
    return folder / "cloud_objects.md"


def _stored(path: Path, measured: Sequence[str]) -> tuple[list[SceneResult], list[ThingResult]]:
    """Stored results, without the scenes that are measured again."""
    content = read_json(path)
    scenes = [SceneResult(**record) for record in content["scenes"] if record["scene"] not in measured]
    return scenes, [ThingResult(**record) for record in content["things"]]


@click.command("cloud-objects")
@click.option("-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Result folder.")
@click.option("--frames", default=24, show_default=True, type=click.IntRange(6), help="Frames of every scene.")
@click.option(
    "--scene",
    "chosen",
    multiple=True,
    type=click.Choice(list(objects.SCENES)),
    help="Only this scene; stored results of others stay.",
)
def command(output: Path, frames: int, chosen: tuple[str, ...]) -> None:
    """Measure points within a bound on props, a dog, a robe, two people, empty frames and a lost track, against an
    octree of each frame by itself at equal D1.

    Takes about six minutes of one core. Writes cloud_objects.json and .md.
    """
    output.mkdir(parents=True, exist_ok=True)
    names, path = chosen or tuple(objects.SCENES), output / "cloud_objects.json"
    scenes, things = _stored(path, chosen) if chosen and path.exists() else ([], [])
    thing_d1_mm = () if things else D1_MM

    def write() -> None:
        scenes.sort(key=lambda r: list(objects.SCENES).index(r.scene))
        records = {"scenes": list(map(asdict, scenes)), "things": list(map(asdict, things))}
        write_json(path, rounded({"machine": machine_description(), **records}))

    with progress(len(names) * len(D1_MM) + len(thing_d1_mm)) as advance:
        for name in names:
            clouds = objects.SCENES[name](makehuman.find(), frames)
            for d1_mm in D1_MM:
                scenes.append(measure(name, clouds, d1_mm))
                advance(f"{name}, D1 {d1_mm:g} mm")
                write()
        for d1_mm in thing_d1_mm:
            things.append(measure_thing(frames, d1_mm))
            advance(f"chair beside a person, D1 {d1_mm:g} mm")
            write()
    click.echo(write_tables(output))
