"""Point clouds of people as moving, skinned bodies with their surface in a video.

Modules in the order in which data flows:

    codec.py              the method: settings, encode, decode, track
    people.py             people in the first frame; points of later frames assigned to bodies
    tracking.py           a template body and its pose in every frame
    encoder.py            one body while it is encoded: poses, model, streams
    pose_stream.py        poses as quantised spectra                       swing_twist.py   rotations of links
    texture_atlas.py      the surface as one image: texture and displacement map
    surface_mask.py       which cells of the atlas are surface
    video.py              the image, and how it changes, as H.265
    outliers.py           points that no body explains                     octree.py        occupancy of cells
    point_encoder.py      all points within a bound                        point_targets.py the bound for a target
    point_layer.py        all points of a chunk, on a lattice: their places and colours
    lattice_frames.py     points rounded to the lattice                    point_octree.py  its octree, by contexts
    point_choice.py       lattice points chosen by their bits and errors   cube_octree.py   the same cube by cube
    point_scene.py        where the surface of the bodies lies             surface_hints.py as the octree sees it
    reference_points.py   points of earlier frames as surface: what a frame refers to
    reference_choice.py   the encoder's choice of them                     reference_surface.py their planes
    point_smoothing.py    lattice points moved to the surface around them
    colour_lifting.py     colours of lattice points                        surface_memory.py what frames showed before
    exact_octree.py       all points exactly, in the octree of the lattice
    exact_points.py       all points exactly, bit by bit                   binary_coder.py  bits by context
    body_model.py         what a decoder needs before the first chunk
    chunk_payload.py      the streams of a chunk
    decoder.py            chunks to points                                 surface_sampling.py  points on the atlas
    streaming.py          a packet a frame, for live use

`docs/papers/lien2006.md` says what comes from Lien and Bajcsy (2006) and what does not; `docs/payloads/bodycast.md`
describes the bytes.
"""

from .codec import Bodycast
from .tracking import start_tracking

__all__ = ["Bodycast", "start_tracking"]
