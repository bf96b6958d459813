// A first pose without a skeleton, for geometry/body_fit.py (capsule_fitter.h) and geometry/pose_search.py
// (pose_scorer.h). The NumPy code there defines the results; it sums in another order, so the two agree up to rounding.

#include <nanobind/nanobind.h>

#include "arrays.h"
#include "capsule_fitter.h"
#include "pose_scorer.h"

// Rotation matrices (n, 3, 3) of rotation vectors (n, 3), radians: articulation.exp.
static Output<double> rotation_matrices(Input<double, 2> vectors) {
    const size_t n = vectors.shape(0);
    if (vectors.shape(1) != 3) throw std::invalid_argument("rotation_matrices: shapes differ");
    Fresh<double> out(9 * n);
    for (size_t i = 0; i < n; ++i) exponential(vectors.data() + 3 * i, &out.data[9 * i]);
    return out.give({n, 3, 3});
}

void bind_first_pose(nb::module_ &m) {
    m.def("rotation_matrices", &rotation_matrices);
    nb::class_<CellValues<float>>(m, "CellDistances")
        .def(nb::init<Input<float, 1>, Input<double, 1>, Input<int64_t, 1>, double>());
    nb::class_<CellValues<uint8_t>>(m, "CellFlags")
        .def(nb::init<Input<uint8_t, 1>, Input<double, 1>, Input<int64_t, 1>, double>());
    nb::class_<PoseScorer>(m, "PoseScorer")
        .def(nb::init<Input<int64_t, 1>, Input<double, 2>, Input<int64_t, 1>, Input<double, 3>, Input<double, 2>,
                      Input<int64_t, 1>, Input<double, 2>, Input<int64_t, 1>, Input<double, 2>, Input<double, 1>,
                      const CellValues<float> &, Input<double, 2>, double>())
        .def("costs", &PoseScorer::costs)
        .def("best_limbs", &PoseScorer::best_limbs);
    nb::class_<CapsuleFitter>(m, "CapsuleFitter")
        .def(nb::init<Input<int64_t, 1>, Input<int64_t, 1>, Input<int64_t, 1>, Input<double, 2>, Input<int64_t, 1>,
                      Input<int64_t, 1>, Input<int64_t, 2>, Input<double, 2>, Input<int64_t, 1>, Input<int64_t, 1>,
                      Input<double, 1>, Input<double, 2>, Input<double, 1>, Input<int64_t, 1>, Input<double, 2>,
                      Input<double, 1>, const KdTree &, const CellValues<uint8_t> *>(),
             nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(),
             nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().none())
        .def("refine", &CapsuleFitter::refine);
}
