"""Converts a Motion to an armature or to empties.

At rest, a joint of mocodec has the world's axes, and a bone of Blender points along its own y axis. With B the rest
orientation of a bone, a rotation R relative to the parent becomes B⁻¹ · R · B in the bone's axes.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

import mocodec
from mocodec.geometry import bone_frames

from . import curves

LEAF_M = 0.05
"""Length of a bone without children, metres."""
STILL_M = 1e-5
"""Translations of joints that vary less than this get no curve, metres."""


def add(
    context: bpy.types.Context, motion: mocodec.Motion, name: str, scale: float, as_empties: bool, set_scene: bool
) -> str:
    """Add a motion to the scene; returns a description. scale: Blender units a metre."""
    motion = motion.turned("z")
    if set_scene:
        rate = motion.rate
        context.scene.render.fps = max(1, round(rate))
        context.scene.render.fps_base = max(1, round(rate)) / rate
        context.scene.frame_start, context.scene.frame_end = 1, max(1, len(motion))
    if motion.skeleton is not None and motion.rotations is not None and not as_empties:
        add_armature(context, bone_frames.to_starts(motion), name, scale)
        return f"{len(motion)} frames of an armature with {motion.points} joints"
    add_empties(context, motion, name, scale)
    return f"{len(motion)} frames of {motion.points} empties"


def add_armature(context: bpy.types.Context, motion: mocodec.Motion, name: str, scale: float) -> bpy.types.Object:
    """Adds an armature with a bone for each joint, and its action."""
    armature = bpy.data.armatures.new(name)
    owner = bpy.data.objects.new(name, armature)
    context.collection.objects.link(owner)
    context.view_layer.objects.active = owner
    add_bones(owner, motion.skeleton, scale)
    curves.action_for(owner, name)
    frames = np.arange(1, len(motion) + 1, dtype=np.float64)
    names = [bone["mocodec_joint"] for bone in owner.data.bones]
    at = dict(zip(names, owner.data.bones, strict=True))
    for joint, parent in enumerate(motion.skeleton.parents):
        bone = at[joint]
        rest = np.array(bone.matrix_local.to_3x3())
        pose = owner.pose.bones[bone.name]
        pose.rotation_mode = "QUATERNION"
        path = pose.path_from_id("rotation_quaternion")
        turned = own_axes(motion.rotations[:, joint], rest)
        for component in range(4):
            curves.add(owner, path, component, frames, turned[:, component], bone.name)
        moved = translations(motion, joint, parent) @ rest * scale
        if (
            parent < 0
            or np.ptp(moved, axis=0).max(initial=0.0) > STILL_M * scale
            or np.abs(moved).max() > STILL_M * scale
        ):
            path = pose.path_from_id("location")
            for axis in range(3):
                curves.add(owner, path, axis, frames, moved[:, axis], bone.name)
    owner["mocodec_names"] = list(motion.skeleton.names)
    return owner


def add_bones(owner: bpy.types.Object, skeleton: mocodec.Skeleton, scale: float) -> None:
    """Adds bones from joint to child, in edit mode. A bone stores its joint's number, since Blender may cut names."""
    heads = np.zeros((len(skeleton), 3))
    for joint, parent in enumerate(skeleton.parents):
        heads[joint] = skeleton.offsets[joint] + (heads[parent] if parent >= 0 else 0)
    bpy.ops.object.mode_set(mode="EDIT")
    made = []
    for joint, parent in enumerate(skeleton.parents):
        bone = owner.data.edit_bones.new(skeleton.names[joint] or f"joint {joint}")
        bone.head = Vector(heads[joint] * scale)
        children = [heads[c] for c, p in enumerate(skeleton.parents) if p == joint]
        along = np.mean(children, axis=0) - heads[joint] if children else np.zeros(3)
        if np.linalg.norm(along) < 1e-4:
            along = skeleton.offsets[joint] if parent >= 0 else np.array([0, 0, LEAF_M])
            norm = np.linalg.norm(along)
            along = along / norm * LEAF_M if norm > 1e-4 else np.array([0, 0, LEAF_M])
        bone.tail = Vector((heads[joint] + along) * scale)
        bone.use_connect = False
        bone.parent = made[parent] if parent >= 0 else None
        made.append(bone)
    names = [bone.name for bone in made]
    bpy.ops.object.mode_set(mode="OBJECT")
    for joint, name in enumerate(names):
        owner.data.bones[name]["mocodec_joint"] = joint
        owner.data.bones[name].use_inherit_rotation = True


def own_axes(quaternions: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Rotations (frames, 4; w first) in a bone's axes: B⁻¹ rotates the vector part. Signs do not jump."""
    turned = quaternions.copy()
    turned[:, 1:] = quaternions[:, 1:] @ rest
    flips = np.cumprod(np.where((turned[1:] * turned[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    turned[1:] *= flips[:, None]
    return turned


def translations(motion: mocodec.Motion, joint: int, parent: int) -> np.ndarray:
    """Translation of a joint from its offset's position, in the axes of its parent, (frames, 3), metres."""
    if parent < 0:
        moved = motion.positions[:, joint] - motion.skeleton.offsets[joint]
    else:
        world = world_rotations(motion)[:, parent]
        apart = motion.positions[:, joint] - motion.positions[:, parent]
        moved = np.einsum("fji,fj->fi", world, apart) - motion.skeleton.offsets[joint]
    return np.nan_to_num(moved)


_last: tuple[object, np.ndarray] | None = None


def world_rotations(motion: mocodec.Motion) -> np.ndarray:
    """World rotations of all joints, matrices (frames, joints, 3, 3); cached for the last motion."""
    global _last
    if _last is None or _last[0] is not motion:
        world = np.empty((len(motion), motion.points, 3, 3))
        for joint, parent in enumerate(motion.skeleton.parents):
            local = matrices(motion.rotations[:, joint])
            world[:, joint] = local if parent < 0 else world[:, parent] @ local
        _last = (motion, world)
    return _last[1]


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (frames, 3, 3) of unit quaternions (frames, 4), w first."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def add_empties(context: bpy.types.Context, motion: mocodec.Motion, name: str, scale: float) -> None:
    """Adds a collection with an empty for each point; an empty is hidden while its point is missing."""
    collection = bpy.data.collections.new(name)
    context.scene.collection.children.link(collection)
    frames = np.arange(1, len(motion) + 1, dtype=np.float64)
    for point, label in enumerate(motion.names):
        empty = bpy.data.objects.new(label or f"point {point}", None)
        empty.empty_display_type, empty.empty_display_size = "SPHERE", 0.015 * scale
        empty["mocodec_point"], empty["mocodec_name"] = point, label
        collection.objects.link(empty)
        here = ~np.isnan(motion.positions[:, point, 0])
        if not here.any():
            empty.hide_viewport = True
            continue
        curves.action_for(empty, f"{name} {label}")
        for axis in range(3):
            values = motion.positions[here, point, axis] * scale
            curves.add(empty, "location", axis, frames[here], values, "Location")
        if not here.all():
            changes = np.flatnonzero(np.diff(here, prepend=~here[0]))
            curves.add(empty, "hide_viewport", 0, frames[changes], (~here[changes]).astype(float), "Gaps")
