"""Send point clouds of a person frame by frame over UDP, through a network that loses packets.

Each frame becomes one packet, without delay: a pose of a few dozen bytes, or all points within a bound. The receiver
shows every frame: after a lost packet, it continues the earlier motion. Needs `mocodec[cloud]`.
"""

import socket

import numpy as np

import mocodec as mc
from mocodec.codecs.bodycast.streaming import Receiver, Sender
from mocodec.metrics import point_clouds
from mocodec.testing import actors, sequences

LOST_SHARE = 0.1

# Replaces a camera rig: two seconds of 2,000 coloured points of a person.
performance = sequences.jumping_jacks(actors.capsules(), 30)
camera = sequences.record(performance, 2000, seed=1)
assert camera.colours is not None

# Both ends of a UDP connection on this machine.
inlet = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
inlet.bind(("127.0.0.1", 0))
inlet.settimeout(5)
outlet = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

senders = {
    "poses": Sender(skeleton=performance.skeleton()),
    "points within 3 mm": Sender(skeleton=performance.skeleton(), max_error=0.003),
}
for name, sender in senders.items():
    receiver, rng = Receiver(), np.random.default_rng(0)
    shown, sent, lost = [], 0, 0
    for points, colours in zip(camera.positions, camera.colours, strict=True):
        cloud = None
        for packet in sender.push(points, colours):  # with the first frame also the model, which must arrive
            if packet != sender.model:
                sent += len(packet)
                if shown and rng.random() < LOST_SHARE:
                    lost += 1
                    continue
            outlet.sendto(packet, inlet.getsockname())
            cloud = receiver.push(inlet.recv(1 << 16))
        shown.append(receiver.conceal() if cloud is None else cloud)
    assert all(cloud is not None for cloud in shown)
    received = mc.PointClouds([points for points, _ in shown], camera.rate, [colours for _, colours in shown])
    errors = [1000 * point_clouds.d1(camera, received, frame) for frame in range(len(camera))]
    print(f"{name}: model {len(sender.model)} bytes, then {sent / len(camera):.0f} bytes a frame")
    print(f"  {lost} of {len(camera)} packets lost")
    print(f"  distance to the person (D1): median {np.median(errors):.1f} mm, largest {max(errors):.0f} mm")
inlet.close()
outlet.close()
