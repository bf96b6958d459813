// Costs of many poses of the stock body against points, for geometry/pose_search.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "algebra3.h"
#include "arrays.h"
#include "capsules.h"
#include "skinned_body.h"

// Values of the cells of a grid, for capsules.DistanceField. values: z fastest; low (3,): the grid's corner; shape (3,): its
// cells; cell: their edge, metres.
template <class Value>
struct CellValues {
    CellValues(Input<Value, 1> values, Input<double, 1> low, Input<int64_t, 1> shape, double cell)
        : values(values.data(), values.data() + values.size()), cell(cell) {
        if (low.shape(0) != 3 || shape.shape(0) != 3) throw std::invalid_argument("cells of a grid: shapes differ");
        for (int d = 0; d < 3; ++d) corner[d] = low.data()[d], cells[d] = shape.data()[d];
        if (cells[0] < 1 || cells[1] < 1 || cells[2] < 1 || size_t(cells[0] * cells[1] * cells[2]) != values.size())
            throw std::invalid_argument("cells of a grid: shapes differ");
    }

    // The value of the cell at a place, or of the nearest cell.
    Value at(const double *place) const {
        int64_t index[3];
        for (int d = 0; d < 3; ++d)
            index[d] = int64_t(std::clamp((place[d] - corner[d]) / cell, 0.0, double(cells[d] - 1)));
        return values[size_t((index[0] * cells[1] + index[1]) * cells[2] + index[2])];
    }

  private:
    std::vector<Value> values;
    double corner[3], cell;
    int64_t cells[3];
};

// A body of capsules of one build, and surface samples, against the points of a frame.
class PoseScorer {
  public:
    // Body: parents (links,), origins (links, 3). Capsules: carriers (c,), their links; ends (c, 2, 3), radii (c, 2). Samples
    // of their surface: sample_links (m,), samples (m, 3). hinges (h,), axes (h, 3): links that bend about an axis in one
    // direction only, by which they cost `hinge_cost` (2,): a factor, and radians the other way without cost. field: of
    // the points (n, 3). truncation: of distances. All places in the stock body's pose, metres.
    PoseScorer(Input<int64_t, 1> parents, Input<double, 2> origins, Input<int64_t, 1> carriers, Input<double, 3> ends,
               Input<double, 2> radii, Input<int64_t, 1> sample_links, Input<double, 2> samples, Input<int64_t, 1> hinges,
               Input<double, 2> axes, Input<double, 1> hinge_cost, const CellValues<float> &field, Input<double, 2> points,
               double truncation)
        : links(parents.shape(0)), capsules(carriers.shape(0)), parents(copy(parents)), carriers(copy(carriers)),
          sample_links(copy(sample_links)), hinges(copy(hinges)), origins(copy(origins)), ends(copy(ends)),
          radii(copy(radii)), samples(copy(samples)), axes(copy(axes)), field(field), points(points),
          truncation(truncation), hinge_factor(hinge_cost.data()[0]), free_rad(hinge_cost.data()[1]) {
        if (origins.shape(0) != links || origins.shape(1) != 3 || !links || !capsules || ends.shape(0) != capsules ||
            ends.shape(1) != 2 || ends.shape(2) != 3 || radii.shape(0) != capsules || radii.shape(1) != 2 ||
            samples.shape(0) != sample_links.shape(0) || samples.shape(1) != 3 || axes.shape(0) != hinges.shape(0) ||
            axes.shape(1) != 3 || hinge_cost.shape(0) != 2 || !this->points.count)
            throw std::invalid_argument("PoseScorer: shapes differ");
        for (size_t l = 0; l < links; ++l)
            if (this->parents[l] >= int64_t(l)) throw std::invalid_argument("PoseScorer: a link comes before its parent");
        for (const auto *of : {&this->carriers, &this->sample_links, &this->hinges})
            for (int64_t link : *of) require_link(link);
        a.resize(9 * links), b.resize(3 * links), placed.resize(6 * capsules), wide.resize(2 * capsules);
        nearest.resize(this->points.count), rest.resize(this->points.count);
    }

    // (k,): costs of poses, square metres, by the first `count` points and every `stride`th sample. rotations (k, links,
    // 3, 3), roots (k, 3), sizes (k,).
    Output<double> costs(Input<double, 4> rotations, Input<double, 2> roots, Input<double, 1> sizes, size_t count,
                         size_t stride) {
        require(rotations, roots, sizes);
        count = std::min(count, points.count);
        const size_t k = sizes.shape(0);
        Fresh<double> out(k);
        for (size_t pose = 0; pose < k; ++pose) {
            const double *turns = rotations.data() + 9 * links * pose;
            const double size = sizes.data()[pose];
            for (size_t link = 0; link < links; ++link)
                update(link, turns + 9 * link, roots.data() + 3 * pose, size);
            for (size_t c = 0; c < capsules; ++c) place_capsule(c, size);
            points.set_nearest(nearest.data(), count, capsules, placed.data(), wide.data());
            double from_samples = 0, bent = 0;
            size_t used = 0;
            for (size_t s = 0; s < sample_links.size(); s += std::max<size_t>(stride, 1), ++used)
                from_samples += sample_cost(s);
            for (size_t h = 0; h < hinges.size(); ++h) bent += hinge_cost(h, turns + 9 * hinges[h]);
            out.data[pose] = point_cost(nearest.data(), count) / double(count) + from_samples / double(used) + bent;
        }
        return out.give({k});
    }

    // For each of k poses the best of some rotations of a limb: which (k,), and its cost (k,), as `costs` by all points and
    // samples. limb (l,): its links, parents first; turns (k, draws, l, 3, 3): their rotations.
    nb::tuple best_limbs(Input<double, 4> rotations, Input<double, 2> roots, Input<double, 1> sizes, Input<int64_t, 1> limb,
                         Input<double, 5> turns) {
        require(rotations, roots, sizes);
        const size_t k = sizes.shape(0), draws = turns.shape(1), l = limb.shape(0);
        if (turns.shape(0) != k || !draws || turns.shape(2) != l || turns.shape(3) != 3 || turns.shape(4) != 3)
            throw std::invalid_argument("PoseScorer.best_limbs: shapes differ");
        for (size_t i = 0; i < l; ++i) require_link(limb.data()[i]);
        const auto in_limb = [&](int64_t link) { return std::find(limb.data(), limb.data() + l, link) != limb.data() + l; };
        std::vector<size_t> own_capsules, own_samples;
        for (size_t c = 0; c < capsules; ++c)
            if (in_limb(carriers[c])) own_capsules.push_back(c);
        for (size_t s = 0; s < sample_links.size(); ++s)
            if (in_limb(sample_links[s])) own_samples.push_back(s);
        Fresh<int64_t> best(k);
        Fresh<double> costs(k);
        for (size_t pose = 0; pose < k; ++pose) {
            const double *own = rotations.data() + 9 * links * pose, *root = roots.data() + 3 * pose;
            const double size = sizes.data()[pose];
            for (size_t link = 0; link < links; ++link) update(link, own + 9 * link, root, size);
            double unchanged = 0;  // cost of samples and hinges of other links
            bool is_first = true;
            for (size_t c = 0; c < capsules; ++c) {
                if (in_limb(carriers[c])) continue;
                place_capsule(c, size);
                if (is_first)
                    points.lower<true>(rest.data(), 0, points.count, &placed[6 * c], &wide[2 * c]);
                else
                    points.lower<false>(rest.data(), 0, points.count, &placed[6 * c], &wide[2 * c]);
                is_first = false;
            }
            if (is_first) std::fill(rest.begin(), rest.end(), float(truncation));
            const double sample_share = 1 / double(std::max<size_t>(sample_links.size(), 1));
            for (size_t s = 0; s < sample_links.size(); ++s)
                if (!in_limb(sample_links[s])) unchanged += sample_cost(s) * sample_share;
            for (size_t h = 0; h < hinges.size(); ++h)
                if (!in_limb(hinges[h])) unchanged += hinge_cost(h, own + 9 * hinges[h]);
            best.data[pose] = 0;
            costs.data[pose] = std::numeric_limits<double>::infinity();
            for (size_t draw = 0; draw < draws; ++draw) {
                const double *turn = turns.data() + 9 * l * (pose * draws + draw);
                double cost = unchanged;
                for (size_t i = 0; i < l; ++i) {
                    const size_t link = size_t(limb.data()[i]);
                    update(link, turn + 9 * i, root, size);
                    for (size_t h = 0; h < hinges.size(); ++h)
                        if (hinges[h] == int64_t(link)) cost += hinge_cost(h, turn + 9 * i);
                }
                for (size_t s : own_samples) cost += sample_cost(s) * sample_share;
                for (size_t c : own_capsules) place_capsule(c, size);
                for (size_t first = 0; first < points.count && cost < costs.data[pose]; first += TOGETHER) {
                    const size_t last = std::min(first + TOGETHER, points.count);
                    std::copy(rest.begin() + std::ptrdiff_t(first), rest.begin() + std::ptrdiff_t(last),
                              nearest.begin() + std::ptrdiff_t(first));
                    for (size_t c : own_capsules)
                        points.lower<false>(nearest.data(), first, last, &placed[6 * c], &wide[2 * c]);
                    cost += point_cost(&nearest[first], last - first) / double(points.count);
                }
                if (cost < costs.data[pose]) costs.data[pose] = cost, best.data[pose] = int64_t(draw);
            }
        }
        return nb::make_tuple(best.give({k}), costs.give({k}));
    }

  private:
    static constexpr size_t TOGETHER = 64;  // points compared with a limb before it is given up if it costs more than the best

    void require_link(int64_t link) const {
        if (link < 0 || link >= int64_t(links)) throw std::invalid_argument("PoseScorer: a link beyond the body");
    }

    void require(const Input<double, 4> &rotations, const Input<double, 2> &roots, const Input<double, 1> &sizes) const {
        const size_t k = sizes.shape(0);
        if (rotations.shape(0) != k || rotations.shape(1) != links || rotations.shape(2) != 3 || rotations.shape(3) != 3 ||
            roots.shape(0) != k || roots.shape(1) != 3)
            throw std::invalid_argument("PoseScorer: shapes differ");
    }

    // Transform of a link, scaled by the size, from its rotation and its parent's transform.
    void update(size_t link, const double *rotation, const double *root, double size) {
        const double *origin = &origins[3 * link];
        double own[3], above[3] = {0, 0, 0};
        double *here = &a[9 * link];
        const int64_t parent = parents[link];
        if (parent < 0) {
            for (int i = 0; i < 9; ++i) here[i] = rotation[i] * size;
        } else {
            multiply(&a[9 * parent], rotation, here);
            transform(&a[9 * parent], origin, above);
        }
        transform(here, origin, own);
        for (int d = 0; d < 3; ++d) b[3 * link + d] = above[d] - own[d] + (parent < 0 ? root[d] : b[3 * parent + d]);
    }

    void place(int64_t link, const double *point, double *out) const {
        transform(&a[9 * link], point, out);
        for (int d = 0; d < 3; ++d) out[d] += b[3 * link + d];
    }

    void place_capsule(size_t c, double size) {
        for (size_t end = 2 * c; end < 2 * c + 2; ++end) {
            place(carriers[c], &ends[3 * end], &placed[3 * end]);
            wide[end] = radii[end] * size;
        }
    }

    double sample_cost(size_t s) const {
        double at[3];
        place(sample_links[s], &samples[3 * s], at);
        return squared(std::min(double(field.at(at)), truncation));
    }

    double hinge_cost(size_t h, const double *rotation) const {
        double turn[3];
        logarithm(rotation, turn);
        return hinge_factor * squared(std::max(-dot(turn, &axes[3 * h]) - free_rad, 0.0));
    }

    // Sum of truncated squares of the first n distances.
    double point_cost(const float *distances, size_t n) const {
        const float most = float(truncation);
        float sums[4] = {0, 0, 0, 0};
        size_t i = 0;
        const auto add = [&](size_t lane) {
            const float away = 0.5f * (distances[i + lane] + most - std::abs(distances[i + lane] - most));  // the minimum
            sums[lane] += away * away;
        };
        for (; i + 4 <= n; i += 4)
            for (size_t lane = 0; lane < 4; ++lane) add(lane);
        for (size_t lane = 0; i + lane < n; ++lane) add(lane);
        return double(sums[0]) + double(sums[1]) + double(sums[2]) + double(sums[3]);
    }

    const size_t links, capsules;
    const std::vector<int64_t> parents, carriers, sample_links, hinges;
    const std::vector<double> origins, ends, radii, samples, axes;
    const CellValues<float> field;
    const CentredPoints points;
    const double truncation, hinge_factor, free_rad;
    std::vector<double> a, b, placed, wide;  // transforms of links, ends and radii of capsules, of the current pose
    std::vector<float> nearest, rest;        // distances of points from all capsules, and from those outside a limb
};
