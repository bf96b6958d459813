// Kernel of codecs/tempo/pose/bone_directions.py, forward; bone_coordinates.h implements it.

#include <stdexcept>

#include "arrays.h"
#include "bone_coordinates.h"

namespace {

using namespace bones;

void run(const Schedule &of, const Positions &positions, double *out) { all_coordinates(of, positions, out); }

#ifdef HAS_AVX2_TWIN
WITH_AVX2 void run_with_avx2(const Schedule &of, const Positions &positions, double *out) {
    all_coordinates(of, positions, out);
}
#endif

// Coordinates (dimensions, frames) of positions (3, points, frames). program, rests, homes: BoneSchedule.program; order
// (bones,); joints (bones,): end joint of each bone in schedule order; pairs (hubs, 2), pair_frames (hubs, 3, 3): of Hub.
Output<double> tempo_bone_coordinates(Input<double, 3> positions, Input<int64_t, 1> parents, Input<int64_t, 2> program,
                                      Input<double, 3> rests, Input<double, 3> homes, Input<int64_t, 1> order,
                                      Input<int64_t, 1> joints, Input<int64_t, 2> pairs, Input<double, 3> pair_frames) {
    Schedule of{program.data(), order.data(), joints.data(), parents.data(), pairs.data(), rests.data(), homes.data(),
                pair_frames.data(), program.shape(0), rests.shape(0), homes.shape(0), 0};
    const int64_t points = int64_t(positions.shape(1)), bones = int64_t(of.bones), hubs = int64_t(of.hubs);
    bool fits = positions.shape(0) == 3 && parents.shape(0) == positions.shape(1) && program.shape(1) == 6 &&
                rests.size() == 9 * of.bones && homes.size() == 9 * of.hubs && order.shape(0) == of.bones &&
                joints.shape(0) >= of.bones && pairs.size() == 2 * of.hubs && pair_frames.size() == 9 * of.hubs;
    for (size_t i = 0; fits && i < of.steps; ++i) of.slots = std::max(of.slots, size_t(of.program[6 * i + 3] + 1));
    for (size_t i = 0; fits && i < of.steps; ++i) {
        const int64_t *p = of.program + 6 * i;
        fits = p[1] >= 0 && p[1] < (p[0] ? hubs : bones) && p[2] < int64_t(of.slots) && p[3] >= (p[0] ? 0 : -1);
    }
    auto is_joint = [&](int64_t j) { return j >= 0 && j < points && of.parents[j] >= 0 && of.parents[j] < points; };
    for (size_t b = 0; fits && b < of.bones; ++b)
        fits = of.order[b] >= 0 && of.order[b] < bones && is_joint(of.joints[b]);
    for (size_t i = 0; fits && i < 2 * of.hubs; ++i) fits = is_joint(of.pairs[i]);
    if (!fits) throw std::invalid_argument("tempo_bone_coordinates: the tree does not match");
    const size_t frames = positions.shape(2), dimensions = 2 * of.bones + 3 * of.hubs;
    const Positions from{positions.data(), positions.shape(1), frames};
    Fresh<double> out(dimensions * frames);
    {
        nb::gil_scoped_release release;
#ifdef HAS_AVX2_TWIN
        static const bool has_avx2 = processor_has_avx2();
        if (has_avx2) run_with_avx2(of, from, out.data.get());
        else
#endif
            run(of, from, out.data.get());
        unwrap_all(of.bones, of.hubs, out.data.get(), frames);
    }
    return out.give({dimensions, frames});
}

}  // namespace

void bind_bone_coordinates(nb::module_ &m) { m.def("tempo_bone_coordinates", &tempo_bone_coordinates); }
