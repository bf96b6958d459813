// The rotation within a joint's limits that is nearest to a given one; geometry/joint_limits.py defines the result.
#pragma once

#include <cstddef>

// Columns of LinkLimits.table: the rotations `before` and `after` (9 each) whose product before · R · after is
// Rx Ry Rz, then the centre of each angle's range (3) and half its width (3), radians.
constexpr size_t LIMIT_COLUMNS = 24;

// False if the rotation of a link against its parent is within its limits. Otherwise true, and `allowed` becomes the
// nearest rotation that is.
bool nearest_allowed(const double *limit, const double *rotation, double *allowed);
