"""Synthetic point clouds of people in motion, with the true skeleton.

    jumping_jacks, turning ──► Performance ──moved──► several people in one scene ──► record ──► PointClouds
                                    └──► skeleton(): the true joints as a Motion

    record: fresh random points on the posed mesh in each frame ──► visibility and errors of a camera rig
            ──► a share of the points removed ──► noise

The seed decides everything: a frame has the same points whichever frames are recorded with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry import articulation
from ..motion import Motion, Skeleton
from ..pointcloud import PointClouds
from ..typing import Booleans, Bytes, Floats
from .actors import Actor


@dataclass(frozen=True, eq=False)
class Performance:
    """An actor in motion. turns (frames, joints, 3, 3): world rotations of the joints relative to the bind pose;
    root (frames, 3): positions of the root joint, metres; rate: frames a second.
    """

    actor: Actor
    turns: Floats
    root: Floats
    rate: float

    def __len__(self) -> int:
        return len(self.turns)

    def transforms(self, frame: int) -> tuple[Floats, Floats]:
        """Rotations a (joints, 3, 3) and translations b (joints, 3): joint j moves bind position x to a[j] x + b[j]."""
        a, joints = self.turns[frame], self.joints[frame]
        return a, joints - np.einsum("jik,jk->ji", a, self.actor.joints)

    @property
    def joints(self) -> Floats:
        """True positions of the joints, (frames, joints, 3), metres."""
        places = np.empty((len(self), len(self.actor.names), 3))
        for joint, parent in enumerate(self.actor.parents):
            offset = self.actor.joints[joint] - self.actor.joints[max(parent, 0)]
            places[:, joint] = self.root if parent < 0 else places[:, parent] + self.turns[:, parent] @ offset
        return places

    def moved(self, place: Floats | Sequence[float] = (0.0, 0.0, 0.0), heading: float = 0.0) -> Performance:
        """A copy elsewhere: turned by `heading` radians about the y axis, then moved by `place` (3,), metres."""
        turn = articulation.exp(np.array([0.0, heading, 0.0]))
        return replace(self, turns=turn @ self.turns, root=self.root @ turn.T + np.asarray(place, float))

    def joint_errors(self, body: articulation.Body, pose: articulation.Pose, frame: int) -> Floats:
        """Distances of a tracked body's joints from the true ones of the same names, (links,), metres."""
        column = [self.actor.names.index(name) for name in body.names]
        tracked = articulation.joint_positions(body, *articulation.transforms(body, pose))
        return np.linalg.norm(tracked - self.joints[frame][column], axis=1)

    def skeleton(self) -> Motion:
        """The true skeleton and its rotations as a Motion, which can be written as BVH."""
        order = articulation.depth_first_order(self.actor.parents)
        above = [self.actor.parents[joint] for joint in order]
        names = tuple(self.actor.names[joint] for joint in order)
        offsets = np.array(
            [
                self.actor.joints[j] - self.actor.joints[p] if p >= 0 else np.zeros(3)
                for j, p in zip(order, above, strict=True)
            ]
        )
        local = [
            self.turns[:, j] if p < 0 else self.turns[:, p].transpose(0, 2, 1) @ self.turns[:, j]
            for j, p in zip(order, above, strict=True)
        ]
        rotations = articulation.quaternions(np.stack(local, axis=1))
        skeleton = Skeleton(names, tuple(order.index(p) if p >= 0 else -1 for p in above), offsets)
        return Motion(self.joints[:, order], self.rate, names, up="y", skeleton=skeleton, rotations=rotations)


def jumping_jacks(actor: Actor, frames: int = 60, rate: float = 15.0, period: float = 1.2) -> Performance:
    """Jumping jacks with a slow turn of the whole body. period: seconds a jump."""
    phase = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(frames) / rate / period)
    angles = np.zeros((frames, len(actor.names), 3))
    side = {"Left": 1.0, "Right": -1.0}
    for name, sign in side.items():
        angles[:, actor.names.index(f"{name}Arm"), 2] = sign * (-0.5 + 2.1 * phase)
        angles[:, actor.names.index(f"{name}ForeArm"), 2] = sign * 0.5 * phase
        angles[:, actor.names.index(f"{name}UpLeg"), 2] = sign * 0.42 * phase
        angles[:, actor.names.index(f"{name}Foot"), 2] = -sign * 0.25 * phase
    angles[:, actor.names.index("Spine"), 0] = 0.15 * np.sin(2 * np.pi * phase)
    angles[:, 0, 1] = 0.4 * np.sin(2 * np.pi * np.arange(frames) / rate / 4.1)
    drop = 0.04 * phase - 0.05 * np.abs(np.sin(2 * np.pi * np.arange(frames) / rate / period))
    root = actor.joints[0] + np.stack([np.zeros(frames), -drop, np.zeros(frames)], -1)
    return Performance(actor, _world_rotations(actor, articulation.exp(angles)), root, rate)


def turning(actor: Actor, frames: int = 60, rate: float = 15.0, seconds: float = 4.0) -> Performance:
    """A full turn on the spot within `seconds`, arms and legs swinging; like "turn" of Lien and Bajcsy (2006)."""
    time = np.arange(frames) / rate
    angles = np.zeros((frames, len(actor.names), 3))
    for name, sign in {"Left": 1.0, "Right": -1.0}.items():
        angles[:, actor.names.index(f"{name}Arm"), 0] = 0.6 * sign * np.sin(2 * np.pi * time / 1.3)
        angles[:, actor.names.index(f"{name}ForeArm"), 0] = -0.4 + 0.3 * sign * np.sin(2 * np.pi * time / 1.3)
        angles[:, actor.names.index(f"{name}UpLeg"), 0] = -0.35 * sign * np.sin(2 * np.pi * time / 1.3)
        angles[:, actor.names.index(f"{name}Leg"), 0] = 0.35 + 0.3 * sign * np.sin(2 * np.pi * time / 1.3 + 0.6)
    angles[:, 0, 1] = 2 * np.pi * time / seconds
    root = np.tile(actor.joints[0], (frames, 1))
    return Performance(actor, _world_rotations(actor, articulation.exp(angles)), root, rate)


def sitting(actor: Actor, frames: int = 60, rate: float = 15.0) -> Performance:
    """A seated person: thighs level, shins down, hands on the thighs; the trunk leans forward and back."""
    time = np.arange(frames) / rate
    angles = np.zeros((frames, len(actor.names), 3))
    for name, sign in {"Left": 1.0, "Right": -1.0}.items():
        angles[:, actor.names.index(f"{name}UpLeg"), 0] = -1.5
        angles[:, actor.names.index(f"{name}Leg"), 0] = 1.5
        angles[:, actor.names.index(f"{name}Arm"), 2] = -1.2 * sign
        angles[:, actor.names.index(f"{name}ForeArm"), 1] = -1.1 * sign
    angles[:, actor.names.index("Spine"), 0] = 0.15 * np.sin(2 * np.pi * time / 2.0)
    knee, ankle = (actor.joints[actor.names.index(name), 1] for name in ("LeftLeg", "LeftFoot"))
    root = np.tile(actor.joints[0] - [0.0, actor.joints[0, 1] - (knee - ankle) - ankle - 0.08, 0.0], (frames, 1))
    return Performance(actor, _world_rotations(actor, articulation.exp(angles)), root, rate)


def chair(points: int = 2000, seed: int = 0) -> tuple[Floats, Bytes]:
    """Random points (n, 3) and colours of a chair at the origin: a seat, a back behind it (z < 0) and four legs."""
    rng = np.random.default_rng(seed)
    boxes = [((-0.22, 0.42, -0.2), (0.22, 0.45, 0.22)), ((-0.22, 0.45, -0.22), (0.22, 0.9, -0.19))]
    boxes += [((x, 0.0, z), (x + 0.03, 0.42, z + 0.03)) for x in (-0.22, 0.19) for z in (-0.22, 0.19)]
    volume = np.array([np.prod(np.subtract(high, low)) for low, high in boxes])
    chosen = rng.choice(len(boxes), points, p=volume / volume.sum())
    low, high = (np.array([box[k] for box in boxes])[chosen] for k in (0, 1))
    wood = np.array([120, 80, 40]) + rng.integers(-10, 11, (points, 1))
    return rng.uniform(low, high), wood.astype(np.uint8)


def pair(actor: Actor, frames: int = 60, rate: float = 15.0, apart: float = 1.1) -> tuple[Performance, Performance]:
    """Two people `apart` metres from each other: one does jumping jacks, one turns on the spot in other clothes."""
    jumper = jumping_jacks(actor, frames, rate)
    turner = turning(actor.dressed(1), frames, rate)
    return jumper.moved((-apart / 2, 0, 0)), turner.moved((apart / 2, 0, 0))


def _world_rotations(actor: Actor, turns: Floats) -> Floats:
    """Rotations relative to the parent joints, (frames, joints, 3, 3), as world rotations."""
    world = turns.copy()
    for joint, parent in enumerate(actor.parents):
        if parent >= 0:
            world[:, joint] = world[:, parent] @ turns[:, joint]
    return world


@dataclass(frozen=True)
class Rig:
    """Depth cameras in a circle around the scene, like the ten camera clusters of Lien and Bajcsy (2006), figure 1.

    cameras: their number, spread evenly over `span` degrees. noise_m: standard deviation of the depth at 2.5 m; it
    grows with the square of the distance. calibration_m: offset of each camera's points from their true place. flying:
    share of points smeared along the ray, at silhouettes. holes: share of each view without depth. blur: exposure as a
    share of the time between frames; a point is where the surface was at a random time within it. dark: joints around
    which no camera measures depth, within `dark_m` metres, as of dark hair or cloth.
    """

    cameras: int = 10
    span: float = 360.0
    noise_m: float = 0.004
    calibration_m: float = 0.007
    flying: float = 0.02
    holes: float = 0.03
    blur: float = 0.0
    dark: tuple[str, ...] = ()
    dark_m: float = 0.14


def record(
    performance: Performance | Sequence[Performance],
    points: int = 10_000,
    *,
    keep: float = 1.0,
    noise_m: float = 0.0,
    views: int = 0,
    rig: Rig | None = None,
    normals: bool = False,
    seed: int = 0,
) -> PointClouds:
    """Point clouds of one performance, or of several people in one scene (as long as the shortest performance).

    points: random points per frame and person, uniform over the surface, new in each frame. keep: share of them that
    is kept. noise_m: standard deviation of Gaussian noise on each coordinate. views: number of ideal cameras whose
    visible points are recorded (0: all points). rig: cameras with errors, in place of `views`. normals: also give the
    true normals.
    """
    positions, colours, true_normals = list[Floats](), list[Bytes](), list[Floats]()
    people = (performance,) if isinstance(performance, Performance) else tuple(performance)
    total = points * len(people)
    for frame in range(min(map(len, people))):
        rng = np.random.default_rng([seed, frame])
        surfaces = [_sample_person(person, frame, points * (6 if views or rig else 1), rig, rng) for person in people]
        x, c, n = (np.concatenate(part) for part in zip(*surfaces, strict=True))
        middle = np.mean([person.root[frame] for person in people], axis=0)
        if rig is not None:
            x, c, n = visible_points(x, c, n, rig, middle, np.random.default_rng(seed), rng)
        elif views:
            ideal = Rig(cameras=views, noise_m=0, calibration_m=0, flying=0, holes=0)
            x, c, n = visible_points(x, c, n, ideal, middle, np.random.default_rng(seed), rng)
        if len(x) > total:
            chosen = rng.choice(len(x), total, replace=False)
            x, c, n = x[chosen], c[chosen], n[chosen]
        if keep < 1:
            chosen = rng.random(len(x)) < keep
            x, c, n = x[chosen], c[chosen], n[chosen]
        positions.append((x + noise_m * rng.normal(size=x.shape)).astype(np.float32).astype(np.float64))
        colours.append(np.rint(c).astype(np.uint8))
        true_normals.append(n)
    return PointClouds(positions, people[0].rate, colours, true_normals if normals else None, up="y")


def _sample_person(
    person: Performance, frame: int, points: int, rig: Rig | None, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Random points of a person with the blur of a rig's exposure, and without those at dark places."""
    vertices = person.actor.posed(*person.transforms(frame))
    if rig is None or not (rig.blur or rig.dark):
        return sample_surface(person.actor, vertices, points, rng)
    before = person.actor.posed(*person.transforms(max(frame - 1, 0)))
    x, c, n = sample_surface(person.actor, vertices, points, rng, rig.blur * (before - vertices))
    dark = person.joints[frame][[person.actor.names.index(name) for name in rig.dark]]
    seen = (np.linalg.norm(x[:, None] - dark, axis=2) > rig.dark_m).all(axis=1)
    return x[seen], c[seen], n[seen]


def sample_surface(
    actor: Actor, vertices: Floats, points: int, rng: np.random.Generator, motion: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Random points (n, 3), colours and unit normals, uniform over a posed mesh, none of them inside a capsule. motion
    (vertices, 3): each point moves by a random share of it.
    """
    corners = vertices[actor.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    chance = np.cumsum(area) / area.sum()
    x, c, n = list[Floats](), list[Floats](), list[Floats]()
    have = 0
    for _ in range(4):
        wanted = points - have if actor.name != "capsules" else int(1.6 * (points - have)) + 10
        if wanted <= 0:
            break
        face = np.searchsorted(chance, rng.random(wanted)).clip(max=len(area) - 1)
        u, v = rng.random((2, wanted))
        flip = u + v > 1
        u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
        share = np.stack([1 - u - v, u, v], 1)
        place = np.einsum("nk,nkd->nd", share, corners[face])
        colour = np.einsum("nk,nkd->nd", share, actor.colours[actor.faces[face]])
        normal = cross[face] / np.maximum(area[face, None], 1e-12)
        if actor.name == "capsules":
            outside = ~_inside_capsules(vertices, place)
            place, colour, normal = place[outside], colour[outside], normal[outside]
            face, share = face[outside], share[outside]
        if motion is not None:
            place += rng.random((len(place), 1)) * np.einsum("nk,nkd->nd", share, motion[actor.faces[face]])
        x.append(place)
        c.append(colour)
        n.append(normal)
        have += len(place)
    return np.concatenate(x)[:points], np.concatenate(c)[:points], np.concatenate(n)[:points]


def _inside_capsules(vertices: Floats, points: Floats) -> Booleans:
    """Whether each point lies inside one of the capsules, by the cone between the capsule's widest rings."""
    rings = vertices.reshape(-1, _RING_VERTICES, 3)
    per = len(rings) // (len(rings) // _CAPSULE_RINGS)
    inside = np.zeros(len(points), bool)
    for i in range(0, len(rings), per):
        block = rings[i : i + per]
        centres = block.mean(axis=1)
        radii = np.linalg.norm(block[:, 0] - centres, axis=1)
        base = (
            int(np.argmax(radii > 0.95 * radii[per // 3])),
            int(per - 1 - np.argmax(radii[::-1] > 0.95 * radii[-per // 3])),
        )
        p, q, r0, r1 = centres[base[0]], centres[base[1]], radii[base[0]], radii[base[1]]
        along = q - p
        t = np.clip((points - p) @ along / max(float(along @ along), 1e-9), 0, 1)
        away = np.linalg.norm(points - (p + t[:, None] * along), axis=1)
        inside |= away < r0 + t * (r1 - r0) - 0.004
    return inside


_CAPSULE_RINGS, _RING_VERTICES = 22, 20
"""Shape of the meshes of `actors.capsule`."""


def visible_points(
    x: Floats, c: Floats, n: Floats, rig: Rig, centre: Floats, fixed: np.random.Generator, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Points, colours and normals that the rig's cameras see, with the rig's errors.

    fixed: generator of what stays the same in all frames (calibration errors), seeded alike for each frame.
    """
    out_x, out_c, out_n = list[Floats](), list[Floats](), list[Floats]()
    for camera in range(rig.cameras):
        angle = np.deg2rad(rig.span) * (camera / rig.cameras) + 0.2
        offset = fixed.normal(size=3)
        offset *= rig.calibration_m * fixed.uniform(0.7, 1.4) / np.linalg.norm(offset)
        forward = np.array([-np.sin(angle), -0.12, -np.cos(angle)]) / np.sqrt(1 + 0.12**2)
        eye = np.array([centre[0], 1.0, centre[2]]) * np.array([1, 1, 1]) - 2.5 * forward
        right = np.cross(forward, [0, 1.0, 0])
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        ray = x - eye
        depth = ray @ forward
        pixel = np.rint(np.stack([ray @ right, ray @ up], 1) / depth[:, None] * 130).astype(int)  # about 2 cm wide
        low = pixel.min(axis=0)
        pixel -= low - 1
        wide, high = pixel.max(axis=0) + 2
        nearest = np.full((wide, high), np.inf)
        np.minimum.at(nearest, (pixel[:, 0], pixel[:, 1]), depth)
        around = nearest.copy()
        for dx, dy in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            around = np.minimum(around, np.roll(nearest, (dx, dy), axis=(0, 1)))
        here = around[pixel[:, 0], pixel[:, 1]]
        facing = np.sum(n * ray, axis=1) < 0
        visible = facing & (depth < here + 0.05)
        if rig.holes:
            spots = rng.integers(0, [wide, high], (max(1, int(rig.holes * wide * high / 40)), 2))
            lost = np.zeros((wide + 6, high + 6), bool)
            for dx, dy in np.ndindex(6, 6):
                lost[spots[:, 0] + dx, spots[:, 1] + dy] = True
            visible &= ~lost[pixel[:, 0] + 3, pixel[:, 1] + 3]
        silhouette = np.sum(n * ray, axis=1) > -0.25 * np.linalg.norm(ray, axis=1)
        flying = visible & silhouette & (rng.random(len(x)) < 8 * rig.flying)
        noise = rig.noise_m * (depth / 2.5) ** 2 * rng.normal(size=len(x))
        noise += np.where(flying, rng.uniform(0, 0.25, len(x)), 0)
        shifted = x + offset + (noise / depth)[:, None] * ray
        out_x.append(shifted[visible])
        out_c.append(c[visible])
        out_n.append(n[visible])
    return np.concatenate(out_x), np.concatenate(out_c), np.concatenate(out_n)
