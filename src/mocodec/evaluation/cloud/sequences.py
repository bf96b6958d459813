"""Point clouds of an actor in motion, with the skeleton that moved it.

    Motion with a skeleton ──perform──► turns of the actor's joints ──┐
    jumping_jacks, turning ───────────────────────────────────────────┼─► record ──► PointClouds and their true skeleton
    moved, so that several people share a scene ──────────────────────┘      │
                                  fresh random points a frame · a share removed · noise · a rig of depth cameras

Everything is decided by the seed: frame i of a sequence is the same points whichever frames are made around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...geometry import articulation, rigid
from ...motion import Floats, Motion, Skeleton
from ...pointcloud import PointClouds
from .actors import Actor

# names of the actor's joints in CMU's ASF files, in BVH files of CMU's motion, and in Poser's
SAME = {
    "Hips": ("root", "hip"), "LowerBack": ("lowerback", "abdomen"), "Spine": ("upperback",), "Spine1": ("thorax",
    "chest"), "Neck": ("lowerneck", "neck"), "Neck1": ("upperneck",), "Head": ("head",),
    "LeftShoulder": ("lclavicle", "lCollar"), "LeftArm": ("lhumerus", "lShldr"),
    "LeftForeArm": ("lradius", "lForeArm"), "LeftHand": ("lhand", "lwrist", "lHand"), "LHipJoint": ("lhipjoint",),
    "LeftUpLeg": ("lfemur", "LeftHip", "lThigh"), "LeftLeg": ("ltibia", "LeftKnee", "lShin"),
    "LeftFoot": ("lfoot", "LeftAnkle", "lFoot"), "LeftToeBase": ("ltoes", "LeftToe"),
}  # fmt: skip
# where each joint's bone points, for actors and skeletons whose rest poses differ
BONES = {
    "LeftArm": "LeftForeArm", "LeftForeArm": "LeftHand", "LeftUpLeg": "LeftLeg", "LeftLeg": "LeftFoot",
    "LeftFoot": "LeftToeBase", "LeftShoulder": "LeftArm",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Performance:
    """turns (frames, joints, 3, 3): world rotations of the actor's joints against its bind pose; root (frames, 3)."""

    actor: Actor
    turns: Floats
    root: Floats
    rate: float

    def __len__(self) -> int:
        return len(self.turns)

    def transforms(self, frame: int) -> tuple[Floats, Floats]:
        """a (joints, 3, 3), b (joints, 3): a bind-pose point x of a joint stands at a x + b."""
        a, joints = self.turns[frame], self.joints[frame]
        return a, joints - np.einsum("jik,jk->ji", a, self.actor.joints)

    @property
    def joints(self) -> Floats:
        """(frames, joints, 3): where the joints truly are."""
        places = np.empty((len(self), len(self.actor.names), 3))
        for joint, parent in enumerate(self.actor.parents):
            offset = self.actor.joints[joint] - self.actor.joints[max(parent, 0)]
            places[:, joint] = self.root if parent < 0 else places[:, parent] + self.turns[:, parent] @ offset
        return places

    def moved(self, place: Floats | Sequence[float] = (0.0, 0.0, 0.0), heading: float = 0.0) -> Performance:
        """The same elsewhere: turned by `heading` radians about the vertical through the origin, then moved by
        `place` (3,), metres."""
        turn = articulation.exp(np.array([0.0, heading, 0.0]))
        return replace(self, turns=turn @ self.turns, root=self.root @ turn.T + np.asarray(place, float))

    def skeleton(self) -> Motion:
        """The true skeleton as a Motion that can be written as BVH."""
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


@dataclass(frozen=True)
class Rig:
    """Depth cameras in a circle around the scene, after the tele-immersion rig of the paper: ten clusters in its
    figure 1.

    cameras: how many, evenly over `span` degrees. noise_m: standard deviation of depth at 2.5 m, growing with the
    distance squared. calibration_m: how far each camera's points lie off, which doubles layers. flying: the share of
    points at silhouettes smeared along the ray. holes: the share of the view lost in round holes.
    """

    cameras: int = 10
    span: float = 360.0
    noise_m: float = 0.004
    calibration_m: float = 0.007
    flying: float = 0.02
    holes: float = 0.03


def perform(actor: Actor, motion: Motion, rate: float, start: float = 0.0, frames: int | None = None) -> Performance:
    """The actor in a motion's pose from `start` seconds on, at `rate` frames a second.

    Joints are matched by the names of CMU's ASF and BVH files; a joint that the motion lacks follows its parent. The
    root's path is scaled to the actor's legs. Raises BadInput for a motion without skeleton and rotations or of other
    names.
    """
    if motion.skeleton is None or motion.rotations is None:
        raise BadInput("to move an actor, a motion needs a skeleton and rotations: .bvh or .amc")
    source = motion.skeleton
    step = motion.rate / rate
    count = int((len(motion) - 1 - start * motion.rate) / step) + 1
    at = np.round(start * motion.rate + step * np.arange(min(count, frames or count))).astype(int)
    column = {name: i for i, name in enumerate(source.names)}
    turns = rigid.to_matrix(motion.rotations[at])
    world = np.empty_like(turns)
    for joint, parent in enumerate(source.parents):
        world[:, joint] = turns[:, joint] if parent < 0 else world[:, parent] @ turns[:, joint]
    where = {name: _column(name, column) for name in actor.names}
    if where.get("Hips") is None or where.get("LeftUpLeg") is None:
        raise BadInput(f"these joints are not those of CMU's skeletons: {', '.join(source.names)}")
    own_frame = motion.source.get("format") in ("amc", "asf_amc")  # points are the ends of bones, turned by themselves
    rest = np.zeros((len(source), 3))
    for joint, parent in enumerate(source.parents):
        rest[joint] = source.offsets[joint] + (rest[parent] if parent >= 0 else 0)
    result = np.empty((len(at), len(actor.names), 3, 3))
    for joint, (name, parent) in enumerate(zip(actor.names, actor.parents, strict=True)):
        here = where[name]
        if here is None:
            result[:, joint] = result[:, parent]
            continue
        align = np.eye(3)
        end = _mirror(BONES, name)
        far = here if own_frame else where.get(end)
        if end in actor.names and far is not None:
            ours = actor.joints[actor.names.index(end)] - actor.joints[joint]
            theirs = rest[far] - rest[source.parents[here] if own_frame else here]
            align = articulation.rotation_between(ours / np.linalg.norm(ours), theirs / np.linalg.norm(theirs))
        elif name.endswith(("Hand", "ToeBase", "Foot")):
            result[:, joint] = result[:, parent]
            continue
        result[:, joint] = world[:, here] @ align
    ankle, hips = where["LeftLeg" if own_frame else "LeftFoot"] or 0, where["Hips"] or 0
    legs = float(np.linalg.norm(rest[ankle] - rest[hips]))
    our_foot = actor.joints[actor.names.index("LeftFoot")]
    scale = float(np.linalg.norm(our_foot - actor.joints[0])) / max(legs, 1e-6)
    return Performance(actor, result, motion.positions[at, hips] * scale, rate)


def _column(name: str, column: dict[str, int]) -> int | None:
    left = name.replace("Right", "Left").replace("RHip", "LHip")
    for same in (left, *SAME.get(left, ())):
        if left != name:
            same = same.replace("Left", "Right").replace("LHip", "RHip")
            same = "r" + same[1:] if same[0] == "l" and left != "LowerBack" else same
        if same in column:
            return column[same]
    return None


def _mirror(table: dict[str, str], name: str) -> str:
    return table.get(name.replace("Right", "Left"), "").replace("Left", "Right" if "Right" in name else "Left")


def jumping_jacks(actor: Actor, frames: int = 60, rate: float = 15.0, period: float = 1.2) -> Performance:
    """Arms up and down and legs apart and together, with a slow turn: a test sequence that needs no recording."""
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
    return Performance(actor, _down(actor, articulation.exp(angles)), root, rate)


def turning(actor: Actor, frames: int = 60, rate: float = 15.0, seconds: float = 4.0) -> Performance:
    """A full turn on the spot with swinging arms, after the paper's "turn"."""
    time = np.arange(frames) / rate
    angles = np.zeros((frames, len(actor.names), 3))
    for name, sign in {"Left": 1.0, "Right": -1.0}.items():
        angles[:, actor.names.index(f"{name}Arm"), 0] = 0.6 * sign * np.sin(2 * np.pi * time / 1.3)
        angles[:, actor.names.index(f"{name}ForeArm"), 0] = -0.4 + 0.3 * sign * np.sin(2 * np.pi * time / 1.3)
        angles[:, actor.names.index(f"{name}UpLeg"), 0] = -0.35 * sign * np.sin(2 * np.pi * time / 1.3)
        angles[:, actor.names.index(f"{name}Leg"), 0] = 0.35 + 0.3 * sign * np.sin(2 * np.pi * time / 1.3 + 0.6)
    angles[:, 0, 1] = 2 * np.pi * time / seconds
    root = np.tile(actor.joints[0], (frames, 1))
    return Performance(actor, _down(actor, articulation.exp(angles)), root, rate)


def pair(actor: Actor, frames: int = 60, rate: float = 15.0, apart: float = 1.1) -> tuple[Performance, Performance]:
    """Two people side by side, `apart` metres: one jumps, one turns on the spot in other clothes; for `record`."""
    jumper = jumping_jacks(actor, frames, rate)
    turner = turning(actor.dressed(1), frames, rate)
    return jumper.moved((-apart / 2, 0, 0)), turner.moved((apart / 2, 0, 0))


def _down(actor: Actor, turns: Floats) -> Floats:
    """World rotations of rotations from the parents' frames."""
    world = turns.copy()
    for joint, parent in enumerate(actor.parents):
        if parent >= 0:
            world[:, joint] = world[:, parent] @ turns[:, joint]
    return world


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
    """Point clouds of a performance, or of several people in one scene for as long as the shortest, one a frame.

    points: fresh random points a frame and person, evenly over the surface. keep: the share of them that is not
    removed. noise_m: standard deviation of Gaussian noise on each coordinate. views: only what this many cameras see
    (0: all); or a whole rig with its errors. normals: the true ones beside the points (not with a rig).
    """
    positions, colours, true_normals = list[Floats](), list[NDArray[np.uint8]](), list[Floats]()
    people = (performance,) if isinstance(performance, Performance) else tuple(performance)
    points_in_all = points * len(people)
    for frame in range(min(map(len, people))):
        rng = np.random.default_rng([seed, frame])
        surfaces = [
            surface(who.actor, who.actor.posed(*who.transforms(frame)), points * (6 if views or rig else 1), rng)
            for who in people
        ]
        x, c, n = (np.concatenate(part) for part in zip(*surfaces, strict=True))
        middle = np.mean([who.root[frame] for who in people], axis=0)
        if rig is not None:
            x, c, n = seen(x, c, n, rig, middle, np.random.default_rng(seed), rng)
        elif views:
            clean = Rig(cameras=views, noise_m=0, calibration_m=0, flying=0, holes=0)
            x, c, n = seen(x, c, n, clean, middle, np.random.default_rng(seed), rng)
        if len(x) > points_in_all:
            chosen = rng.choice(len(x), points_in_all, replace=False)
            x, c, n = x[chosen], c[chosen], n[chosen]
        if keep < 1:
            chosen = rng.random(len(x)) < keep
            x, c, n = x[chosen], c[chosen], n[chosen]
        positions.append((x + noise_m * rng.normal(size=x.shape)).astype(np.float32).astype(np.float64))
        colours.append(np.rint(c).astype(np.uint8))
        true_normals.append(n)
    return PointClouds(positions, people[0].rate, colours, true_normals if normals else None, up="y")


def surface(actor: Actor, vertices: Floats, points: int, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Random points (n, 3), colours and unit normals, evenly over a posed mesh; none inside another part of it."""
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
            outside = ~_inside(actor, vertices, place, normal)
            place, colour, normal = place[outside], colour[outside], normal[outside]
        x.append(place)
        c.append(colour)
        n.append(normal)
        have += len(place)
    return np.concatenate(x)[:points], np.concatenate(c)[:points], np.concatenate(n)[:points]


def _inside(actor: Actor, vertices: Floats, points: Floats, normals: Floats) -> NDArray[np.bool_]:
    """Whether points of a body of capsules lie inside another capsule: within the hull of its 14-vertex rings."""
    sides = 20
    rings = vertices.reshape(-1, sides, 3)
    per = len(rings) // (len(rings) // _RINGS)
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


_RINGS = 22


def seen(
    x: Floats, c: Floats, n: Floats, rig: Rig, centre: Floats, fixed: np.random.Generator, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """The points that the rig's cameras see, with the rig's errors. fixed: what stays as it is from frame to frame."""
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
