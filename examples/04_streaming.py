"""Send motion during the recording.

The encoder takes frames as they arrive and returns a chunk every quarter of a second.
"""

import numpy as np

import mocodec as mc
from mocodec.codecs import tempo
from mocodec.testing import synthetic

# Stands for a motion capture system: three seconds of 41 markers.
camera = synthetic.markers(frames=360, seed=1)

# Names, rate and vertical axis without frames, known to sender and receiver.
about = camera[:0]

encoder = tempo.Encoder(about, max_error=0.005, latency_seconds=0.25)
decoder = tempo.Decoder(encoder.shared, about)

sent, received = 0, []
for start in range(0, len(camera), 6):
    for chunk in encoder.push(camera.positions[start : start + 6]):
        sent += len(chunk.payload)
        received.append(decoder.push(chunk))  # on the other side of the network
received += [decoder.push(chunk) for chunk in encoder.finish()]

positions = np.concatenate(received)
error = mc.compare(camera, mc.Motion(positions, about.rate, about.names, about.up))
print(f"{len(positions)} frames in {8 * sent / camera.seconds / 1000:.0f} kbit/s")
print(f"largest error {1000 * error.max_error:.2f} mm")
