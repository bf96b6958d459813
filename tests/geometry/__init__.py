"""Geometry: rotations, kinematics, registration, and conversion of skeletal motions."""
