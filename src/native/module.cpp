// mocodec._native: loops that NumPy cannot do side by side. One file for each user, beside this one:
//
//   entropy.cpp     serial steps of the coders of codecs/tempo and entropy/
//   bone_directions.cpp   directions of bones, for codecs/tempo/pose/bone_directions.py
//   matching.cpp    a body matched to points, for geometry/body_matching.py
//
// Each file defines `void bind_NAME(nb::module_ &)`, and is named in PARTS. Python asks for a kernel by name
// (`mocodec.native.kernel`), and does without where it is missing. Where bytes depend on a kernel, it gives the bits that
// NumPy gives: integers, or floats by the same operations in the same order.

#include <nanobind/nanobind.h>

namespace nb = nanobind;

#define PARTS(PART) PART(entropy) PART(matching) PART(bone_directions)

#define DECLARE(name) void bind_##name(nb::module_ &);
PARTS(DECLARE)

#define BIND(name) bind_##name(m);
NB_MODULE(_native, m) {
    m.doc() = "The compiled accelerator of mocodec; docs/architecture.md says what it may do.";
    PARTS(BIND)
}
