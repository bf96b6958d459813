"""Measure the error of coding, point by point, and draw it.

Needs matplotlib: pip install 'mocodec[plot]'.
"""

import mocodec as mc
from mocodec import data, plots

motion = mc.read(data.RECORDING)
decoded = mc.decode(mc.encode(motion, mean_error=0.001))

error = mc.compare(motion, decoded)
print(f"mean {1000 * error.mean_error:.2f} mm, 99 % below {1000 * error.p99_error:.2f} mm")
print(f"largest: {1000 * error.max_error:.2f} mm at (frame, point) {error.max_at}")

by_mean = sorted(error.per_point, key=lambda name: -error.per_point[name]["mean_error"])
print("points with the largest mean error:", ", ".join(by_mean[:3]))

plots.save(plots.errors(motion, decoded, "mean error of 1 mm"), "error.png")
plots.save(plots.recording(motion, decoded), "poses.png")
print("look at error.png and poses.png")
