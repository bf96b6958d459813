"""A script as a user writes it. `tests/test_types.py` checks its types with pyright; it is never run."""

from __future__ import annotations

from typing import assert_type

import numpy as np

import mocodec as mc

# Reading: kind= says what a file holds, and some options do.
assert_type(mc.read("walk.c3d"), mc.Motion | mc.PointClouds)
assert_type(mc.read("walk.c3d", mc.Motion), mc.Motion)
assert_type(mc.read("walk.amc", asf="subject.asf"), mc.Motion)
assert_type(mc.read("frames", fps=15), mc.PointClouds)
assert_type(mc.read("frames", mc.PointClouds, fps=15), mc.PointClouds)

# Any array goes into a motion; float64 comes out.
motion = mc.Motion(np.zeros((10, 2, 3), np.float32), 120, ["LKNE", "RKNE"], up="y")
clouds = mc.PointClouds([np.zeros((5, 3))], rate=15.0)
assert_type(motion[2:5], mc.Motion)
assert_type(motion[-1], mc.Motion)
assert_type(motion[::4, ["LKNE"]], mc.Motion)
assert_type(clouds[0], mc.PointClouds)

# Encoding: names, instances, targets, settings.
assert_type(mc.encode(motion, max_error=0.002), bytes)
assert_type(mc.encode(motion, "hou2014", ratio=100, components=40), bytes)
assert_type(mc.encode(motion, mc.Hou2014(components=40)), bytes)
assert_type(mc.encode(motion, progress=lambda fraction: print(f"{fraction:.0%}")), bytes)
assert_type(mc.encode(clouds, mc.Bodycast(residual=25)), bytes)
mc.encode(motion, mc.Bodycast())  # error: a codec for point clouds
mc.encode(clouds, mc.Tempo())  # error: a codec for motion
mc.encode(motion, max_error="2mm")  # error: metres as a number
mc.encode(np.zeros((10, 2, 3)))  # error: an array has no rate

# Decoding and random access.
blob = mc.encode(motion)
assert_type(mc.decode(blob), mc.Motion | mc.PointClouds)
assert_type(mc.decode(blob, mc.Motion), mc.Motion)
with mc.open("walk.mocz", mc.Motion) as file:
    assert_type(file, mc.File[mc.Motion])
    assert_type(file[100:200], mc.Motion)
    assert_type(file[100], mc.Motion)
    assert_type(file[::4, ["LKNE"]], mc.Motion)
    assert_type(file.at(seconds=slice(1.0, 2.0)), mc.Motion)
    for part in file:
        assert_type(part, mc.Motion)
with mc.open("walk.mocz") as unknown:
    assert_type(unknown[0], mc.Motion | mc.PointClouds)

mc.compare(motion, mc.decode(blob, mc.Motion)).max_error.hex()
mc.compare(motion, clouds)  # error: point clouds
mc.write("walk.trc", motion)
print(mc.Nothing)  # error: no such name

# Streaming and learning.
encoder = mc.tempo.Encoder(motion, max_error=0.005, latency_seconds=0.1)
transforms = mc.Hou2014Database(transforms=4).fit([motion])
assert_type(mc.Hou2014Database(), mc.Hou2014Database)
