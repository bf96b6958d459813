"""GLB and glTF to Motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadInput
from ...geometry import rigid
from ...motion import UP_AXES, Motion, Skeleton
from ...selection import counted
from ...typing import Floats
from ..c3d.labels import unique_names
from ..conventions import first_frame, unit_option, with_start
from . import animations, node_tree
from .animations import Channels
from .document import MAX_VALUE, Document
from .nodes import Nodes, Tracks
from .rates import frame_times, key_times, rate_of

FREE_SAMPLES = 1 << 22
SAMPLES_PER_BYTE = 16
"""Frames × moving nodes that a file may be sampled to: FREE_SAMPLES, and SAMPLES_PER_BYTE for each of its bytes."""
MAX_NODES = 1 << 13
"""Joints and the nodes above them; more are no skeleton."""
ALL_SKINS = "all"


def read(
    path: str | Path,
    rate: float | None = None,
    unit: str | float | None = None,
    animation: str | int | None = None,
    skin: str | int | None = None,
) -> Motion:
    """One animation of a GLB or glTF as a motion of the joints of one skin.

    rate: sampling rate in hertz; by default that of the key times, or a usual rate for sparse keys. unit: of the
    lengths, by default metres as glTF demands. animation: its name or number (from 0), by default the longest. skin:
    its name or number, or "all" for the joints of all skins; by default the one with most joints. Without a skin, all
    animated nodes and the nodes below them are joints. Raises BadInput.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused
            return _read(path, rate, unit, animation, skin)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, RecursionError, AttributeError) as error:
        if isinstance(error, BadInput):
            if str(error).startswith(str(path)):
                raise
            raise BadInput(f"{path}: {error}") from None
        raise BadInput(f"{path}: cannot be read as a GLB ({type(error).__name__}: {error})") from None


def _read(
    path: str | Path, rate: float | None, unit: str | float | None, animation: str | int | None, skin: str | int | None
) -> Motion:
    document = Document(path)
    units, unit_m = ("m", 1.0) if unit is None else unit_option(unit)
    nodes = Nodes(document, unit_m)
    own = _own_settings(document)
    notes = list[str]()
    number, channels = _animation(document, nodes, animation, notes)
    joints = _joints(document, nodes, channels, skin, notes)
    chosen = nodes.with_ancestors(set(joints))
    if len(chosen) > MAX_NODES:
        raise BadInput(
            f"{path}: its {len(chosen):,} joints and the nodes above them are no skeleton: at most {MAX_NODES:,}"
        )
    tracks = {
        (node, kind): animations.track(document, sampler, kind, unit_m)
        for (node, kind), sampler in channels.items()
        if node in chosen
    }
    if not tracks:
        raise BadInput(f"{path}: its animation moves none of the joints; choose another (--animation, --skin)")
    if rate is None:
        rate, is_sparse = (float(own["rate"]), False) if "rate" in own else rate_of(list(tracks.values()))
        if is_sparse:
            notes.append(f"its key frames are sparse or irregular: they are sampled at {rate:g} Hz (--rate)")
    begin = key_times(list(tracks.values()))[0]
    at = _frames(document, nodes, tracks, chosen, rate)
    source: dict[str, Any] = {"format": "glb", "units": units, "unit_m": unit_m}
    name = animations.names_of(document.items("animations"))[number]
    source |= {"animation": name} if name else {}
    source |= {"notes": notes} if notes else {}
    if "first_frame" in own:
        source["first_frame"] = first_frame(own)
        begin += (source["first_frame"] - 1) / rate
    if begin or "first_frame" in source:
        source = with_start(source, rate, begin)
    return _motion(nodes, joints, chosen, tracks, at, rate, own, source)


def _own_settings(document: Document) -> dict[str, Any]:
    """What `write` stores in asset.extras; empty for files of other programs."""
    asset = document.json.get("asset", {})
    is_own = asset.get("generator") == "mocodec" and isinstance(asset.get("extras"), dict)
    return dict(asset["extras"]) if is_own else {}


def _animation(document: Document, nodes: Nodes, wanted: str | int | None, notes: list[str]) -> tuple[int, Channels]:
    """The number of the animation and its channels: the one that is asked for, else the longest."""
    items = document.items("animations")
    if not items:
        raise BadInput(f"{document.path}: it has no animation")
    names = animations.names_of(items)
    number = animations.chosen("animation", wanted, names, document.path)
    if number is None:
        read = {i: animations.channels_of(document, item, nodes)[0] for i, item in enumerate(items)}
        lasting = {i: animations.duration(document, channels) for i, channels in read.items()}
        number = max(lasting, key=lambda i: lasting[i])
        others = [i for i in lasting if i != number]
        if others:
            reason = f"the longest of {len(items)} ({lasting[number]:.3g} s)"
            notes.append(animations.others_note("animation", reason, number, names, others))
    channels, others = animations.channels_of(document, items[number], nodes)
    if not channels:
        raise BadInput(f"{document.path}: animation {number} moves no node")
    if others:
        notes.append(f"{counted(others, 'channel')} of its animation (morph weights and others) move no node: not read")
    return number, channels


def _joints(
    document: Document, nodes: Nodes, channels: Channels, wanted: str | int | None, notes: list[str]
) -> list[int]:
    """Nodes that become points of the motion, parents first."""
    items = document.items("skins")
    members = [set[int](skin["joints"]) for skin in items]
    if any(not joints <= set(range(len(nodes))) for joints in members):
        raise document.damaged("a skin of nodes that do not exist")
    moving = {node for node, _ in channels}
    names = animations.names_of(items)
    if wanted == ALL_SKINS and members:
        joints = set[int]().union(*members)
    elif (number := animations.chosen("skin", wanted, names, document.path)) is not None:
        joints = members[number]
    else:
        moved = nodes.with_descendants(moving)
        animated = [i for i, joints in enumerate(members) if joints & moved]
        number = max(animated, key=lambda i: len(members[i]), default=-1)
        joints = members[number] if animated else _animated_nodes(nodes, moving)
        others = [i for i in animated if not members[i] <= joints]
        if others:
            reason = f"the one with most joints; --skin {ALL_SKINS} reads all"
            notes.append(animations.others_note("skin", reason, number, names, others))
    return [node for node in nodes.parents_first() if node in joints]


def _animated_nodes(nodes: Nodes, moving: set[int]) -> set[int]:
    """The joints of a file without skins: animated nodes, and those below them that are not meshes or cameras."""
    below = nodes.with_descendants(moving) - moving
    return moving | {node for node in below if not nodes.contents[node].keys() & {"mesh", "camera"}}


def _frames(document: Document, nodes: Nodes, tracks: Tracks, chosen: set[int], rate: float) -> Floats:
    """The times of the frames. Raises BadInput for far more samples than the file has bytes."""
    begin, end = key_times(list(tracks.values()))
    if not 0 < rate < 1e6:
        raise BadInput(f"{document.path}: its key times do not give a usable rate; give one with rate= (--rate)")
    count = (end - begin) * rate + 1
    moving = len(nodes.with_descendants({node for node, _ in tracks}) & chosen)
    if not count * moving <= FREE_SAMPLES + SAMPLES_PER_BYTE * document.bytes:
        raise BadInput(
            f"{document.path}: its {document.bytes:,} bytes make {count:,.0f} frames of {moving} nodes at {rate:g} Hz, "
            "too many: give a lower rate= (--rate)"
        )
    return frame_times(begin, end, rate)


def _motion(
    nodes: Nodes,
    joints: list[int],
    chosen: set[int],
    tracks: Tracks,
    at: Floats,
    rate: float,
    own: dict[str, Any],
    source: dict[str, Any],
) -> Motion:
    """The motion of the joints, sampled at the times `at`."""
    up = own["up"] if own.get("up") in UP_AXES else "y"
    world = _world_node(nodes, own)
    place = {node: i for i, node in enumerate(joints)}
    above = nodes.nearest_above(joints)
    parents = tuple(place.get(above[node], -1) for node in joints)
    rest = np.empty((len(joints), 3))
    rest_rotations = dict[int, Floats]()
    for node, pose in nodes.poses(chosen, {}, np.zeros(1), rate, world):
        if node in place:
            rest[place[node]], rest_rotations[node] = pose.position[0], pose.rotation
    positions, turned = np.empty((len(at), len(joints), 3)), np.empty((len(at), len(joints), 4))
    for node, pose in nodes.poses(chosen, tracks, at, rate, world):
        if node in place:
            positions[:, place[node]] = pose.position
            turned[:, place[node]] = rigid.multiply(pose.rotation, rigid.inverse(rest_rotations[node]))
    local = turned.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            local[:, joint] = rigid.multiply(rigid.inverse(turned[:, parent]), turned[:, joint])
    offsets = np.array([rest[i] - (rest[p] if p >= 0 else 0) for i, p in enumerate(parents)])
    if not all(np.abs(values).max() < MAX_VALUE for values in (positions, local, offsets)):
        raise BadInput(f"damaged: its joints are beyond {MAX_VALUE:g} m")
    names, originals = unique_names([nodes.name(node) for node in joints], len(joints))
    source |= {"labels": originals} if originals else {}
    if own.get("rotations") is False:
        return Motion(positions, rate, names, up, source=source)
    tree = node_tree.of_nodes(nodes, chosen - {world}, place, names, world)
    scales = node_tree.scale_signal(tree, tracks, at, rate)
    extras = {"gltf": {**node_tree.pack(tree), **scales}} if scales or not node_tree.is_plain(tree, parents) else {}
    return Motion(positions, rate, names, up, Skeleton(names, parents, offsets), local, source, extras)


def _world_node(nodes: Nodes, own: dict[str, Any]) -> int:
    """The node that `write` puts above all others to turn the vertical axis to y, or −1."""
    if own.get("up") not in UP_AXES:
        return -1
    roots = [node for node, parent in enumerate(nodes.parents) if parent < 0]
    return next((node for node in roots if nodes.name(node) == node_tree.world_name(own["up"])), -1)
