"""Model driven compression of 3-D tele-immersion data (Lien and Bajcsy, 2006).

Modules in the order in which data flows:

    codec.py            the method: settings, encode, decode, track
    cylinder_model.py   the model P: points of the first frame on cylinder links; its bytes
    pose_stream.py      poses as integers
    residual_maps.py    frame and model as maps on the links' cylinders; their difference (section 4)
    map_images.py       residual maps of many frames as PNG and JPEG images (section 5.2)
    chunk_payload.py    the parts of a chunk as bytes

`docs/papers/lien2006.md` says where each equation is and what was decided where the paper leaves a gap;
`docs/payloads/lien2006.md` describes the bytes.
"""

from .codec import Lien2006

__all__ = ["Lien2006"]
