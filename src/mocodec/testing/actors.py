"""Body models for synthetic point clouds: a skinned mesh with coloured clothes and baked lighting.

The joints have the names of CMU's BVH files. In the bind pose the body faces +z, y is up, lengths are in metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry import stock_body
from ..typing import Booleans, Floats, Integers


@dataclass(frozen=True, eq=False)
class Actor:
    """A skinned mesh. joints (j, 3): bind positions; vertices (v, 3); faces (f, 3): vertex indices; weights (v, j):
    skinning weights; colours (v, 3): 0 to 255. names and parents (−1: root) are those of the joints.
    """

    name: str
    names: tuple[str, ...]
    parents: tuple[int, ...]
    joints: Floats
    vertices: Floats
    faces: Integers
    weights: Floats
    colours: Floats

    def dressed(self, look: int) -> Actor:
        """The same body in other clothes; look: an index into CLOTHES_COLOURS."""
        return replace(self, colours=clothes(self.names, self.weights, self.vertices, self.faces, look))

    def scaled(self, factor: float) -> Actor:
        """The same body, `factor` times as large."""
        return replace(self, joints=self.joints * factor, vertices=self.vertices * factor)

    def posed(self, a: Floats, b: Floats) -> Floats:
        """Vertices (v, 3) after linear blend skinning; joint j maps bind position x to a[j] x + b[j]."""
        blend = self.weights @ np.concatenate([a.reshape(len(a), 9), b], axis=1)
        return np.einsum("vij,vj->vi", blend[:, :9].reshape(-1, 3, 3), self.vertices) + blend[:, 9:]


def capsules() -> Actor:
    """The stock body as a mesh: one capsule per bone, each vertex moved by a single joint."""
    stock = stock_body.joints()
    names = tuple(name for name in stock if not name.endswith("Tip"))
    parents = tuple(names.index(stock[name].parent) if stock[name].parent else -1 for name in names)
    vertices, faces, owner = list[Floats](), list[Integers](), list[int]()
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
) -> tuple[Floats, Integers]:
    """Vertices (v, 3) and faces (f, 3) of a capsule: two half spheres of radius `near` and `far`, joined by a cone."""
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


CLOTHES_COLOURS = (
    ([176.0, 40, 48], [228.0, 222, 205], [52.0, 66, 118]),
    ([40.0, 120, 70], [70.0, 160, 105], [96.0, 88, 80]),
    ([226.0, 178, 44], [60.0, 60, 66], [128.0, 52, 40]),
)
"""For each look: the two colours of the shirt's stripes and the colour of the trousers."""


def clothes(names: tuple[str, ...], weights: Floats, vertices: Floats, faces: Integers, look: int = 0) -> Floats:
    """Vertex colours (v, 3), 0 to 255: striped shirt, woven trousers, shoes, hair and skin, lit from above."""
    stripe_colour, shirt_colour, trouser_colour = CLOTHES_COLOURS[look % len(CLOTHES_COLOURS)]
    owner = np.array(names)[weights.argmax(axis=1)]
    x, y, z = vertices.T
    colours = np.tile([214.0, 168, 142], (len(vertices), 1))  # skin

    def belongs_to(*parts: str) -> Booleans:
        """Whether the name of the joint that moves a vertex contains one of these words."""
        return np.array([any(part in joint for part in parts) for joint in owner])

    shirt = belongs_to("Spine", "Shoulder", "LowerBack") | (owner == "LeftArm") | (owner == "RightArm")
    trousers = belongs_to("Hips", "UpLeg", "HipJoint") | (owner == "LeftLeg") | (owner == "RightLeg")
    stripe = (np.sin(y * 75) > 0)[:, None]
    colours[shirt] = np.where(stripe, stripe_colour, shirt_colour)[shirt]
    weave = 18 * np.sin(x * 90) * np.sin(y * 60) + 14 * np.sin(z * 70 + y * 20)
    colours[trousers] = (np.array(trouser_colour) + weave[:, None])[trousers]
    colours[belongs_to("Foot", "Toe")] = [46, 40, 38]
    top = vertices[:, 1].max()
    colours[belongs_to("Head") & ((y > top - 0.10) | (z < vertices[:, 2].mean() - 0.02))] = [72, 50, 34]
    normal = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    smooth = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(smooth, faces[:, corner], normal)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
    light = 0.62 + 0.38 * np.clip(smooth @ (np.array([0.4, 0.8, 0.45]) / 1.002), -0.4, 1)
    return np.clip(colours * light[:, None], 0, 255)
