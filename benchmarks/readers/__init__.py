"""What independent readers read from the same C3D and TRC files."""
