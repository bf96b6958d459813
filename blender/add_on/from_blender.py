"""Converts the active armature or the selected empties to a Motion: all frames of the scene, with constraints."""

from __future__ import annotations

import bpy
import numpy as np

import mocodec

from . import curves


def motion_of(context: bpy.types.Context, scale: float) -> mocodec.Motion:
    """The motion of the active armature, or of the selected empties. Of an imported recording, all empties count.

    scale: Blender units a metre. Raises BadInput without a suitable selection.
    """
    active = context.view_layer.objects.active
    chosen = {o for o in context.selected_objects if o.type == "EMPTY"}
    if active is not None and active.type == "ARMATURE" and not chosen:
        return of_armature(context, active, scale)
    for collection in {c for empty in chosen if "mocodec_point" in empty for c in empty.users_collection}:
        chosen |= {o for o in collection.objects if "mocodec_point" in o}  # users cannot select hidden ones
    if chosen:
        ordered = sorted(chosen, key=lambda o: (o.get("mocodec_point", 1 << 30), o.name))
        return of_empties(context, ordered, scale)
    raise mocodec.BadInput("select an armature, or empties of a recording")


def rate_of(scene: bpy.types.Scene) -> float:
    """Frames a second."""
    return float(scene.render.fps / scene.render.fps_base)


def of_armature(context: bpy.types.Context, owner: bpy.types.Object, scale: float) -> mocodec.Motion:
    """The motion of an armature: joints at the heads of bones, parents first; rotations relative to the rest pose."""
    scene = context.scene
    bones = parents_first(owner.data.bones)
    number = {bone.name: joint for joint, bone in enumerate(bones)}
    parents = [number[bone.parent.name] if bone.parent else -1 for bone in bones]
    rest = np.array([bone.matrix_local for bone in bones])
    heads = rest[:, :3, 3]
    offsets = heads - np.where(np.array(parents)[:, None] >= 0, heads[np.maximum(parents, 0)], 0)
    frames = range(scene.frame_start, scene.frame_end + 1)
    world = np.empty((len(frames), len(bones), 4, 4))
    before = scene.frame_current
    for row, frame in enumerate(frames):  # Blender evaluates constraints frame by frame
        scene.frame_set(frame)
        placed = np.array(owner.matrix_world)
        world[row] = placed @ np.array([owner.pose.bones[bone.name].matrix for bone in bones])
    scene.frame_set(before)
    turned = unit(world[..., :3, :3]) @ np.swapaxes(rest[:, :3, :3], 1, 2)
    local = turned.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            local[:, joint] = np.swapaxes(turned[:, parent], 1, 2) @ turned[:, joint]
    stored = owner.get("mocodec_names")
    names = [names_of(bone, stored) for bone in bones]
    skeleton = mocodec.Skeleton(unique(names), parents, offsets / scale)
    positions = world[..., :3, 3] / scale
    return mocodec.Motion(positions, rate_of(scene), skeleton.names, "z", skeleton, quaternions(local))


def parents_first(bones: bpy.types.ArmatureBones) -> list[bpy.types.Bone]:
    """Bones in the order of their imported joints, if that puts parents first; otherwise depth first."""
    listed = sorted(bones, key=lambda bone: bone.get("mocodec_joint", 1 << 30))
    seen: set[str] = set()
    for bone in listed:
        if bone.parent and bone.parent.name not in seen:
            break
        seen.add(bone.name)
    else:
        return listed
    ordered: list[bpy.types.Bone] = []
    waiting = [bone for bone in reversed(bones) if bone.parent is None]
    while waiting:
        bone = waiting.pop()
        ordered.append(bone)
        waiting += reversed(bone.children)
    return ordered


def names_of(bone: bpy.types.Bone, stored: list[str] | None) -> str:
    """The original name of an imported joint; the bone's name if it was renamed."""
    joint = bone.get("mocodec_joint")
    if stored is None or joint is None or joint >= len(stored):
        return bone.name
    return stored[joint] if stored[joint].startswith(bone.name.partition(".")[0]) else bone.name


def unique(names: list[str]) -> tuple[str, ...]:
    """The names, with numbers at repeated names."""
    result: list[str] = []
    for name in names:
        candidate, times = name, 2
        while candidate in result:
            candidate, times = f"{name}.{times:03}", times + 1
        result.append(candidate)
    return tuple(result)


def unit(matrices_: np.ndarray) -> np.ndarray:
    """Rotation matrices (…, 3, 3): the matrices without scale."""
    return matrices_ / np.linalg.norm(matrices_, axis=-2, keepdims=True)


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """Unit quaternions (…, 4), w first, of rotation matrices (…, 3, 3)."""
    m = rotations
    squares = np.stack(
        [
            1 + m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2],
            1 + m[..., 0, 0] - m[..., 1, 1] - m[..., 2, 2],
            1 - m[..., 0, 0] + m[..., 1, 1] - m[..., 2, 2],
            1 - m[..., 0, 0] - m[..., 1, 1] + m[..., 2, 2],
        ],
        axis=-1,
    )
    size = np.sqrt(np.maximum(squares, 0.0)) / 2
    signs = np.stack(
        [
            np.ones(m.shape[:-2]),
            m[..., 2, 1] - m[..., 1, 2],
            m[..., 0, 2] - m[..., 2, 0],
            m[..., 1, 0] - m[..., 0, 1],
        ],
        axis=-1,
    )
    found = np.copysign(size, signs)
    largest = size.argmax(axis=-1)
    half_turn = size[..., 0] < 1e-4  # at a half turn, signs are relative to the largest component
    if half_turn.any():
        found[half_turn] = _half_turns(m[half_turn], size[half_turn], largest[half_turn])
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def _half_turns(m: np.ndarray, size: np.ndarray, largest: np.ndarray) -> np.ndarray:
    result = np.zeros_like(size)
    for row, (matrix, sizes, most) in enumerate(zip(m, size, largest, strict=True)):
        axis = max(most - 1, 0)
        column = (matrix[:, axis] + matrix[axis]) / 2
        vector = np.copysign(sizes[1:], column)
        vector[axis] = sizes[1 + axis]
        result[row] = [sizes[0], *vector]
    return result


def of_empties(context: bpy.types.Context, empties: list[bpy.types.Object], scale: float) -> mocodec.Motion:
    """The motion of empties: a point for each, missing while its curve hides the empty."""
    scene = context.scene
    frames = range(scene.frame_start, scene.frame_end + 1)
    positions = np.empty((len(frames), len(empties), 3))
    before = scene.frame_current
    for row, frame in enumerate(frames):
        scene.frame_set(frame)
        positions[row] = [empty.matrix_world.translation for empty in empties]
    scene.frame_set(before)
    for point, empty in enumerate(empties):
        curve = curves.curve_of(empty, "hide_viewport")
        hidden = (
            np.array([curve.evaluate(frame) >= 0.5 for frame in held(curve, frames)])
            if curve
            else np.full(len(frames), empty.hide_viewport)
        )
        positions[hidden, point] = np.nan
    names = unique([str(empty.get("mocodec_name") or empty.name) for empty in empties])
    return mocodec.Motion(positions / scale, rate_of(scene), names, "z")


def held(curve: bpy.types.FCurve, frames: range) -> list[float]:
    """For each frame, the value of the key at or before it: visibility is not interpolated."""
    keys = np.array([key.co[0] for key in curve.keyframe_points])
    place = np.maximum(np.searchsorted(keys, np.array(frames) + 1e-3) - 1, 0)
    return keys[place].tolist()
