"""Compress a recording so that no joint of any frame moves by more than 2 mm."""

import mocodec as mc
from mocodec import data

motion = mc.read(data.RECORDING)  # or your own: .c3d .trc .bvh .amc .npz .glb
print(f"{len(motion):,} frames of {motion.points} joints at {motion.rate:g} Hz")

blob = mc.encode(motion, max_error=0.002)  # metres
ratio = motion.raw_bytes / len(blob)
print(f"{motion.raw_bytes:,} bytes as float32 become {len(blob):,}: {ratio:.0f} to 1")

decoded = mc.decode(blob)
error = mc.compare(motion, decoded)
print(f"mean error {1000 * error.mean_error:.2f} mm")
print(f"largest error {1000 * error.max_error:.2f} mm")
assert error.max_error <= 0.002

mc.write("jumps.trc", decoded)  # the suffix chooses the format
mc.write("jumps.mocz", motion, max_error=0.002)
