"""Puts recorded motion on an actor: CMU clips become performances with known true joints.

clip name ──► .bvh or .amc file ──► Motion ──perform──► world rotations of the actor's joints, scaled root path
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocodec import api
from mocodec.errors import BadInput
from mocodec.geometry import articulation, rigid
from mocodec.motion import Motion, Skeleton
from mocodec.testing.actors import Actor
from mocodec.testing.sequences import Performance
from mocodec.typing import Floats, Integers

OTHER_NAMES = {
    "Hips": ("root", "hip"), "LowerBack": ("lowerback", "abdomen"), "Spine": ("upperback",), "Spine1": ("thorax",
    "chest"), "Neck": ("lowerneck", "neck"), "Neck1": ("upperneck",), "Head": ("head",),
    "LeftShoulder": ("lclavicle", "lCollar"), "LeftArm": ("lhumerus", "lShldr"),
    "LeftForeArm": ("lradius", "lForeArm"), "LeftHand": ("lhand", "lwrist", "lHand"), "LHipJoint": ("lhipjoint",),
    "LeftUpLeg": ("lfemur", "LeftHip", "lThigh"), "LeftLeg": ("ltibia", "LeftKnee", "lShin"),
    "LeftFoot": ("lfoot", "LeftAnkle", "lFoot"), "LeftToeBase": ("ltoes", "LeftToe"),
}  # fmt: skip
"""Names of the actor's joints in CMU's ASF files, in BVH files of CMU's motion, and in Poser."""

BONE_ENDS = {
    "LeftArm": "LeftForeArm", "LeftForeArm": "LeftHand", "LeftUpLeg": "LeftLeg", "LeftLeg": "LeftFoot",
    "LeftFoot": "LeftToeBase", "LeftShoulder": "LeftArm",
}  # fmt: skip
"""The end joint of a joint's bone. These bones are aligned, since the rest poses of actor and motion differ."""


def clip_path(data: Path, name: str) -> Path | None:
    """The file of a CMU clip, such as 02_05, in the data folder; None if it does not exist."""
    candidates = (data / "cmu/bvh" / f"{name}.bvh", data / "cmu/asfamc" / name.split("_")[0] / f"{name}.amc")
    return next((path for path in candidates if path.exists()), None)


def read_motion(path: Path) -> Motion:
    """Reads a motion. Raises BadInput if the file has point clouds."""
    motion = api.read(path)
    if not isinstance(motion, Motion):
        raise BadInput(f"{path} holds point clouds; a motion is needed")
    return motion


def perform_clip(
    actor: Actor, data: Path, name: str, rate: float, start: float = 0.0, frames: int | None = None
) -> Performance | None:
    """A CMU clip on the actor, by `perform`; None if the data folder does not have it."""
    path = clip_path(data, name)
    return None if path is None else perform(actor, read_motion(path), rate, start, frames)


def perform(actor: Actor, motion: Motion, rate: float, start: float = 0.0, frames: int | None = None) -> Performance:
    """The actor in the poses of a motion: at most `frames` frames from `start` seconds on, at `rate` frames a second.

    Joints are matched by the names of CMU's ASF and BVH files; a joint that the motion lacks moves with its parent. The
    path of the root is scaled to the length of the actor's legs. Raises BadInput if the motion has no skeleton or
    rotations, or other joint names.
    """
    if motion.skeleton is None or motion.rotations is None:
        raise BadInput("an actor follows only motions with a skeleton and rotations: .bvh or .amc")
    source = motion.skeleton
    step = motion.rate / rate
    count = int((len(motion) - 1 - start * motion.rate) / step) + 1
    sampled = np.round(start * motion.rate + step * np.arange(min(count, frames or count))).astype(int)
    index = {name: i for i, name in enumerate(source.names)}
    matches = {name: _matching_joint(name, index) for name in actor.names}
    hips, thigh = matches.get("Hips"), matches.get("LeftUpLeg")
    if hips is None or thigh is None:
        raise BadInput(f"these joints are not those of CMU's skeletons: {', '.join(source.names)}")
    own_frame = motion.source.get("format") in ("amc", "asf_amc")  # a point is the end of its joint's bone
    rest = _rest_positions(source)
    turns = _actor_rotations(actor, source, _world_rotations(motion, sampled), matches, rest, own_frame)
    ankle = matches["LeftLeg" if own_frame else "LeftFoot"] or 0
    leg = max(float(np.linalg.norm(rest[ankle] - rest[hips])), 1e-6)
    actor_leg = float(np.linalg.norm(actor.joints[actor.names.index("LeftFoot")] - actor.joints[0]))
    return Performance(actor, turns, motion.positions[sampled, hips] * (actor_leg / leg), rate)


def _world_rotations(motion: Motion, sampled: Integers) -> Floats:
    """World rotations of the motion's joints in these frames, (frames, joints, 3, 3)."""
    assert motion.skeleton is not None
    assert motion.rotations is not None
    local = rigid.to_matrix(motion.rotations[sampled])
    world = np.empty_like(local)
    for joint, parent in enumerate(motion.skeleton.parents):
        world[:, joint] = local[:, joint] if parent < 0 else world[:, parent] @ local[:, joint]
    return world


def _rest_positions(skeleton: Skeleton) -> Floats:
    """Positions of the joints in the rest pose, (joints, 3)."""
    rest = np.zeros((len(skeleton), 3))
    for joint, parent in enumerate(skeleton.parents):
        rest[joint] = skeleton.offsets[joint] + (rest[parent] if parent >= 0 else 0)
    return rest


def _actor_rotations(
    actor: Actor, source: Skeleton, world: Floats, matches: dict[str, int | None], rest: Floats, own_frame: bool
) -> Floats:
    """World rotations of the actor's joints, (frames, joints, 3, 3), with bones aligned to the source's."""
    turns = np.empty((len(world), len(actor.names), 3, 3))
    for joint, (name, parent) in enumerate(zip(actor.names, actor.parents, strict=True)):
        match = matches[name]
        if match is None:
            turns[:, joint] = turns[:, parent]
            continue
        align = np.eye(3)
        end = BONE_ENDS.get(name.replace("Right", "Left"), "").replace("Left", "Right" if "Right" in name else "Left")
        source_end = match if own_frame else matches.get(end)
        if end in actor.names and source_end is not None:
            bone = actor.joints[actor.names.index(end)] - actor.joints[joint]
            source_bone = rest[source_end] - rest[source.parents[match] if own_frame else match]
            align = articulation.rotation_between(
                bone / np.linalg.norm(bone), source_bone / np.linalg.norm(source_bone)
            )  # from the actor's rest pose to the source's
        elif name.endswith(("Hand", "ToeBase", "Foot")):
            turns[:, joint] = turns[:, parent]
            continue
        turns[:, joint] = world[:, match] @ align
    return turns


def _matching_joint(name: str, index: dict[str, int]) -> int | None:
    """Index of the joint with this name or one of its other names; None if there is none."""
    left = name.replace("Right", "Left").replace("RHip", "LHip")
    for candidate in (left, *OTHER_NAMES.get(left, ())):
        if left != name:
            candidate = candidate.replace("Left", "Right").replace("LHip", "RHip")
            candidate = "r" + candidate[1:] if candidate[0] == "l" and left != "LowerBack" else candidate
        if candidate in index:
            return index[candidate]
    return None
