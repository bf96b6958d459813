"""Animation curves with many keys. Blender 5 has only layered actions; 4.2 to 4.5 have both kinds."""

from __future__ import annotations

import bpy
import numpy as np

LINEAR = 1


def action_for(owner: bpy.types.ID, name: str) -> bpy.types.Action:
    """Creates an action for an object."""
    owner.animation_data_create()
    action = bpy.data.actions.new(name)
    owner.animation_data.action = action
    if hasattr(action, "slots"):  # from 4.4 on, an object uses a slot of an action
        owner.animation_data.action_slot = action.slots.new(owner.id_type, owner.name)
    return action


def add(owner: bpy.types.ID, path: str, index: int, frames: np.ndarray, values: np.ndarray, group: str) -> None:
    """Adds a curve of one property, with linear keys at these frames."""
    action = owner.animation_data.action
    if hasattr(action, "fcurves"):
        curve = action.fcurves.new(path, index=index, action_group=group)
    else:
        curve = action.fcurve_ensure_for_datablock(owner, path, index=index)
    curve.keyframe_points.add(len(frames))
    keys = np.stack([frames, values], axis=1).astype(np.float32)
    curve.keyframe_points.foreach_set("co", keys.ravel())
    curve.keyframe_points.foreach_set("interpolation", np.full(len(frames), LINEAR, np.int32))
    curve.update()


def curve_of(owner: bpy.types.ID, path: str) -> bpy.types.FCurve | None:
    """The curve of a property without index; None without a curve."""
    data = owner.animation_data
    if data is None or data.action is None:
        return None
    if hasattr(data.action, "fcurves"):
        return data.action.fcurves.find(path)
    for layer in data.action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(data.action_slot)
            found = bag.fcurves.find(path) if bag else None
            if found:
                return found
    return None
