// Finds the links of a body with the nearest templates to data points: candidates for correspondences.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "algebra3.h"
#include "kd_tree.h"
#include "skinned_body.h"

// Constants of geometry/body_matching.py.
constexpr size_t CANDIDATES = 3;
constexpr double CANDIDATE_MARGIN_M = 0.08;

// A candidate link of a data point (−1: none), its nearest template row, and the squared distance of that row.
struct Candidate {
    int32_t link = -1, row = -1;
    double square = 0;
};

// The links with the nearest templates to one data point, nearest first. Each is one integer: squared distance in
// single precision in the upper half, the link's number in the lower, so that sorting needs no branches.
class NearestLinks {
  public:
    NearestLinks() { best.fill(NONE); }

    // square: squared distance of the link.
    void add(int64_t link, double square) {
        const float key = float(square);
        uint32_t bits;
        std::memcpy(&bits, &key, sizeof bits);
        uint64_t next = (uint64_t(bits) << 32) | uint64_t(link);
        for (uint64_t &kept : best) {
            const uint64_t nearer = std::min(kept, next);
            next = std::max(kept, next);
            kept = nearer;
        }
    }

    // Largest distance of a candidate link, metres.
    double reach() const { return std::min(distance(CANDIDATES - 1), distance(0) + CANDIDATE_MARGIN_M); }

    // Writes the candidates (CANDIDATES,) within reach. found: the last look-up in each link.
    void store(const std::vector<Candidate> &found, Candidate *candidates) const {
        const double most = squared(distance(0) + CANDIDATE_MARGIN_M);
        for (size_t k = 0; k < CANDIDATES; ++k)
            candidates[k] = best[k] == NONE || square(k) > most ? Candidate{} : found[size_t(best[k] & 0xffffffff)];
    }

  private:
    static constexpr uint64_t NONE = uint64_t(0x7f800000) << 32;  // at an infinite distance

    double square(size_t k) const {
        const uint32_t bits = uint32_t(best[k] >> 32);
        float result;
        std::memcpy(&result, &bits, sizeof result);
        return double(result);
    }

    double distance(size_t k) const { return std::sqrt(square(k)); }

    std::array<uint64_t, CANDIDATES> best;
};

// Capsules of the allowed links, and lower bounds of the distances from a place to their template points.
class LinkBounds {
  public:
    struct Bound {
        int64_t link;
        float distance;  // metres; negative inside the capsule
    };

    // allowed (links,): whether a link may match data.
    LinkBounds(const SkinnedBody &body, const bool *allowed) {
        for (size_t link = 0; link < body.count; ++link)
            if (body.has_points[link] && allowed[link]) links.push_back(int64_t(link));
        const size_t n = links.size();
        capsules.resize(8 * n);
        distances.resize(n);
        near.resize(n);
        for (size_t u = 0; u < n; ++u) {
            const double *end = &body.world_ends[6 * links[u]];
            double square = 0;
            for (int d = 0; d < 3; ++d) {
                capsules[d * n + u] = float(end[d]);
                capsules[(3 + d) * n + u] = float(end[3 + d] - end[d]);
                square += squared(end[3 + d] - end[d]);
            }
            capsules[6 * n + u] = float(1 / std::max(square, 1e-12));
            capsules[7 * n + u] = float(body.radii[links[u]]) + SLACK_M;
        }
    }

    // Computes the bounds for a place. No branches, so that compilers vectorise over four links.
    void measure_from(const double *place) {
        const size_t n = links.size();
        const float px = float(place[0]), py = float(place[1]), pz = float(place[2]);
        const float *ox = capsules.data(), *oy = ox + n, *oz = oy + n, *dx = oz + n, *dy = dx + n, *dz = dy + n,
                    *inverse = dz + n, *radius = inverse + n;
        float *out = distances.data();
        for (size_t u = 0; u < n; ++u) {
            const float x = px - ox[u], y = py - oy[u], z = pz - oz[u];
            const float along = (x * dx[u] + y * dy[u] + z * dz[u]) * inverse[u];
            const float share = 0.5f * (std::abs(along) - std::abs(along - 1) + 1);  // along, clamped to 0 … 1
            const float x1 = x - share * dx[u], y1 = y - share * dy[u], z1 = z - share * dz[u];
            out[u] = std::sqrt(x1 * x1 + y1 * y1 + z1 * z1) - radius[u];
        }
        known = -std::numeric_limits<float>::infinity();
    }

    // Links with bounds that may be below `limit`: from `begin` to `end`.
    struct Range {
        const Bound *first, *last;
        const Bound *begin() const { return first; }
        const Bound *end() const { return last; }
    };
    Range below(double limit) {
        if (!(limit < known)) {
            known = limit + LIST_MARGIN_M;
            near_count = 0;
            const float most = float(known);
            for (size_t u = 0; u < links.size(); ++u) {  // no branches
                near[near_count] = {links[u], distances[u]};
                near_count += distances[u] <= most;
            }
        }
        return {near.data(), near.data() + near_count};
    }

  private:
    static constexpr float SLACK_M = 1e-4f;         // above the error of single precision, within some metres
    static constexpr double LIST_MARGIN_M = 0.05;  // added to the limit of a list, so that it serves more points

    std::vector<int64_t> links;
    std::vector<float> capsules;   // axis by axis: ends, segments, 1 / squared length, radii
    std::vector<float> distances;  // from the last place
    std::vector<Bound> near;       // the first `near_count`: links nearer than `known`
    size_t near_count = 0;
    double known;
};

// Candidate links of the first data points of a frame.
class LinkCandidates {
  public:
    // The candidates of a data point, nearest first.
    const Candidate *of(size_t point) const { return &candidates[point * CANDIDATES]; }
    size_t count() const { return candidates.size() / CANDIDATES; }
    void clear() { candidates.clear(), fresh_from = 0; }

    // Whether rows and distances of a point's candidates are those of the current pose.
    bool is_fresh(size_t point) const { return point >= fresh_from; }
    void pose_has_changed() { fresh_from = count(); }

    // Finds candidates of data points [from, to), each at most CANDIDATE_MARGIN_M farther than the nearest. Measures a
    // point's former candidates, or its neighbour's, first: they limit the distance. Skips other links if their bounds,
    // from a place near the point that neighbours share, exceed the limit.
    void find(const SkinnedBody &body, const KdTree &data, size_t from, size_t to, const bool *allowed) {
        if (from >= to) return;
        fresh_from = std::min(fresh_from, from);
        const std::vector<Candidate> before(candidates.begin() + std::ptrdiff_t(from * CANDIDATES), candidates.end());
        candidates.resize(to * CANDIDATES);
        LinkBounds bounds(body, allowed);
        std::vector<size_t> points;
        points.reserve(to - from);
        for (size_t i : data.spatial_order())
            if (i >= from && i < to) points.push_back(i);
        std::vector<Candidate> of_link(body.count);  // the last look-up in each link
        for (size_t link = 0; link < body.count; ++link) of_link[link].link = int32_t(link);
        std::array<Candidate, CANDIDATES> last;  // candidates of the previous point, a neighbour in space
        const double *centre = nullptr;
        std::array<std::array<int32_t, CANDIDATES>, TOGETHER> likely;
        std::array<std::array<SkinnedBody::LookUp, CANDIDATES>, TOGETHER> found;
        for (size_t first = 0; first < points.size(); first += TOGETHER) {
            const size_t count = std::min(TOGETHER, points.size() - first);
            for (size_t p = 0; p < count; ++p) {
                const size_t i = points[first + p];
                const bool is_known = (i - from + 1) * CANDIDATES <= before.size();
                const Candidate *former = is_known ? &before[(i - from) * CANDIDATES] : last.data();
                for (size_t k = 0; k < CANDIDATES; ++k) {
                    likely[p][k] = former[k].link;
                    if (likely[p][k] >= 0) found[p][k].start(body, likely[p][k], data.point(i));
                }
            }
            for (size_t p = 0; p < count; ++p)
                for (size_t k = 0; k < CANDIDATES; ++k)
                    if (likely[p][k] >= 0) found[p][k].follow(body);
            for (size_t p = 0; p < count; ++p) {
                const size_t i = points[first + p];
                const double *x = data.point(i);
                if (!centre || squared_distance(x, centre) > squared(GROUP_M)) bounds.measure_from(centre = x);
                NearestLinks nearest;
                const auto add = [&](int64_t link, const SkinnedBody::LookUp &look_up) {
                    of_link[size_t(link)].row = int32_t(look_up.row);
                    of_link[size_t(link)].square = look_up.square;
                    nearest.add(link, look_up.square);
                };
                for (size_t k = 0; k < CANDIDATES; ++k)
                    if (likely[p][k] >= 0) found[p][k].finish(), add(likely[p][k], found[p][k]);
                const double off = std::sqrt(squared_distance(x, centre));
                double reach = nearest.reach();
                for (const auto &[link, distance] : bounds.below(reach + off)) {
                    if (distance >= reach + off || body.is_beyond(link, x, reach)) continue;
                    if (std::find(likely[p].begin(), likely[p].end(), link) != likely[p].end()) continue;
                    SkinnedBody::LookUp other;
                    other.run(body, link, x);
                    add(link, other);
                    reach = nearest.reach();
                }
                nearest.store(of_link, last.data());
                std::copy_n(last.begin(), CANDIDATES, &candidates[i * CANDIDATES]);
            }
        }
    }

  private:
    static constexpr size_t TOGETHER = 8;    // points looked up together
    static constexpr double GROUP_M = 0.06;  // most distance of a point from the place of its shared bounds

    std::vector<Candidate> candidates;  // CANDIDATES for each data point
    size_t fresh_from = 0;              // from this point on, candidates were found in the current pose
};
