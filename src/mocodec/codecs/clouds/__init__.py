"""What the point cloud codecs, `lien2006` and `bodycast`, share.

raw_frames.py       points of a frame that can be coded; frames stored point by point
body_record.py      a body's links as bytes
tracked_motion.py   a skeleton from a file; tracked poses as a Motion
inflate.py          zlib streams with a size limit
"""
