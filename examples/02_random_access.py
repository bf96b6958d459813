"""Read one second of one foot out of a file, without decoding the rest."""

import mocodec as mc
from mocodec import data

mc.write("jumps.mocz", mc.read(data.RECORDING), max_error=0.002)

# A path, an http(s) URL, bytes or a file object; only header and index are read.
with mc.open("jumps.mocz") as f:
    print("frames, points, axes:", f.shape)
    print("coded with:", f.info["codec"], f.info["settings"])

    second = f[1200:1320]  # frames
    print("frames 1200 to 1319:", second.positions.shape)

    foot = f[1200:1320, ["LeftFoot"]]  # frames and points
    print("the left foot alone:", foot.positions.shape)

    turn = f.at(seconds=slice(12.5, 14.0))
    print("from 12.5 s to 14 s:", len(turn), "frames")

    # Chunk by chunk: a long recording need not fit into memory.
    for number, chunk in enumerate(f):
        print(f"chunk {number}: {len(chunk)} frames")
