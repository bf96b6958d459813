"""Poses as numbers that a transform codes well.

heading           the frame that follows the body: up axis, heading, mean pose
leaps             samples and frames where a recording jumps
bone_tree         a tree of bones of constant length, and the order in which its frames are computed
bone_directions   positions of joints to directions of bones, and back
tree_fitting      a bone tree found in poses
rotations         rotation vectors, directions and frames
"""
