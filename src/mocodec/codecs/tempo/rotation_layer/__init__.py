"""Rotations of a skeleton's joints, kept beside positions.

rules       how each joint's rotation follows from positions, and which angles are coded beside them
choose      rules and side values of a recording
solve       rotations from positions and side values
shell       shell points, and errors at them
side        side values as coefficients
record      the stored form of rules and statistics
reference   rules that recordings of a known skeleton share
payload     a chunk's part, both ways
chunk_layer a chunk while it is encoded: errors, and what keeps a promise
encoder     coding to a target
layer       decoding, and what a motion needs
compiled    the rules as arrays, for the compiled solver
"""
