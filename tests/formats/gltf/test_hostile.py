"""GLB files that contradict themselves or ask for far more than they contain: refused by one line, at once."""

from __future__ import annotations

import re

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion
from mocodec.formats import gltf
from mocodec.testing import corruption, synthetic

from .build import Build, about, leg, packed

TIMES = np.arange(30) / 30
PATH = np.stack([0.3 * TIMES, np.ones(30), 0 * TIMES], axis=1)


def chain(count: int) -> list[dict]:
    return [{"children": [i + 1]} for i in range(count - 1)] + [{}]


def moved(nodes: list[dict], times=TIMES, path=PATH) -> Build:
    return Build(nodes).animation().move(0, "translation", times, path)


@pytest.mark.parametrize(
    ("build", "problem"),
    [
        (moved(leg(), [0.0, 16_777_200.0], PATH[:2]), "too many: give a lower rate"),
        (moved(leg(), [0.0, 1e-30, 2e-30], PATH[:3]), "usable rate"),
        (moved(chain(40_000)), "no skeleton"),
        (moved([{"children": list(range(1, 40_000))}] + [{}] * 39_999), "no skeleton"),
        (moved([{"children": [1]}, {"children": [2]}, {"children": [1]}]), "do not form a tree"),
        (moved([{}, {"children": [2]}, {"children": [1]}]), "do not form a tree"),
        (moved([{"children": [2]}, {"children": [2]}, {}]), "do not form a tree"),
        (moved([{"children": [0]}]), "do not form a tree"),
        (moved([{"children": [7]}]), "do not form a tree"),
        (moved(leg(), TIMES[::-1], PATH), "do not increase"),
        (moved(leg(), TIMES[:5], PATH), "accessor 1 has 30"),
        (moved(leg(hip={"rotation": [0, 0, 0, 0]})), "zero rotation"),
        (moved(leg(hip={"rotation": [0, 0, 1e300, 1]})), "not finite"),
        (moved(leg(hip={"translation": [0, 1e300, 1]})), "not finite"),
        (moved(leg(hip={"scale": [1e9] * 3}, thigh={"scale": [1e9] * 3})), "its joints are beyond"),
        (moved(leg(), TIMES, PATH * 1e30), "beyond 1e+12"),
        (moved(leg(hip={"matrix": [0.0] * 16})), "cannot be inverted"),
        (moved(leg()).move(0, "rotation", TIMES, np.zeros((30, 4))), "a rotation of length zero"),
        (moved(leg()).move(0, "rotation", TIMES, about("x", TIMES), "CUBIC"), "CUBIC does not exist"),
        (Build(leg()), "no animation"),
        (Build(leg()).animation(), "moves no node"),
    ],
)
def test_one_line(tmp_path, build, problem):
    build.glb(tmp_path / "x.glb")
    with pytest.raises(BadInput, match=re.escape(problem)) as error:
        mc.read(tmp_path / "x.glb")
    assert str(error.value).startswith(str(tmp_path))
    assert "\n" not in str(error.value)


def test_a_skin_that_nothing_moves_gives_way_to_the_nodes_that_move(tmp_path):
    build = Build([*leg(), {}], [{"joints": [4]}]).animation().move(0, "translation", TIMES, PATH)
    assert gltf.read(build.glb(tmp_path / "x.glb")).names == ("hip", "thigh", "shin", "foot")
    with pytest.raises(BadInput, match="moves none of the joints"):
        gltf.read(tmp_path / "x.glb", skin=0)


@pytest.mark.parametrize("count", [31, 10**9, 10**30, -1, 0])
def test_counts_against_bytes(tmp_path, count):
    for accessor in (0, 1):
        build = moved(leg())
        build.json["accessors"][accessor]["count"] = count
        with pytest.raises(BadInput):
            gltf.read(build.glb(tmp_path / "x.glb"))


def test_accessors_without_bytes(tmp_path):
    """Zeros need no bytes: thousands of such accessors would ask for gigabytes."""
    times = np.arange(100_000) / 100
    build = Build(chain(4000)).animation()
    at = build.accessor(times)
    for node in range(4000):
        build.move(node, "translation", at, build.accessor(np.zeros((1, 3)), bufferView=0))
        build.json["accessors"][-1]["count"] = len(times)
        del build.json["accessors"][-1]["bufferView"]
    with pytest.raises(BadInput, match=r"make .* numbers out of|too many"):
        gltf.read(build.glb(tmp_path / "x.glb"))


def test_a_sparse_accessor_with_wrong_places(tmp_path):
    for places, count in (([30], 1), ([1], 31), ([1], 0), ([1, 2, 3], 10**9)):
        build = moved(leg())
        indices = build.view(np.array(places, "<u2").tobytes())
        values = build.view(np.zeros((len(places), 3), "<f4").tobytes())
        sparse = {
            "count": count,
            "indices": {"bufferView": indices, "componentType": 5123},
            "values": {"bufferView": values},
        }
        build.move(1, "translation", TIMES, build.accessor(PATH, sparse=sparse))
        with pytest.raises(BadInput):
            gltf.read(build.glb(tmp_path / "x.glb"))


@pytest.mark.parametrize(
    "content", [{}, {"asset": []}, {"asset": {"version": "1.0"}}, {"asset": {}, "nodes": 3}, [], 7]
)
def test_json_of_another_shape(tmp_path, content):
    (tmp_path / "x.glb").write_bytes(packed(content, b""))
    with pytest.raises(BadInput):
        mc.read(tmp_path / "x.glb")
    (tmp_path / "x.gltf").write_bytes(packed(content, b"")[20:40].rstrip(b"\0"))
    with pytest.raises(BadInput):
        mc.read(tmp_path / "x.gltf")


def test_damage_of_a_text_gltf(tmp_path):
    gltf.write(tmp_path / "walk.gltf", synthetic.joints(frames=3, seed=3))
    data = (tmp_path / "walk.gltf").read_bytes()
    path = tmp_path / "x.gltf"
    for bad in (*corruption.prefixes(data, every=397), *corruption.damaged(data, 150, seed=2)):
        path.write_bytes(bad)
        try:
            motion = mc.read(path)
        except BadInput:
            continue
        assert isinstance(motion, Motion)
