"""Tests of rotations beside positions."""
