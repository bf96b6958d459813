"""Codecs of point clouds of people, measured on synthetic sequences whose true surface and skeleton are known."""
