// Gauss–Newton steps of the stock body's pose and proportions, for geometry/body_fit.py: residuals of points and surface
// samples as normal equations h x = g. The unknowns x are a translation of the root, logarithms of the proportions and a
// rotation vector of every joint, all in the world's axes.
//
//     pose, build ──capsules──► nearest places ──linearise──► sums by links ──joint hierarchy──► h, g ──priors──► solve
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "algebra3.h"
#include "arrays.h"
#include "kd_tree.h"
#include "pose_scorer.h"
#include "skinned_body.h"
#include "tree_solver.h"

class CapsuleFitter {
  public:
    static constexpr size_t PROPORTIONS = 6, TERMS = 6 + PROPORTIONS;

    // Constants of body_fit.py: weight of samples against points; the points' number as if independent, over their squared
    // noise; standard deviations of a proportion and of a joint that bends the wrong way; most turn and growth of a step.
    struct Constants {
        double back_weight, information, proportion_spread, hinge_spread, max_turn, max_growth;
    };

    // Body: links' parents (links,) and joints (links,). Joints: parents (joints,), offsets from them (joints, 3) of the
    // stock body, metres, and the proportions that scale them (joints,). Capsules: links (c,), joints at their ends (c, 2),
    // radii (c, 2) and the proportions that scale these (c,). Surface samples: capsules (m,), shares of the axis (m,) and
    // normals (m, 3). expected_turns (links,), radians; hinges (h,), their axes (h, 3). tree: the points.
    // hidden: 1 in cells that the points hide, or None.
    CapsuleFitter(Input<int64_t, 1> parents, Input<int64_t, 1> joints, Input<int64_t, 1> joint_parents,
                  Input<double, 2> offsets, Input<int64_t, 1> joint_scales, Input<int64_t, 1> carriers,
                  Input<int64_t, 2> ends, Input<double, 2> radii, Input<int64_t, 1> radius_scales,
                  Input<int64_t, 1> sample_capsules, Input<double, 1> shares, Input<double, 2> outward,
                  Input<double, 1> expected_turns, Input<int64_t, 1> hinges, Input<double, 2> axes,
                  Input<double, 1> constants, const KdTree &tree, const CellValues<uint8_t> *hidden)
        : links(parents.shape(0)), capsules(carriers.shape(0)), unknowns(3 + PROPORTIONS + 3 * links), parents(copy(parents)),
          joints(copy(joints)), joint_parents(copy(joint_parents)), joint_scales(copy(joint_scales)),
          carriers(copy(carriers)), ends(copy(ends)), radius_scales(copy(radius_scales)),
          sample_capsules(copy(sample_capsules)), hinges(copy(hinges)), offsets(copy(offsets)), radii(copy(radii)),
          shares(copy(shares)), outward(copy(outward)), expected_turns(copy(expected_turns)), axes(copy(axes)),
          tree(tree), hidden(hidden ? std::vector<CellValues<uint8_t>>{*hidden} : std::vector<CellValues<uint8_t>>{}) {
        const size_t j = joint_parents.shape(0), m = sample_capsules.shape(0);
        if (!links || joints.shape(0) != links || offsets.shape(0) != j || offsets.shape(1) != 3 ||
            joint_scales.shape(0) != j || ends.shape(0) != capsules || ends.shape(1) != 2 || !capsules ||
            radii.shape(0) != capsules || radii.shape(1) != 2 || radius_scales.shape(0) != capsules ||
            shares.shape(0) != m || outward.shape(0) != m || outward.shape(1) != 3 || expected_turns.shape(0) != links ||
            axes.shape(0) != hinges.shape(0) || axes.shape(1) != 3 || constants.shape(0) != 6 || tree.coloured || !tree.count)
            throw std::invalid_argument("CapsuleFitter: shapes differ");
        require(this->joints, j), require(this->ends, j), require(this->carriers, links), require(this->hinges, links);
        require(this->sample_capsules, capsules);
        require(this->joint_scales, PROPORTIONS), require(this->radius_scales, PROPORTIONS);
        for (const auto *of : {&this->parents, &this->joint_parents})
            for (size_t i = 0; i < of->size(); ++i)
                if ((*of)[i] >= int64_t(i) || ((*of)[i] < 0 && i))
                    throw std::invalid_argument("CapsuleFitter: a link comes before its parent, or there are two roots");
        std::copy_n(constants.data(), 6, &constant.back_weight);
    }

    // Rotations (links, 3, 3), root (3,) and proportions after a step for each of some widths of the robust weight, metres.
    nb::tuple refine(Input<double, 3> rotations, Input<double, 1> root, Input<double, 1> build, Input<double, 1> widths) {
        if (rotations.shape(0) != links || rotations.shape(1) != 3 || rotations.shape(2) != 3 || root.shape(0) != 3 ||
            build.shape(0) != PROPORTIONS)
            throw std::invalid_argument("CapsuleFitter.refine: shapes differ");
        turns.assign(rotations.data(), rotations.data() + 9 * links);
        std::copy_n(root.data(), 3, hips);
        std::copy_n(build.data(), PROPORTIONS, proportions);
        guesses.assign(sample_capsules.size(), -1);
        for (size_t step = 0; step < widths.shape(0); ++step) {
            pose();
            sums.assign(links, Sums{});
            add_points(widths.data()[step]);
            add_samples(widths.data()[step]);
            project_to_joints();
            add_priors();
            if (!solve_symmetric(h, g)) throw std::runtime_error("CapsuleFitter: the normal equations are singular");
            move();
        }
        Fresh<double> out(9 * links), out_root(3), out_build(PROPORTIONS);
        std::copy(turns.begin(), turns.end(), out.data.get());
        std::copy_n(hips, 3, out_root.data.get());
        std::copy_n(proportions, PROPORTIONS, out_build.data.get());
        return nb::make_tuple(out.give({links, 3, 3}), out_root.give({3}), out_build.give({PROPORTIONS}));
    }

  private:
    // Sums over the places on one link: f fᵀ, of which the upper triangle is set, and f times the residual, where a place's
    // distance changes by f · (v, ω, proportions).
    struct Sums {
        std::array<double, TERMS * TERMS> squares{};
        std::array<double, TERMS> right{};
    };

    // A capsule's first end, its axis, its first radius and how much larger the second one is; metres, or metres for each
    // unit of the logarithm of a proportion.
    struct Shape {
        double from[3], along[3], near, wider;

        // out = the place on the surface at a share of the axis, in the direction of a unit normal.
        void place(double share, const double *normal, double *out) const {
            const double radius = near + share * wider;
            for (int d = 0; d < 3; ++d) out[d] = from[d] + share * along[d] + radius * normal[d];
        }
    };

    static void require(const std::vector<int64_t> &numbers, size_t count) {
        for (int64_t number : numbers)
            if (number < 0 || number >= int64_t(count)) throw std::invalid_argument("CapsuleFitter: an index out of range");
    }

    // Sets rotations a, joints, and the shapes of the capsules: now, and their growth by each proportion.
    void pose() {
        a.resize(9 * links);
        for (size_t link = 0; link < links; ++link) {
            if (parents[link] < 0)
                std::copy_n(&turns[9 * link], 9, &a[9 * link]);
            else
                multiply(&a[9 * size_t(parents[link])], &turns[9 * link], &a[9 * link]);
        }
        place(proportions, hips, shapes, &places_of_joints);
        const double nowhere[3] = {0, 0, 0};
        for (size_t p = 0; p < PROPORTIONS; ++p) {
            double only[PROPORTIONS] = {};
            only[p] = proportions[p];
            place(only, nowhere, growth[p], nullptr);
        }
    }

    // Capsules of a build in the pose of rotations a: linear in the build and in the root.
    void place(const double *build, const double *root, std::vector<Shape> &out, std::vector<double> *joint_places) {
        stock.resize(offsets.size());
        for (size_t joint = 0; joint < joint_parents.size(); ++joint)
            for (size_t d = 0; d < 3; ++d)
                stock[3 * joint + d] = build[joint_scales[joint]] * offsets[3 * joint + d] +
                                       (joint_parents[joint] < 0 ? 0.0 : stock[3 * size_t(joint_parents[joint]) + d]);
        b.resize(3 * links);
        for (size_t link = 0; link < links; ++link) {
            const double *joint = &stock[3 * size_t(joints[link])];
            double own[3], above[3] = {0, 0, 0};
            const int64_t parent = parents[link];
            transform(&a[9 * link], joint, own);
            if (parent >= 0) transform(&a[9 * size_t(parent)], joint, above);
            for (size_t d = 0; d < 3; ++d)
                b[3 * link + d] = above[d] - own[d] + (parent < 0 ? root[d] : b[3 * size_t(parent) + d]);
        }
        out.resize(capsules);
        for (size_t c = 0; c < capsules; ++c) {
            const size_t link = size_t(carriers[c]);
            double to[3];
            transform(&a[9 * link], &stock[3 * size_t(ends[2 * c])], out[c].from);
            transform(&a[9 * link], &stock[3 * size_t(ends[2 * c + 1])], to);
            for (int d = 0; d < 3; ++d) out[c].along[d] = to[d] - out[c].from[d], out[c].from[d] += b[3 * link + size_t(d)];
            const double scale = build[radius_scales[c]];
            out[c].near = scale * radii[2 * c], out[c].wider = scale * (radii[2 * c + 1] - radii[2 * c]);
        }
        if (!joint_places) return;
        joint_places->resize(3 * links);
        for (size_t link = 0; link < links; ++link) {
            transform(&a[9 * link], &stock[3 * size_t(joints[link])], &(*joint_places)[3 * link]);
            for (size_t d = 0; d < 3; ++d) (*joint_places)[3 * link + d] += b[3 * link + d];
        }
    }

    // Adds the distance of each point across the nearest capsule's surface.
    void add_points(double width) {
        find_nearest_capsules();
        for (size_t i = 0; i < tree.count; ++i) {
            const double *x = tree.point(i);
            const Shape &shape = shapes[nearest[i]];
            double normal[3], y[3];
            for (int d = 0; d < 3; ++d) normal[d] = x[d] - shape.from[d] - foot[i] * shape.along[d];
            const double length = std::max(std::sqrt(dot(normal, normal)), 1e-6);
            for (double &n : normal) n /= length;
            shape.place(foot[i], normal, y);
            const double gap[3] = {x[0] - y[0], x[1] - y[1], x[2] - y[2]};
            double grown[PROPORTIONS][3];
            grow(nearest[i], foot[i], normal, grown);
            add(nearest[i], y, normal, grown, robust(gap, width), dot(normal, gap));
        }
    }

    // Adds the distance of each surface sample from the nearest point in all directions.
    void add_samples(double width) {
        static constexpr double UNITS[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
        const double share = constant.back_weight * double(tree.count) / double(sample_capsules.size());
        for (size_t s = 0; s < sample_capsules.size(); ++s) {
            const size_t c = size_t(sample_capsules[s]);
            double normal[3], y[6] = {}, limit = squared(3 * width);  // a query of the tree has room for colours
            transform(&a[9 * size_t(carriers[c])], &outward[3 * s], normal);
            shapes[c].place(shares[s], normal, y);
            const int64_t found = tree.nearest_from(guesses[s], y, limit);
            if (found < 0 || (!hidden.empty() && hidden[0].at(y))) continue;
            guesses[s] = found;
            const double *x = tree.point(size_t(found));
            const double gap[3] = {x[0] - y[0], x[1] - y[1], x[2] - y[2]}, weight = share * robust(gap, width);
            double grown[PROPORTIONS][3];
            grow(c, shares[s], normal, grown);
            for (int d = 0; d < 3; ++d) add(c, y, UNITS[d], grown, weight, gap[d]);
        }
    }

    // Weight of a gap (Geman–McClure).
    static double robust(const double *gap, double width) {
        return squared(width * width / (width * width + dot(gap, gap)));
    }

    // Derivatives of a place on a capsule by the logarithms of the proportions.
    void grow(size_t c, double share, const double *normal, double (*grown)[3]) const {
        for (size_t p = 0; p < PROPORTIONS; ++p) growth[p][c].place(share, normal, grown[p]);
    }

    // Adds a place y whose distance along a unit vector should change by `residual`.
    void add(size_t c, const double *y, const double *across, const double (*grown)[3], double weight, double residual) {
        double f[TERMS];
        std::copy_n(across, 3, f);
        cross(y, across, f + 3);
        for (size_t p = 0; p < PROPORTIONS; ++p) f[6 + p] = dot(across, grown[p]);
        Sums &sum = sums[size_t(carriers[c])];
        for (size_t i = 0; i < TERMS; ++i) {
            const double weighted = weight * f[i];
            double *row = &sum.squares[TERMS * i];
            for (size_t j = i & ~size_t(1); j < TERMS; ++j) row[j] += weighted * f[j];
            sum.right[i] += weighted * residual;
        }
    }

    // Sets the capsule with the nearest surface to each point, and the place along its axis, 0 to 1.
    void find_nearest_capsules() {
        nearest.resize(tree.count);
        foot.resize(tree.count);
        inverse.resize(capsules);
        for (size_t c = 0; c < capsules; ++c) inverse[c] = 1 / std::max(dot(shapes[c].along, shapes[c].along), 1e-6);
        for (size_t i = 0; i < tree.count; ++i) {
            const double *x = tree.point(i);
            double best = std::numeric_limits<double>::infinity();
            for (size_t c = 0; c < capsules; ++c) {
                const Shape &shape = shapes[c];
                const double from[3] = {x[0] - shape.from[0], x[1] - shape.from[1], x[2] - shape.from[2]};
                const double share = std::clamp(dot(from, shape.along) * inverse[c], 0.0, 1.0);
                const double out[3] = {from[0] - share * shape.along[0], from[1] - share * shape.along[1],
                                       from[2] - share * shape.along[2]};
                const double distance = std::abs(std::sqrt(dot(out, out)) - (shape.near + share * shape.wider));
                if (distance < best) best = distance, nearest[i] = c, foot[i] = share;
            }
        }
    }

    // Row of h and g of a joint's rotation.
    static size_t row_of(size_t link) { return 3 + PROPORTIONS + 3 * link; }

    // Sets h and g from the sums over subtrees: the Jacobian of a subtree's motion (v, ω) is [p]× above I for the rotation
    // of its joint at p, and I above 0 for the root's translation.
    void project_to_joints() {
        for (Sums &sum : sums)
            for (size_t i = 0; i < TERMS; ++i)
                for (size_t j = 0; j < i; ++j) sum.squares[TERMS * i + j] = sum.squares[TERMS * j + i];
        for (size_t link = links; link-- > 1;) {
            Sums &above = sums[size_t(parents[link])];
            for (size_t i = 0; i < TERMS * TERMS; ++i) above.squares[i] += sums[link].squares[i];
            for (size_t i = 0; i < TERMS; ++i) above.right[i] += sums[link].right[i];
        }
        h.assign(unknowns * unknowns, 0.0);
        g.assign(unknowns, 0.0);
        const double scale = constant.information / double(tree.count);
        for (size_t link = 0; link < links; ++link) project_link(link, scale);
        const Sums &all = sums[0];
        for (size_t i = 0; i < 3 + PROPORTIONS; ++i) {
            const size_t term = i < 3 ? i : i + 3;
            g[i] = scale * all.right[term];
            for (size_t j = 0; j < 3 + PROPORTIONS; ++j)
                h[i * unknowns + j] = scale * all.squares[TERMS * term + (j < 3 ? j : j + 3)];
        }
    }

    // Sets h and g of the rotation of a link's joint, with those above it and with root and proportions.
    void project_link(size_t link, double scale) {
        const Sums &sum = sums[link];
        const double *p = &places_of_joints[3 * link];
        double moved[3][TERMS];  // Jᵀ S, J of this joint
        for (size_t t = 0; t < TERMS; ++t) {
            const double v[3] = {sum.squares[t], sum.squares[TERMS + t], sum.squares[2 * TERMS + t]};
            double moment[3];
            cross(p, v, moment);
            for (size_t d = 0; d < 3; ++d) moved[d][t] = scale * (sum.squares[TERMS * (3 + d) + t] - moment[d]);
        }
        const size_t row = row_of(link);
        for (size_t d = 0; d < 3; ++d) {
            for (size_t t = 0; t < 3; ++t) set(row + d, t, moved[d][t]);
            for (size_t t = 0; t < PROPORTIONS; ++t) set(row + d, 3 + t, moved[d][6 + t]);
            for (int64_t above = int64_t(link); above >= 0; above = parents[size_t(above)]) {
                double moment[3];
                cross(&places_of_joints[3 * size_t(above)], moved[d], moment);
                for (size_t k = 0; k < 3; ++k) set(row + d, row_of(size_t(above)) + k, moved[d][3 + k] - moment[k]);
            }
        }
        double moment[3];
        cross(p, sum.right.data(), moment);
        for (size_t d = 0; d < 3; ++d) g[row + d] = scale * (sum.right[3 + d] - moment[d]);
    }

    void set(size_t row, size_t column, double value) {
        h[row * unknowns + column] = value;
        h[column * unknowns + row] = value;
    }

    // Adds penalties of rotations from the stock body's pose, of joints that bend the wrong way, and of differences between
    // the proportions.
    void add_priors() {
        for (size_t link = 0; link < links; ++link) {
            double vector[3], world[3];
            const size_t row = row_of(link);
            const double strength = 1 / squared(expected_turns[link]);
            logarithm(&turns[9 * link], vector);
            to_world(link, vector, world);
            for (size_t d = 0; d < 3; ++d)
                h[(row + d) * unknowns + row + d] += strength, g[row + d] -= strength * world[d];
            for (size_t k = 0; k < hinges.size(); ++k) {
                const double bend = dot(vector, &axes[3 * k]), hinge_strength = 1 / squared(constant.hinge_spread);
                if (hinges[k] != int64_t(link) || bend >= 0) continue;
                to_world(link, &axes[3 * k], world);
                for (size_t i = 0; i < 3; ++i) {
                    g[row + i] -= hinge_strength * bend * world[i];
                    for (size_t j = 0; j < 3; ++j) h[(row + i) * unknowns + row + j] += hinge_strength * world[i] * world[j];
                }
            }
        }
        const double strength = 1 / squared(constant.proportion_spread);
        double mean = 0;
        for (double factor : proportions) mean += std::log(factor) / double(PROPORTIONS);
        for (size_t i = 0; i < PROPORTIONS; ++i) {
            for (size_t j = 0; j < PROPORTIONS; ++j)
                h[(3 + i) * unknowns + 3 + j] += strength * (double(i == j) - 1 / double(PROPORTIONS)) + 0.1 * double(i == j);
            g[3 + i] -= strength * (std::log(proportions[i]) - mean);
        }
    }

    // out = a vector of the frame of a link's parent, in the world's axes.
    void to_world(size_t link, const double *vector, double *out) const {
        if (parents[link] < 0)
            std::copy_n(vector, 3, out);
        else
            transform(&a[9 * size_t(parents[link])], vector, out);
    }

    // Takes the step g.
    void move() {
        for (size_t d = 0; d < 3; ++d) hips[d] += g[d];
        for (size_t p = 0; p < PROPORTIONS; ++p)
            proportions[p] *= std::exp(std::clamp(g[3 + p], -constant.max_growth, constant.max_growth));
        for (size_t link = 0; link < links; ++link) {
            double *turn = &g[row_of(link)], own[3], matrix[9], turned[9];
            const double scale = std::min(1.0, constant.max_turn / std::max(std::sqrt(dot(turn, turn)), 1e-9));
            for (size_t d = 0; d < 3; ++d) turn[d] *= scale;
            if (parents[link] < 0)
                std::copy_n(turn, 3, own);
            else
                transform_back(&a[9 * size_t(parents[link])], turn, own);
            exponential(own, matrix);
            multiply(matrix, &turns[9 * link], turned);
            std::copy_n(turned, 9, &turns[9 * link]);
        }
    }

    const size_t links, capsules, unknowns;
    const std::vector<int64_t> parents, joints, joint_parents, joint_scales, carriers, ends, radius_scales, sample_capsules,
        hinges;
    const std::vector<double> offsets, radii, shares, outward, expected_turns, axes;
    const KdTree tree;
    const std::vector<CellValues<uint8_t>> hidden;  // none or one
    Constants constant;
    std::vector<double> turns, a, b, stock, places_of_joints, foot, inverse, h, g;
    double hips[3], proportions[PROPORTIONS];
    std::vector<Shape> shapes;
    std::array<std::vector<Shape>, PROPORTIONS> growth;
    std::vector<size_t> nearest;
    std::vector<int64_t> guesses;  // the last point of each sample
    std::vector<Sums> sums;
};
