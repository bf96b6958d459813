// Arithmetic of integers as NumPy defines it.
#pragma once

#include <cstdint>

// Rounds towards minus infinity, as NumPy's // does.
inline int64_t floor_division(int64_t a, int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }
