"""The same ten seconds with each codec for named points, and with each kind of target."""

import mocodec as mc
from mocodec import data

with mc.open(data.RECORDING) as f:
    motion = f.at(seconds=slice(0, 10))

RUNS = [
    ("tempo", {"max_error": 0.005}),  # no point of any frame is off by more than 5 mm
    ("tempo", {"ratio": 100}),  # a hundredth of the size as float32
    ("hou2014", {"max_error": 0.005}),
    ("hou2014", {"mean_error": 0.001}),  # 1 mm on average
    ("liu2006", {"max_error": 0.005}),
    ("lossless", {}),  # float32, bit for bit
]
for codec, target in RUNS:
    blob = mc.encode(motion, codec=codec, **target)
    error = mc.compare(motion, mc.decode(blob))
    asked = ", ".join(f"{name} = {value:g}" for name, value in target.items()) or "no loss"
    errors = f"mean {1000 * error.mean_error:.2f} mm, largest {1000 * error.max_error:.2f} mm"
    print(f"{codec:8}  {asked:18}  {len(blob):8,} bytes  {errors}")
