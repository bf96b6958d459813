// Gauss–Newton step for a body's pose: residuals of correspondences and priors, summed into normal equations h x = g.
//
// The unknowns x are a translation of the root and a rotation vector of every joint, all in the world's axes. A template
// point y that follows link l moves by v_l + ω_l × y; its distance across the surface changes by f · (v, ω) with
// f = (n, y × n). Sums of f fᵀ for each pair of links give the normal equations of the links' motions (v, ω); the joint
// hierarchy turns them into those of the joints.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "algebra3.h"
#include "joint_limits.h"
#include "skinned_body.h"
#include "tree_solver.h"

class NormalEquations {
  public:
    explicit NormalEquations(const SkinnedBody &body)
        : body(body), unknowns(3 + 3 * body.count), pair_of_row(body.rows), targets(body.rows) {
        std::vector<int64_t> numbers(body.count * body.count, -1);
        for (size_t row = 0; row < body.rows; ++row) {
            const int64_t key = body.points[row].first * int64_t(body.count) + body.points[row].second;
            if (numbers[key] < 0) numbers[key] = int64_t(pairs.size()), pairs.push_back(key);
            pair_of_row[row] = numbers[key];
        }
        plan_blocks();
    }

    void begin() {
        for (int64_t row : touched) targets[row] = Target{};
        touched.clear();
    }

    // Adds a correspondence of a template row with its target place. width: of the robust weight (Geman–McClure),
    // metres; noise: of the data, metres.
    void add_correspondence(int64_t row, const double *place, double width, double noise) {
        Target &sum = targets[row];
        if (!sum.is_posed) body.pose_point(row, sum.at), sum.is_posed = true, touched.push_back(row);
        const double gap[3] = {place[0] - sum.at[0], place[1] - sum.at[1], place[2] - sum.at[2]};
        const double weight = squared(width * width / (width * width + dot(gap, gap))) / squared(noise);
        sum.weight += weight;
        for (int d = 0; d < 3; ++d) sum.gap[d] += weight * gap[d];
    }

    // Computes h and g of all correspondences. tangential: weight of distances along the surface, relative to across it.
    void linearise(double tangential) {
        sums.assign(pairs.size(), PairSums{});
        for (int64_t row : touched)
            if (targets[row].weight > 0) add_to_pair(row, targets[row], tangential);
        expand_pairs();
        sum_subtrees();
        project_to_joints();
    }

    // Adds priors: towards the start pose (strengths[0] for each link, root_strength for the root's place) and towards
    // the rest rotations (strengths[1]). Units: 1 / rad² and 1 / m².
    void add_priors(const Doubles &start, const double *start_root, const double *rest, const double *strengths,
                    double root_strength) {
        for (int d = 0; d < 3; ++d) {
            g[d] -= (body.root[d] - start_root[d]) * root_strength;
            h[d * (unknowns + 1)] += root_strength;
        }
        for (size_t link = 0; link < body.count; ++link) {
            double difference[9], off[3], world[3];
            for (int which = 0; which < 2; ++which) {
                const double strength = strengths[which * body.count + link];
                if (strength == 0) continue;
                multiply(&body.rotations[9 * link], which ? rest + 9 * link : &start[9 * link], difference, true);
                logarithm(difference, off);
                body.to_world(link, off, world);
                for (int d = 0; d < 3; ++d) {
                    g[3 + 3 * link + d] -= strength * world[d];
                    h[(3 + 3 * link + d) * (unknowns + 1)] += strength;
                }
            }
        }
    }

    // Adds a prior towards the nearest allowed rotation, if a link is beyond its limits. limited_axis (3,): axis of the
    // rotation beyond them, set here; later steps resist rotations about it, or they would leave the limits again.
    void add_limit(size_t link, const double *limit, double strength, double *limited_axis) {
        double allowed[9], difference[9], off[3], world[3];
        const double *rotation = &body.rotations[9 * link];
        if (nearest_allowed(limit, rotation, allowed)) {
            multiply(rotation, allowed, difference, true);
            logarithm(difference, off);
            body.to_world(link, off, world);
            const double length = std::max(std::sqrt(dot(off, off)), 1e-12);
            for (int i = 0; i < 3; ++i) g[3 + 3 * link + i] -= strength * world[i], limited_axis[i] = off[i] / length;
        }
        if (dot(limited_axis, limited_axis) == 0) return;
        body.to_world(link, limited_axis, world);
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) h[(3 + 3 * link + i) * unknowns + 3 + 3 * link + j] += strength * world[i] * world[j];
    }

    // Replaces g by the solution x. False if h is not positive definite.
    bool solve() { return solve_symmetric(h, g); }

    const double *solution() const { return g.data(); }

  private:
    static constexpr size_t SYMMETRIC = 21;  // numbers of the upper triangle of a 6 × 6 matrix, row by row

    // Sums over the template points of one pair of links: the upper triangle of f fᵀ with the tangential part, weighted by
    // first², first · second and second² of the skinning weights; and f times the residual, weighted by first and by second.
    struct PairSums {
        double square[3][SYMMETRIC];
        double right[2][6];
    };

    // Addition of one block of a matrix to another.
    struct Addition {
        size_t to, from;
    };

    // Correspondences of one template row: its posed place, the sum of their weights, and of weighted gaps.
    struct alignas(64) Target {
        double at[3] = {0, 0, 0}, weight = 0, gap[3] = {0, 0, 0};
        bool is_posed = false;
    };

    // Plans the blocks that can be nonzero, and the additions that sum blocks of links over subtrees: a joint moves all
    // links of its subtree alike.
    void plan_blocks() {
        const size_t count = body.count;
        number_of_block.assign(count * count, -1);
        for (int64_t pair : pairs) {
            const size_t l0 = size_t(pair) / count, l1 = size_t(pair) % count;
            for (size_t key : {l0 * count + l0, l0 * count + l1, l1 * count + l0, l1 * count + l1}) block_at(key);
        }
        for (size_t link = count; link-- > 1;)  // rows, then columns, up the tree
            for (size_t column = 0; body.parents[link] >= 0 && column < count; ++column)
                add_block(size_t(body.parents[link]) * count + column, link * count + column);
        for (size_t row = 0; row < count; ++row)
            for (size_t link = count; link-- > 1;)
                if (body.parents[link] >= 0) add_block(row * count + size_t(body.parents[link]), row * count + link);
    }

    size_t block_at(size_t key) {
        if (number_of_block[key] < 0) number_of_block[key] = int64_t(block_count++);
        return size_t(number_of_block[key]);
    }

    void add_block(size_t to, size_t from) {
        if (number_of_block[from] >= 0) additions.push_back({block_at(to), size_t(number_of_block[from])});
    }

    void add_to_pair(int64_t row, const Target &target, double tangential) {
        const TemplatePoint &point = body.points[size_t(row)];
        double n[3], f[6], moment[3];
        const double *y = target.at, *gap = target.gap;
        transform(&body.a[9 * point.first], point.normal, n);
        std::copy_n(n, 3, f);
        cross(y, n, f + 3);
        double outer[SYMMETRIC], right[6];
        int at = 0;
        for (int i = 0; i < 6; ++i)
            for (int j = i; j < 6; ++j) outer[at++] = f[i] * f[j];
        add_tangential(y, tangential, outer);
        cross(y, gap, moment);
        const double across = dot(n, gap);
        for (int d = 0; d < 3; ++d) {
            right[d] = f[d] * across + tangential * gap[d];
            right[3 + d] = f[3 + d] * across + tangential * moment[d];
        }
        PairSums &sum = sums[pair_of_row[row]];
        const double first = point.weight, second = 1 - first, weight = target.weight;
        const double shares[3] = {weight * first * first, weight * first * second, weight * second * second};
        if (second == 0)
            for (size_t i = 0; i < SYMMETRIC; ++i) sum.square[0][i] += shares[0] * outer[i];
        else
            for (size_t i = 0; i < SYMMETRIC; ++i)
                for (int s = 0; s < 3; ++s) sum.square[s][i] += shares[s] * outer[i];
        for (int i = 0; i < 6; ++i) {
            sum.right[0][i] += first * right[i];
            sum.right[1][i] += second * right[i];
        }
    }

    // Adds t · (I, −[y]×)ᵀ (I, −[y]×), the term of point-to-point distances, to an upper triangle.
    static void add_tangential(const double *y, double t, double *outer) {
        const double x = t * y[0], u = t * y[1], z = t * y[2];
        outer[0] += t;
        outer[6] += t;
        outer[11] += t;
        outer[4] += z;
        outer[5] -= u;
        outer[8] -= z;
        outer[10] += x;
        outer[12] += u;
        outer[13] -= x;
        outer[15] += u * y[1] + z * y[2];
        outer[18] += x * y[0] + z * y[2];
        outer[20] += x * y[0] + u * y[1];
        outer[16] -= x * y[1];
        outer[17] -= x * y[2];
        outer[19] -= u * y[2];
    }

    // Expands sums of link pairs into blocks of the links' normal equations, and vectors of 6.
    void expand_pairs() {
        const size_t count = body.count;
        blocks.assign(block_count * SYMMETRIC, 0.0);
        vectors.assign(count * 6, 0.0);
        for (size_t p = 0; p < pairs.size(); ++p) {
            const size_t l0 = size_t(pairs[p]) / count, l1 = size_t(pairs[p]) % count;
            const size_t where[4] = {l0 * count + l0, l0 * count + l1, l1 * count + l0, l1 * count + l1};
            const int which[4] = {0, 1, 1, 2};
            for (int k = 0; k < 4; ++k) {
                double *block = &blocks[size_t(number_of_block[where[k]]) * SYMMETRIC];
                for (size_t i = 0; i < SYMMETRIC; ++i) block[i] += sums[p].square[which[k]][i];
            }
            for (int i = 0; i < 6; ++i) vectors[6 * l0 + i] += sums[p].right[0][i];
            for (int i = 0; i < 6; ++i) vectors[6 * l1 + i] += sums[p].right[1][i];
        }
    }

    // Sums blocks and vectors over subtrees.
    void sum_subtrees() {
        for (const Addition &addition : additions) {
            const double *from = &blocks[addition.from * SYMMETRIC];
            double *to = &blocks[addition.to * SYMMETRIC];
            for (size_t i = 0; i < SYMMETRIC; ++i) to[i] += from[i];
        }
        for (size_t link = body.count; link-- > 1;)
            for (int i = 0; body.parents[link] >= 0 && i < 6; ++i)
                vectors[6 * body.parents[link] + i] += vectors[6 * link + i];
    }

    // Computes h and g of the unknowns from the sums over subtrees. The Jacobian of a subtree's motion (v, ω) is [p]×
    // above I for the rotation of its joint at p, and I above 0 for the root's translation.
    void project_to_joints() {
        const size_t count = body.count;
        h.assign(unknowns * unknowns, 0.0);
        g.assign(unknowns, 0.0);
        joints.resize(3 * count);
        for (size_t link = 0; link < count; ++link) body.place(link, &body.origins[3 * link], &joints[3 * link]);
        for (size_t i = 0; i < count; ++i)
            for (size_t j = i; j < count; ++j)
                if (number_of_block[i * count + j] >= 0)
                    project_block(i, j, &blocks[size_t(number_of_block[i * count + j]) * SYMMETRIC]);
        std::copy_n(vectors.begin(), 3, g.begin());
        for (size_t i = 0; i < count; ++i) {
            const double *v = &vectors[6 * i];
            double moment[3];
            cross(&joints[3 * i], v, moment);
            for (int d = 0; d < 3; ++d) g[3 + 3 * i + d] = v[3 + d] - moment[d];
        }
    }

    // h of the joints of links i ≤ j from their block (V C; Cᵀ W); for link 0 also h of the root's translation.
    void project_block(size_t i, size_t j, const double *block) {
        const double v[9] = {block[0], block[1], block[2], block[1], block[6], block[7], block[2], block[7], block[11]};
        const double c[9] = {block[3],  block[4],  block[5],  block[8], block[9],
                             block[10], block[12], block[13], block[14]};
        const double w[9] = {block[15], block[16], block[17], block[16], block[18],
                             block[19], block[17], block[19], block[20]};
        double above[9], below[9], moment[3];  // V [p]× + C and Cᵀ [p]× + W, for the joint of link j at p
        const double *p = &joints[3 * j], *q = &joints[3 * i];
        for (int r = 0; r < 3; ++r) {
            const double column[3] = {c[r], c[3 + r], c[6 + r]};
            cross(v + 3 * r, p, moment);
            for (int d = 0; d < 3; ++d) above[3 * r + d] = moment[d] + c[3 * r + d];
            cross(column, p, moment);
            for (int d = 0; d < 3; ++d) below[3 * r + d] = moment[d] + w[3 * r + d];
        }
        for (int d = 0; d < 3; ++d) {  // [q]×ᵀ above + below
            const double column[3] = {above[d], above[3 + d], above[6 + d]};
            cross(q, column, moment);
            for (int r = 0; r < 3; ++r) set_symmetric(3 + 3 * i + r, 3 + 3 * j + d, below[3 * r + d] - moment[r]);
        }
        if (i) return;
        for (int r = 0; r < 3; ++r)
            for (int d = 0; d < 3; ++d) {
                set_symmetric(r, 3 + 3 * j + d, above[3 * r + d]);
                if (!j) h[r * unknowns + d] = v[3 * r + d];
            }
    }

    void set_symmetric(size_t row, size_t column, double value) {
        h[row * unknowns + column] = value;
        h[column * unknowns + row] = value;
    }

    const SkinnedBody &body;
    const size_t unknowns;
    std::vector<int64_t> pair_of_row, pairs;  // pairs of links that share template points: first · links + second
    std::vector<Target> targets;
    std::vector<int64_t> touched;  // template rows with correspondences
    std::vector<int64_t> number_of_block;  // (links, links); −1: the block stays zero
    std::vector<Addition> additions;
    size_t block_count = 0;
    std::vector<PairSums> sums;
    Doubles blocks, vectors, joints, h, g;
};
