// Random search for the pose of one limb: draws hypotheses near known poses and towards unexplained points, scores
// them, resamples near the best, and keeps a few distinct ones. geometry/limb_search.py defines the result.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "algebra3.h"
#include "joint_limits.h"
#include "kd_tree.h"
#include "skinned_body.h"

// The smallest rotation of unit vector `from` onto unit vector `onto`: articulation.rotation_between.
inline void rotation_between(const double *from, const double *onto, double *out) {
    double axis[3], normal[3];
    cross(from, onto, axis);
    const double sine = std::sqrt(dot(axis, axis)), angle = std::atan2(sine, dot(from, onto));
    if (sine > 1e-9) {
        for (double &x : axis) x *= angle / sine;
    } else {  // opposite directions: any perpendicular axis
        const double x[3] = {1, 0, 0}, y[3] = {0, 1, 0};
        cross(from, std::abs(from[0]) < 0.9 ? x : y, normal);
        const double length = std::sqrt(dot(normal, normal));
        for (int d = 0; d < 3; ++d) axis[d] = normal[d] / length * angle;
    }
    exponential(axis, out);
}

// out = v scaled to length 1; zero for a zero vector.
inline void direction(const double *v, double *out) {
    const double length = std::max(std::sqrt(dot(v, v)), 1e-9);
    for (int d = 0; d < 3; ++d) out[d] = v[d] / length;
}

// Input of a search: links (of the base, then, from index `first`, of the limb), template rows for the score,
// unexplained points (m, 3), limits of the links (a row of LIMIT_COLUMNS, or null), and in canonical coordinates the
// axes of the limb's first two links and the end of the second.
struct LimbTask {
    std::vector<int64_t> links, rows;
    size_t first;
    std::vector<const double *> limits;
    const double *unexplained;
    size_t unexplained_count;
    const double *axes, *end;
    double truncation;
};

class LimbSearch {
  public:
    LimbSearch(SkinnedBody &body, const KdTree &data, const LimbTask &task)
        : body(body), data(data), task(task), upper(task.links[task.first]), two(task.links.size() > task.first + 1),
          lower(two ? task.links[task.first + 1] : upper), posed(3 * task.rows.size()), unexplained(4 * task.unexplained_count) {}

    struct Hypothesis {
        double score;
        Doubles rotations;  // (links, 3, 3)
        bool operator<(const Hypothesis &other) const { return score < other.score; }
    };

    // Rotations of the task's links in the body's current pose.
    Doubles current() const {
        Doubles result;
        for (int64_t link : task.links) result.insert(result.end(), &body.rotations[9 * link], &body.rotations[9 * link] + 9);
        return result;
    }

    // Sets the pose of the task's links.
    void set(const Doubles &rotations) {
        for (size_t k = 0; k < task.links.size(); ++k) {
            std::copy_n(&rotations[9 * k], 9, &body.rotations[9 * task.links[k]]);
            body.update_transform(task.links[k]);
        }
    }

    // Rotations `from`, with the limb's first two links rotated by rotation vectors (2, 3), each times its scale.
    Doubles turned(const double *from, const double *vectors, double first_scale, double second_scale) const {
        Doubles result(from, from + 9 * task.links.size());
        for (size_t k = 0; k < (two ? 2 : 1); ++k) {
            double vector[3], turn[9];
            for (int d = 0; d < 3; ++d) vector[d] = (k ? second_scale : first_scale) * vectors[3 * k + d];
            exponential(vector, turn);
            multiply(turn, from + 9 * (task.first + k), &result[9 * (task.first + k)]);
        }
        return result;
    }

    // Inverse kinematics: rotations that bring a place on the second bone, at a share of its length, to a target. side:
    // the direction of the bend. The body must be in the base pose, with rotations `from`.
    Doubles reaching(const Doubles &from, const double *target, double share, const double *side) const {
        const double *origin = &body.origins[3 * upper], *bend = &body.origins[3 * lower];
        double start[3], first[3], second[3], offset[3], to[3], across[3], along[3], place[3];
        body.place(size_t(upper), origin, start);
        for (int d = 0; d < 3; ++d) {
            first[d] = bend[d] - origin[d];
            second[d] = task.end[d] - bend[d];
            offset[d] = target[d] - start[d];
        }
        const double one = std::sqrt(dot(first, first)), other = std::sqrt(dot(second, second)) * share;
        const double far = std::min(std::max(std::sqrt(dot(offset, offset)), std::abs(one - other) + 1e-3), one + other - 1e-3);
        direction(offset, to);
        const double cosine = std::clamp((one * one + far * far - other * other) / (2 * one * far), -1.0, 1.0);
        double normal[3];
        cross(to, side, normal);
        direction(normal, across);
        const double sine = std::sqrt(1 - cosine * cosine);
        for (int d = 0; d < 3; ++d) along[d] = cosine * to[d] + sine * across[d], place[d] = start[d] + far * to[d];
        return aimed(from, start, along, place);
    }

    // Clamps rotations to the limits of the limb's links.
    void clamp(Doubles &rotations) const {
        for (size_t k = task.first; k < task.links.size(); ++k) {
            double allowed[9];
            if (task.limits[k] && nearest_allowed(task.limits[k], &rotations[9 * k], allowed))
                std::copy_n(allowed, 9, &rotations[9 * k]);
        }
    }

    // Score of rotations (LimbSearch._scores in Python), from every `stride`th template row and unexplained point; ∞ if
    // it is `bound` or more.
    double score(const Doubles &rotations, size_t stride, double bound) {
        set(rotations);
        const size_t rows = (task.rows.size() + stride - 1) / stride;
        for (size_t i = 0; i < rows; ++i) pose(task.rows[i * stride], &posed[3 * i]);
        const double most = squared(task.truncation);
        double sum = task.unexplained_count ? unexplained_cost(rows, stride) : 0;
        for (size_t i = 0; i < rows; ++i) {
            if (sum >= bound) return std::numeric_limits<double>::infinity();
            double square = most;
            data.nearest(&posed[3 * i], square);
            sum += square / double(rows);
        }
        return sum < bound ? sum : std::numeric_limits<double>::infinity();
    }

    // Positions of the limb's bend and of its second bone's end (6,); for a limb of one link, its end twice.
    std::vector<double> bend_and_end(const Doubles &rotations) {
        set(rotations);
        std::vector<double> result(6);
        const double *bend = two ? &body.origins[3 * lower] : task.end;
        body.place(size_t(upper), bend, &result[0]);
        body.place(size_t(lower), task.end, &result[3]);
        return result;
    }

  private:
    // Mean truncated squared distance of the unexplained points from the first posed rows. Single precision, four
    // points at a time.
    double unexplained_cost(size_t rows, size_t stride) {
        const size_t count = (task.unexplained_count + stride - 1) / stride;
        float *x = &unexplained[0], *y = x + count, *z = y + count, *least = z + count;
        for (size_t j = 0; j < count; ++j) {
            const double *point = task.unexplained + 3 * j * stride;
            x[j] = float(point[0]), y[j] = float(point[1]), z[j] = float(point[2]);
            least[j] = float(squared(task.truncation));
        }
        for (size_t i = 0; i < rows; ++i) {
            const float px = float(posed[3 * i]), py = float(posed[3 * i + 1]), pz = float(posed[3 * i + 2]);
            for (size_t j = 0; j < count; ++j) {
                const float dx = x[j] - px, dy = y[j] - py, dz = z[j] - pz, away = dx * dx + dy * dy + dz * dz;
                least[j] = away < least[j] ? away : least[j];
            }
        }
        double sum = 0;
        for (size_t j = 0; j < count; ++j) sum += double(least[j]);
        return sum / double(count);
    }

    // limb_chains.aimed: the first bone points along `along` from `start`, the second from its end to `place`.
    Doubles aimed(const Doubles &from, const double *start, const double *along, const double *place) const {
        double now[3], wanted[3], turn[9], above[9], elbow[3], below[9], rest[3];
        transform(&body.a[9 * upper], task.axes, now);
        direction(now, now);
        direction(along, wanted);
        rotation_between(now, wanted, turn);
        multiply(turn, &body.a[9 * upper], above);
        for (int d = 0; d < 3; ++d) rest[d] = body.origins[3 * lower + d] - body.origins[3 * upper + d];
        transform(above, rest, elbow);
        multiply(above, &from[9 * (task.first + 1)], below);
        transform(below, task.axes + 3, now);
        direction(now, now);
        for (int d = 0; d < 3; ++d) rest[d] = place[d] - start[d] - elbow[d];
        direction(rest, wanted);
        rotation_between(now, wanted, turn);
        double second[9];
        multiply(turn, below, second);
        Doubles result = from;
        const int64_t parent = body.parents[upper];
        if (parent >= 0)
            multiply_transposed(&body.a[9 * parent], above, &result[9 * task.first]);
        else
            std::copy_n(above, 9, &result[9 * task.first]);
        multiply_transposed(above, second, &result[9 * (task.first + 1)]);
        return result;
    }

    // out = pᵀ q.
    static void multiply_transposed(const double *p, const double *q, double *out) {
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) out[3 * i + j] = p[i] * q[j] + p[3 + i] * q[3 + j] + p[6 + i] * q[6 + j];
    }

    // out = a template point, posed by its first link only.
    void pose(int64_t row, double *out) const {
        const TemplatePoint &point = body.points[size_t(row)];
        body.place(size_t(point.first), point.at, out);
    }

    SkinnedBody &body;
    const KdTree &data;
    const LimbTask &task;
    const int64_t upper;
    const bool two;
    const int64_t lower;
    Doubles posed;
    std::vector<float> unexplained;  // coordinates of the points, axis by axis, and their distances
};

// Numbers of hypotheses to draw and keep, and their random numbers. `count` for each of three methods and each base
// (rotations (bases, links of the base, 3, 3)); turns (bases, 3, count, 2, 3); targets, sides (bases, count, 3); shares
// (bases, count); near (rounds, kept · drawn, 2, 3) with scales spreads (rounds,). Scales of turns, radians: of the
// first and second link, for hypotheses near the current and near the previous pose.
struct LimbDraws {
    size_t bases, count, rounds, kept, drawn, considered, refined;
    const double *base_rotations, *previous, *turns, *targets, *sides, *shares, *near, *spreads, *scales;
    double promising, distinct;
};

// Best scores so far, and the bound below which a score is among the best `most`.
class BestScores {
  public:
    explicit BestScores(size_t most, double bound) : most(most), bound(bound) {}
    double limit() const { return scores.size() < most ? bound : std::min(bound, scores.front()); }
    void add(double score) {
        if (scores.size() == most) std::pop_heap(scores.begin(), scores.end()), scores.pop_back();
        scores.push_back(score);
        std::push_heap(scores.begin(), scores.end());
    }

  private:
    const size_t most;
    const double bound;
    std::vector<double> scores;
};

constexpr size_t FIRST_STRIDE = 2;  // stride of template rows and unexplained points in the first round's scores

using LimbHypotheses = std::vector<LimbSearch::Hypothesis>;

// Hypotheses of the first round, within limits: near the current pose, near the previous pose, and reaching for
// unexplained points (near the current pose if there are none). Leaves the body in the last base pose.
inline std::vector<Doubles> drawn_hypotheses(LimbSearch &search, const LimbTask &task, const LimbDraws &draws) {
    const size_t rotations = 9 * task.links.size(), carried = 9 * task.first;
    const bool reaches = task.unexplained_count && task.links.size() > task.first + 1;
    const Doubles pose = search.current();
    std::vector<Doubles> result;
    for (size_t b = 0; b < draws.bases; ++b) {
        Doubles base = pose, previous(draws.previous, draws.previous + rotations);
        std::copy_n(draws.base_rotations + b * carried, carried, base.begin());
        std::copy_n(base.begin(), carried, previous.begin());
        search.set(base);
        for (size_t way = 0; way < 3; ++way)
            for (size_t i = 0; i < draws.count; ++i) {
                const size_t at = b * draws.count + i;
                const double *turn = draws.turns + 6 * ((3 * b + way) * draws.count + i);
                const double *scale = draws.scales + (way ? 2 : 0);
                if (way == 2 && reaches)
                    result.push_back(search.reaching(base, draws.targets + 3 * at, draws.shares[at], draws.sides + 3 * at));
                else
                    result.push_back(search.turned(way == 1 ? previous.data() : base.data(), turn, scale[0], scale[1]));
                search.clamp(result.back());
            }
    }
    return result;
}

// The best hypotheses, at most draws.refined, with bend and end of the limb at least `distinct` metres from those of
// the current pose `pose` and of each other.
inline LimbHypotheses distinct_hypotheses(LimbSearch &search, const Doubles &pose, const LimbHypotheses &sorted,
                                          const LimbDraws &draws) {
    std::vector<std::vector<double>> places{search.bend_and_end(pose)};
    LimbHypotheses chosen;
    for (const auto &hypothesis : sorted) {
        if (chosen.size() == draws.refined) break;
        const auto place = search.bend_and_end(hypothesis.rotations);
        bool is_new = true;
        for (const auto &other : places)
            is_new &= squared_distance(&place[0], &other[0]) + squared_distance(&place[3], &other[3]) >= squared(draws.distinct);
        if (is_new) chosen.push_back(hypothesis), places.push_back(place);
    }
    return chosen;
}

// The distinct hypotheses with scores below `promising` times the current pose's score; best first.
inline LimbHypotheses search_limb_poses(LimbSearch &search, const LimbTask &task, const LimbDraws &draws) {
    const Doubles pose = search.current();
    const double own = search.score(pose, 1, std::numeric_limits<double>::infinity());
    LimbHypotheses best;
    BestScores first(draws.kept, std::numeric_limits<double>::infinity());
    for (Doubles &rotations : drawn_hypotheses(search, task, draws)) {
        const double score = search.score(rotations, FIRST_STRIDE, first.limit());
        if (std::isinf(score)) continue;
        first.add(score);
        best.push_back({score, std::move(rotations)});
    }
    std::stable_sort(best.begin(), best.end());
    if (best.size() > draws.kept) best.resize(draws.kept);
    for (auto &hypothesis : best)
        hypothesis.score = search.score(hypothesis.rotations, 1, std::numeric_limits<double>::infinity());
    for (size_t round = 0; round < draws.rounds; ++round) {
        std::stable_sort(best.begin(), best.end());
        if (best.size() > draws.kept) best.resize(draws.kept);
        const bool is_last = round + 1 == draws.rounds;
        BestScores scores(is_last ? draws.considered : draws.kept,
                          is_last ? draws.promising * own : std::numeric_limits<double>::infinity());
        for (const auto &hypothesis : best) scores.add(hypothesis.score);
        const size_t parents = best.size();
        for (size_t i = 0; i < parents * draws.drawn; ++i) {
            const double *turn = draws.near + 6 * (round * draws.kept * draws.drawn + i);
            Doubles rotations = search.turned(best[i / draws.drawn].rotations.data(), turn, draws.spreads[round], draws.spreads[round]);
            search.clamp(rotations);
            const double score = search.score(rotations, 1, scores.limit());
            if (std::isinf(score)) continue;
            scores.add(score);
            best.push_back({score, std::move(rotations)});
        }
    }
    std::stable_sort(best.begin(), best.end());
    if (best.size() > draws.considered) best.resize(draws.considered);
    while (!best.empty() && best.back().score >= draws.promising * own) best.pop_back();
    return distinct_hypotheses(search, pose, best, draws);
}
