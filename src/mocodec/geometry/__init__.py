"""Bodies in space: rotations, skeletons and frames of reference."""
