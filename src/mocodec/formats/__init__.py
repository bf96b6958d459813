"""Files of the field to Motion and PointClouds, and back: a module with `read` and `write` for each."""
