// Nearest rotation within a joint's limits; geometry/joint_limits.py defines the result.
#pragma once

#include <cstddef>

// Columns of LinkLimits.table: the rotations `before` and `after` (9 each), with before · R · after = Rx Ry Rz; then
// the centre of each angle's range (3) and half its width (3), radians.
constexpr size_t LIMIT_COLUMNS = 24;

// Returns false if the rotation of a link against its parent is within its limits; otherwise true, and sets `allowed`
// to the nearest rotation within them.
bool nearest_allowed(const double *limit, const double *rotation, double *allowed);
