// One Gauss–Newton step of a body's pose: residuals of correspondences and priors, summed into normal equations h x = g.
//
// The unknowns x are a translation of the root and a rotation vector of every joint, all in the world's axes. A template
// point y that follows link l moves by v_l + ω_l × y; its distance across the surface changes by f · (v, ω) with
// f = (n, y × n). Sums of f fᵀ for each pair of links give the normal equations of the links' motions (v, ω), and the
// joint hierarchy turns these into the joints'.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "algebra3.h"
#include "joint_limits.h"
#include "skinned_body.h"

class NormalEquations {
  public:
    explicit NormalEquations(const SkinnedBody &body)
        : body(body), unknowns(3 + 3 * body.count), pair_of_row(body.rows), targets(body.rows) {
        std::vector<int64_t> numbers(body.count * body.count, -1);
        for (size_t row = 0; row < body.rows; ++row) {
            const int64_t key = body.links[2 * row] * int64_t(body.count) + body.links[2 * row + 1];
            if (numbers[key] < 0) numbers[key] = int64_t(pairs.size()), pairs.push_back(key);
            pair_of_row[row] = numbers[key];
        }
    }

    void begin() {
        for (int64_t row : touched) targets[row] = Target{};
        touched.clear();
    }

    // A correspondence of a template row and the place that it should move to. width: of the robust weight
    // (Geman–McClure), metres; noise: of the data, metres.
    void add_correspondence(int64_t row, const double *place, double width, double noise) {
        Target &sum = targets[row];
        if (!sum.is_posed) body.pose_point(row, sum.at), sum.is_posed = true, touched.push_back(row);
        const double gap[3] = {place[0] - sum.at[0], place[1] - sum.at[1], place[2] - sum.at[2]};
        const double weight = squared(width * width / (width * width + dot(gap, gap))) / squared(noise);
        sum.weight += weight;
        for (int d = 0; d < 3; ++d) sum.gap[d] += weight * gap[d];
    }

    // h and g of all correspondences. tangential: weight of distances along the surface against those across it.
    void linearise(double tangential) {
        sums.assign(pairs.size(), PairSums{});
        for (int64_t row : touched)
            if (targets[row].weight > 0) add_to_pair(row, targets[row], tangential);
        expand_pairs();
        sum_subtrees();
        project_to_joints();
    }

    // Priors: towards the pose at the start (strengths[0] of each link, root_strength of the root's place) and towards
    // the rest rotations (strengths[1]). Strengths are one over radians squared, or one over square metres.
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

    // Towards the nearest allowed rotation, if a link is beyond its limits. limited_axis (3,): the axis of the rotation
    // that led beyond, set here; later steps resist rotations about it, or they would leave the limits again.
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

    // g becomes the solution x, by a Cholesky decomposition from the last unknown to the first: a joint then couples only
    // to its ancestors and to the few links that share its skin. False if h is not positive definite.
    bool solve() {
        const size_t n = unknowns;
        std::vector<size_t> coupled;
        coupled.reserve(n);
        for (size_t j = n; j-- > 0;) {
            double *row = &h[j * n];
            if (!(row[j] > 0)) return false;
            const double scale = 1 / std::sqrt(row[j]);
            coupled.clear();
            for (size_t k = 0; k < j; ++k)
                if (row[k] != 0) row[k] *= scale, coupled.push_back(k);
            row[j] *= scale;
            g[j] *= scale;
            for (size_t i : coupled) {
                double *other = &h[i * n];
                for (size_t k : coupled) {
                    if (k > i) break;
                    other[k] -= row[i] * row[k];
                }
                g[i] -= row[i] * g[j];
            }
        }
        for (size_t i = 0; i < n; ++i) {
            double sum = g[i];
            for (size_t k = 0; k < i; ++k) sum -= h[i * n + k] * g[k];
            g[i] = sum / h[i * n + i];
        }
        return true;
    }

    const double *solution() const { return g.data(); }

  private:
    // Symmetric sums over the template points that follow one pair of links: the upper triangle of f fᵀ, weighted by
    // first², first · second and second² of the skinning weights; and f times the residual, weighted by each.
    struct PairSums {
        double square[3][21];
        double right[2][6];
    };

    // The correspondences of one template row: where it is posed, the sum of their weights, and of weighted gaps.
    struct Target {
        double at[3] = {0, 0, 0}, weight = 0, gap[3] = {0, 0, 0};
        bool is_posed = false;
    };

    void add_to_pair(int64_t row, const Target &target, double tangential) {
        double n[3], f[6];
        const double *y = target.at, *gap = target.gap;
        transform(&body.a[9 * body.links[2 * row]], &body.normals[3 * row], n);
        std::copy_n(n, 3, f);
        cross(y, n, f + 3);
        double outer[21], right[6], moment[3];
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
        const double first = body.weights[row], second = 1 - first;
        const double weight = target.weight;
        const double shares[3] = {weight * first * first, weight * first * second, weight * second * second};
        if (second == 0) {
            for (int i = 0; i < 21; ++i) sum.square[0][i] += shares[0] * outer[i];
            for (int i = 0; i < 6; ++i) sum.right[0][i] += right[i];
            return;
        }
        for (int s = 0; s < 3; ++s)
            for (int i = 0; i < 21; ++i) sum.square[s][i] += shares[s] * outer[i];
        for (int i = 0; i < 6; ++i) {
            sum.right[0][i] += first * right[i];
            sum.right[1][i] += second * right[i];
        }
    }

    // The upper triangle of t (I, −[y]×)ᵀ (I, −[y]×): point-to-point distances, weakly.
    static void add_tangential(const double *y, double t, double *outer) {
        const double square = dot(y, y);
        outer[0] += t;
        outer[6] += t;
        outer[11] += t;
        outer[4] += t * y[2];
        outer[5] -= t * y[1];
        outer[8] -= t * y[2];
        outer[10] += t * y[0];
        outer[12] += t * y[1];
        outer[13] -= t * y[0];
        outer[15] += t * (square - y[0] * y[0]);
        outer[18] += t * (square - y[1] * y[1]);
        outer[20] += t * (square - y[2] * y[2]);
        outer[16] -= t * y[0] * y[1];
        outer[17] -= t * y[0] * y[2];
        outer[19] -= t * y[1] * y[2];
    }

    // Sums by pairs of links into 6 × 6 blocks of the links' normal equations, and vectors of 6.
    void expand_pairs() {
        const size_t count = body.count;
        blocks.assign(count * count * 36, 0.0);
        vectors.assign(count * 6, 0.0);
        for (size_t p = 0; p < pairs.size(); ++p) {
            const size_t l0 = size_t(pairs[p]) / count, l1 = size_t(pairs[p]) % count;
            const size_t where[4][2] = {{l0, l0}, {l0, l1}, {l1, l0}, {l1, l1}};
            const int which[4] = {0, 1, 1, 2};
            for (int k = 0; k < 4; ++k) {
                double *block = &blocks[(where[k][0] * count + where[k][1]) * 36];
                int at = 0;
                for (int i = 0; i < 6; ++i)
                    for (int j = i; j < 6; ++j, ++at) {
                        block[6 * i + j] += sums[p].square[which[k]][at];
                        if (i != j) block[6 * j + i] += sums[p].square[which[k]][at];
                    }
            }
            for (int i = 0; i < 6; ++i) vectors[6 * l0 + i] += sums[p].right[0][i];
            for (int i = 0; i < 6; ++i) vectors[6 * l1 + i] += sums[p].right[1][i];
        }
    }

    // A joint moves all links of its subtree alike: blocks and vectors become sums over subtrees.
    void sum_subtrees() {
        const size_t count = body.count;
        for (size_t link = count; link-- > 1;) {  // rows, then columns, up the tree
            const int64_t parent = body.parents[link];
            if (parent < 0) continue;
            for (size_t i = 0; i < count * 36; ++i) blocks[parent * count * 36 + i] += blocks[link * count * 36 + i];
            for (int i = 0; i < 6; ++i) vectors[6 * parent + i] += vectors[6 * link + i];
        }
        for (size_t row = 0; row < count; ++row)
            for (size_t link = count; link-- > 1;) {
                const int64_t parent = body.parents[link];
                if (parent < 0) continue;
                for (int i = 0; i < 36; ++i)
                    blocks[(row * count + parent) * 36 + i] += blocks[(row * count + link) * 36 + i];
            }
    }

    // h and g of the unknowns from the sums over subtrees.
    void project_to_joints() {
        const size_t count = body.count;
        h.assign(unknowns * unknowns, 0.0);
        g.assign(unknowns, 0.0);
        // Jacobians (6, 3) of the motion (v, ω) of a subtree: by the rotation of its joint at p, [p]× above I; by the
        // root's translation, I above 0
        Doubles jacobian(18 * (count + 1), 0.0);
        std::vector<size_t> subtree(count + 1, 0);
        for (int d = 0; d < 3; ++d) jacobian[3 * d + d] = 1;
        for (size_t link = 0; link < count; ++link) {
            double p[3];
            transform(&body.a[9 * link], &body.origins[3 * link], p);
            for (int d = 0; d < 3; ++d) p[d] += body.b[3 * link + d];
            double *m = &jacobian[18 * (link + 1)];
            m[1] = -p[2], m[2] = p[1], m[3] = p[2], m[5] = -p[0], m[6] = -p[1], m[7] = p[0];
            m[9] = m[13] = m[17] = 1;
            subtree[link + 1] = link;
        }
        for (size_t i = 0; i <= count; ++i) {
            const double *left = &jacobian[18 * i];
            for (size_t j = i; j <= count; ++j) {
                const double *block = &blocks[(subtree[i] * count + subtree[j]) * 36], *right = &jacobian[18 * j];
                if (std::all_of(block, block + 36, [](double x) { return x == 0; })) continue;
                double half[18] = {};
                for (int r = 0; r < 6; ++r)
                    for (int k = 0; k < 6; ++k)
                        for (int c = 0; c < 3; ++c) half[3 * r + c] += block[6 * r + k] * right[3 * k + c];
                for (int r = 0; r < 3; ++r)
                    for (int c = 0; c < 3; ++c) {
                        double sum = 0;
                        for (int k = 0; k < 6; ++k) sum += left[3 * k + r] * half[3 * k + c];
                        h[(3 * i + r) * unknowns + 3 * j + c] = sum;
                        h[(3 * j + c) * unknowns + 3 * i + r] = sum;
                    }
            }
            for (int r = 0; r < 3; ++r)
                for (int k = 0; k < 6; ++k) g[3 * i + r] += left[3 * k + r] * vectors[6 * subtree[i] + k];
        }
    }

    const SkinnedBody &body;
    const size_t unknowns;
    std::vector<int64_t> pair_of_row, pairs;  // pairs of links that share template points: first · links + second
    std::vector<Target> targets;
    std::vector<int64_t> touched;  // template rows that have correspondences
    std::vector<PairSums> sums;
    Doubles blocks, vectors, h, g;
};
