// Registration of a skinned body to a frame's points: correspondences, Gauss–Newton iterations and
// scores, for geometry/body_matching.py. The NumPy code there defines the result; it sums in
// another order, so the two agree up to rounding.

#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "algebra3.h"
#include "arrays.h"
#include "joint_limits.h"
#include "kd_tree.h"
#include "limb_search.h"
#include "nearest_data.h"
#include "nearest_links.h"
#include "normal_equations.h"
#include "skinned_body.h"

namespace {

constexpr double INFINITE = std::numeric_limits<double>::infinity();

// Constants of geometry/body_matching.py.
constexpr size_t REFRESH_STEPS = 3;
constexpr double MAX_COLOUR_M = 0.04;

class BodyMatcher {
  public:
    BodyMatcher(Input<int64_t, 1> parents, Input<double, 2> origins, Input<double, 1> lengths, Input<double, 2> points,
                Input<int64_t, 2> links, Input<double, 1> weights, Input<double, 2> normals, Input<double, 2> colours,
                Input<int32_t, 1> nearest, Input<double, 2> low, Input<int32_t, 2> size, Input<int64_t, 1> start,
                double cell, double margin)
        : body(parents, origins, lengths, points, links, weights, normals, colours, nearest, low, size, start, cell,
               margin),
          equations(body), nearest(body.rows) {}
    BodyMatcher(const BodyMatcher &) = delete;  // `equations` refers to `body`

    // Gauss–Newton from a pose; returns the final rotations and root. steps (n, 3): width of the robust weight, number
    // of data points, and number of template rows of `sample`. allowed (links,): links that may match data. After a
    // step that moves nothing by more than `converged`, skips later steps that are wider than `skip_ratio` times that
    // step's width and wider than `never_skipped`, metres.
    nb::tuple solve(const KdTree &data, Input<double, 3> rotations, Input<double, 1> root, Input<double, 2> steps,
                    Input<int64_t, 1> sample, Input<bool, 1> allowed, Input<double, 3> rest, Input<double, 2> strengths,
                    Input<int64_t, 1> limited, Input<double, 2> limits, double limit_strength, double root_strength,
                    double tangential, double noise, double search_widths, double converged, double skip_ratio,
                    double never_skipped) {
        require(rotations, root, allowed, sample);
        require(data);
        if (rest.shape(0) != body.count || strengths.shape(0) != 2 || strengths.shape(1) != body.count ||
            steps.shape(1) != 3 || limits.shape(0) != limited.shape(0) || limits.shape(1) != LIMIT_COLUMNS)
            throw std::invalid_argument("BodyMatcher.solve: shapes differ");
        for (size_t k = 0; k < limited.shape(0); ++k)
            if (limited.data()[k] < 0 || limited.data()[k] >= int64_t(body.count))
                throw std::invalid_argument("BodyMatcher.solve: a link beyond the body");
        body.set_pose(rotations.data(), root.data());
        const Doubles start = body.rotations, start_root = body.root;
        candidates.clear();
        const std::vector<SearchingRow> searching = own_sample(sample);
        Doubles limited_axes(3 * limited.shape(0));
        size_t since_refresh = 0;           // steps since the last search of all candidates
        double converged_at = INFINITE;     // width of the last step, if it converged
        for (size_t step = 0; step < steps.shape(0); ++step) {
            const double width = steps.data()[3 * step];
            if (width > std::max(never_skipped, skip_ratio * converged_at)) continue;
            const size_t points = std::min(data.count, size_t(steps.data()[3 * step + 1]));
            const size_t rows = std::min(sample.shape(0), size_t(steps.data()[3 * step + 2]));
            if (++since_refresh > REFRESH_STEPS && std::isinf(converged_at))
                candidates.find(body, data, 0, points, allowed.data()), since_refresh = 1;
            candidates.find(body, data, candidates.count(), points, allowed.data());
            equations.begin();
            add_data_to_template(data, points, width, noise);
            add_template_to_data(data, searching, rows, search_widths * width, width, noise);
            equations.linearise(tangential);
            equations.add_priors(start, start_root.data(), rest.data(), strengths.data(), root_strength);
            for (size_t k = 0; k < limited.shape(0); ++k)
                equations.add_limit(size_t(limited.data()[k]), limits.data() + LIMIT_COLUMNS * k, limit_strength,
                                    &limited_axes[3 * k]);
            if (!equations.solve())
                throw std::runtime_error("BodyMatcher.solve: the normal equations are singular");
            converged_at = move(equations.solution()) < converged ? width : INFINITE;
            candidates.pose_has_changed();
        }
        Fresh<double> out(9 * body.count), out_root(3);
        std::copy(body.rotations.begin(), body.rotations.end(), out.data.get());
        std::copy(body.root.begin(), body.root.end(), out_root.data.get());
        return nb::make_tuple(out.give({body.count, 3, 3}), out_root.give({3}));
    }

    // Assesses the fit of a pose. Returns for each data point its distance from the template, and the matched template
    // row and link (−1: none); for each row of `sample`, the distance in place of the data point nearest in place and
    // colour (`limit` if none is nearer); and the cost: mean squares of both distances with colours, each truncated at
    // `truncation`. is_solved: pose and data are those of the last `solve`, so its candidates are valid.
    nb::tuple assess(const KdTree &data, Input<double, 3> rotations, Input<double, 1> root, Input<int64_t, 1> sample,
                     Input<bool, 1> allowed, bool is_solved, double limit, double truncation) {
        require(rotations, root, allowed, sample);
        require(data);
        body.set_pose(rotations.data(), root.data());
        candidates.pose_has_changed();
        const size_t n = data.count, k = sample.shape(0);
        if (!is_solved || candidates.count() != n) {
            candidates.clear();
            candidates.find(body, data, 0, n, allowed.data());
        }
        Fresh<int64_t> row(n), link(n);
        Fresh<double> residual(n), gap(k);
        double data_cost = 0, template_cost = 0;
        match_all(data, n, [&](size_t i, int64_t here, int64_t its_link) {
            double y[3] = {0, 0, 0};
            link.data[i] = its_link;
            row.data[i] = here < 0 ? -1 : int64_t(body.given_rows[size_t(here)]);
            if (here >= 0) body.pose_point(here, y);
            const double *x = data.point(i);
            double square = squared_distance(x, y);
            residual.data[i] = std::sqrt(square);
            if (data.coloured && here >= 0)
                for (int d = 0; d < 3; ++d) square += squared(x[3 + d] - body.colours[3 * here + d]);
            data_cost += std::min(square, truncation * truncation);
        });
        for (const auto &[searching, number] : own_sample(sample)) {
            double query[6], square = squared(limit);
            body.query_of(data, searching, query);
            const int64_t found = nearest.find(data, size_t(searching), query, square);
            gap.data[number] = found < 0 ? limit : std::sqrt(squared_distance(data.point(size_t(found)), query));
            template_cost += std::min(square, truncation * truncation);
        }
        const double cost = data_cost / double(std::max<size_t>(n, 1)) + template_cost / double(std::max<size_t>(k, 1));
        return nb::make_tuple(residual.give({n}), row.give({n}), link.give({n}), gap.give({k}), cost);
    }

    // Rotations (n, links, 3, 3) of the best distinct hypotheses for a limb, best first; see limb_search.h. links: of the
    // base, then, from index `first` on, of the limb, parents first. sample: template rows for the score. counts: kept,
    // drawn, considered, refined; factors: promising, distinct (metres), truncation (metres).
    Output<double> search_limb(const KdTree &data, Input<double, 2> unexplained, Input<double, 3> rotations,
                               Input<double, 1> root, Input<int64_t, 1> links, size_t first, Input<int64_t, 1> sample,
                               Input<double, 2> axes, Input<double, 1> end, Input<double, 4> base_rotations,
                               Input<double, 3> previous, Input<double, 5> turns, Input<double, 3> targets,
                               Input<double, 3> sides, Input<double, 2> shares, Input<double, 4> near,
                               Input<double, 1> spreads, Input<double, 2> scales, Input<int64_t, 1> limited,
                               Input<double, 2> limits, Input<int64_t, 1> counts, Input<double, 1> factors) {
        require(rotations, root, links, sample);
        const size_t n = links.shape(0), bases = base_rotations.shape(0), count = turns.shape(2);
        for (size_t k = 0; k < n + limited.shape(0); ++k) {
            const int64_t link = k < n ? links.data()[k] : limited.data()[k - n];
            if (link < 0 || link >= int64_t(body.count))
                throw std::invalid_argument("BodyMatcher.search_limb: a link beyond the body");
        }
        if (data.coloured || unexplained.shape(1) != 3 || first >= n || axes.shape(0) != 2 || axes.shape(1) != 3 ||
            end.shape(0) != 3 || base_rotations.shape(1) != first || previous.shape(0) != n || turns.shape(0) != bases ||
            turns.shape(1) != 3 || targets.shape(0) != bases || targets.shape(1) != count || sides.shape(0) != bases ||
            sides.shape(1) != count || shares.shape(0) != bases || shares.shape(1) != count || counts.shape(0) != 4 ||
            factors.shape(0) != 3 || near.shape(0) != spreads.shape(0) || scales.shape(0) != 2 || scales.shape(1) != 2 ||
            near.shape(1) != size_t(counts.data()[0] * counts.data()[1]) || limits.shape(0) != limited.shape(0) ||
            limits.shape(1) != LIMIT_COLUMNS)
            throw std::invalid_argument("BodyMatcher.search_limb: shapes differ");
        body.set_pose(rotations.data(), root.data());
        std::vector<int64_t> scoring;
        for (size_t k = 0; k < sample.shape(0); ++k) scoring.push_back(body.own_rows[size_t(sample.data()[k])]);
        LimbTask task{copy(links), std::move(scoring), first, std::vector<const double *>(n, nullptr), unexplained.data(),
                      unexplained.shape(0), axes.data(), end.data(), factors.data()[2]};
        for (size_t k = 0; k < n; ++k)
            for (size_t l = 0; l < limited.shape(0); ++l)
                if (limited.data()[l] == task.links[k]) task.limits[k] = limits.data() + LIMIT_COLUMNS * l;
        const int64_t *c = counts.data();
        const LimbDraws draws{bases, count, near.shape(0), size_t(c[0]), size_t(c[1]), size_t(c[2]), size_t(c[3]),
                              base_rotations.data(), previous.data(), turns.data(), targets.data(), sides.data(),
                              shares.data(), near.data(), spreads.data(), scales.data(), factors.data()[0],
                              factors.data()[1]};
        LimbSearch search(body, data, task);
        const LimbHypotheses chosen = search_limb_poses(search, task, draws);
        Fresh<double> out(9 * n * chosen.size());
        for (size_t i = 0; i < chosen.size(); ++i)
            std::copy_n(chosen[i].rotations.begin(), 9 * n, &out.data[9 * n * i]);
        return out.give({chosen.size(), n, 3, 3});
    }

  private:
    static constexpr size_t TOGETHER = 16;   // data points looked up together
    static constexpr double MAX_TURN = 0.7;  // most radians that a joint turns in one step

    template <class Links>
    void require(const Input<double, 3> &rotations, const Input<double, 1> &root, const Links &allowed,
                 const Input<int64_t, 1> &sample) const {
        if (rotations.shape(0) != body.count || rotations.shape(1) != 3 || rotations.shape(2) != 3 || root.shape(0) != 3)
            throw std::invalid_argument("BodyMatcher: a pose of another body");
        if constexpr (std::is_same_v<Links, Input<bool, 1>>)
            if (allowed.shape(0) != body.count) throw std::invalid_argument("BodyMatcher: links of another body");
        for (size_t k = 0; k < sample.shape(0); ++k)
            if (sample.data()[k] < 0 || sample.data()[k] >= int64_t(body.rows))
                throw std::invalid_argument("BodyMatcher: a row beyond the template");
    }

    void require(const KdTree &data) const {
        if (data.coloured && !body.coloured)
            throw std::invalid_argument("BodyMatcher: the data have colours and the template has none");
    }

    // Adds correspondences from the first data points to the template.
    void add_data_to_template(const KdTree &data, size_t points, double width, double noise) {
        match_all(data, points, [&](size_t i, int64_t row, int64_t) {
            if (row >= 0) equations.add_correspondence(row, data.point(i), width, noise);
        });
    }

    // Calls use(point, row, link) for each of the first data points, in spatial order for cache locality. row: template
    // row nearest in place and colour, among the candidate links; link: of the row; −1: none.
    template <class Use>
    void match_all(const KdTree &data, size_t points, const Use &use) const {
        std::array<size_t, TOGETHER> batch;
        std::array<SkinnedBody::LookUp, TOGETHER> first;  // look-ups in the nearest links
        size_t count = 0;
        const auto must_look_up = [&](size_t i) { return !candidates.is_fresh(i) && candidates.of(i)[0].link >= 0; };
        const auto flush = [&] {
            for (size_t p = 0; p < count; ++p)
                if (must_look_up(batch[p])) first[p].follow(body);
            for (size_t p = 0; p < count; ++p) {
                const Candidate found = candidates.is_fresh(batch[p]) ? match_found(data, batch[p]) : match(data, batch[p], first[p]);
                use(batch[p], found.row, found.link);
            }
            count = 0;
        };
        for (size_t i : data.spatial_order()) {
            if (i >= points) continue;
            if (must_look_up(i)) first[count].start(body, candidates.of(i)[0].link, data.point(i));
            batch[count++] = i;
            if (count == TOGETHER) flush();
        }
        flush();
    }

    // A template row that searches for data, and its index in the sample.
    struct SearchingRow {
        int64_t row;
        size_t number;
        bool operator<(const SearchingRow &other) const { return row < other.row; }
    };

    // The rows of a sample in spatial order.
    std::vector<SearchingRow> own_sample(const Input<int64_t, 1> &sample) const {
        std::vector<SearchingRow> result;
        for (size_t k = 0; k < sample.shape(0); ++k) result.push_back({body.own_rows[size_t(sample.data()[k])], k});
        std::sort(result.begin(), result.end());
        return result;
    }

    // Adds correspondences from the first rows of a sample to the data.
    void add_template_to_data(const KdTree &data, const std::vector<SearchingRow> &sample, size_t rows, double reach,
                              double width, double noise) {
        for (const auto &[row, k] : sample) {
            if (k >= rows) continue;
            double query[6], limit = squared(reach);
            body.query_of(data, row, query);
            const int64_t found = nearest.find(data, size_t(row), query, limit);
            if (found >= 0) equations.add_correspondence(row, data.point(size_t(found)), width, noise);
        }
    }

    // The template row nearest to data point i in place and colour, among its candidate links. nearest: look-up in the
    // first link, before it is finished.
    Candidate match(const KdTree &data, size_t i, SkinnedBody::LookUp &nearest) const {
        const double *x = data.point(i);
        const Candidate *links = candidates.of(i);
        Candidate best{-1, -1, INFINITE};
        double reach = INFINITE;
        for (size_t k = 0; k < CANDIDATES && links[k].link >= 0; ++k) {
            if (k && body.is_beyond(links[k].link, x, reach)) continue;
            if (k) nearest.start(body, links[k].link, x);
            if (k && body.box_distance(links[k].link, nearest.local) >= best.square) continue;
            if (k) nearest.follow(body);
            nearest.finish();
            const double sum = nearest.square + colour_square(data, x, nearest.row);
            if (sum < best.square) best = {links[k].link, int32_t(nearest.row), sum}, reach = std::sqrt(sum);
        }
        return best;
    }

    // `match` of a point whose candidates were found in the current pose.
    Candidate match_found(const KdTree &data, size_t i) const {
        const Candidate *links = candidates.of(i);
        Candidate best{-1, -1, INFINITE};
        for (size_t k = 0; k < CANDIDATES && links[k].link >= 0; ++k) {
            const double sum = links[k].square + colour_square(data, data.point(i), links[k].row);
            if (sum < best.square) best = {links[k].link, links[k].row, sum};
        }
        return best;
    }

    // Squared difference in colour of a data point from a template row, limited; 0 without colours.
    double colour_square(const KdTree &data, const double *x, int64_t row) const {
        if (!body.coloured || !data.coloured) return 0;
        double sum = 0;
        for (int d = 0; d < 3; ++d) sum += squared(x[3 + d] - body.colours[3 * size_t(row) + d]);
        return std::min(sum, MAX_COLOUR_M * MAX_COLOUR_M);
    }

    // Applies a step to the pose. Returns the largest motion of the root, or of a
    // link's far end by its own rotation, metres.
    double move(const double *step) {
        double most = std::sqrt(dot(step, step));
        for (size_t link = 0; link < body.count; ++link) {
            const double *vector = step + 3 + 3 * link;
            most = std::max(most, body.lengths[link] * std::sqrt(dot(vector, vector)));
        }
        for (int d = 0; d < 3; ++d) body.root[d] += step[d];
        for (size_t link = 0; link < body.count; ++link) {
            double vector[3], own[3], rotation[9], turned[9];
            std::copy_n(step + 3 + 3 * link, 3, vector);
            const double angle = std::sqrt(dot(vector, vector)), share = std::min(1.0, MAX_TURN / std::max(angle, 1e-9));
            for (double &x : vector) x *= share;
            if (body.parents[link] >= 0)
                transform_back(&body.a[9 * body.parents[link]], vector, own);
            else
                std::copy_n(vector, 3, own);
            exponential(own, rotation);
            multiply(rotation, &body.rotations[9 * link], turned);
            std::copy_n(turned, 9, &body.rotations[9 * link]);
        }
        body.update_transforms();
        return most;
    }

    SkinnedBody body;
    NormalEquations equations;
    LinkCandidates candidates;
    NearestData nearest;
};

// Extrapolates rotations (n, 3, 3): current · exp(share · log(previousᵀ current)).
Output<double> extrapolated_rotations(Input<double, 3> previous, Input<double, 3> current, double share) {
    const size_t n = current.shape(0);
    if (previous.shape(0) != n || previous.shape(1) != 3 || previous.shape(2) != 3 || current.shape(1) != 3 ||
        current.shape(2) != 3)
        throw std::invalid_argument("extrapolated_rotations: shapes differ");
    Fresh<double> out(9 * n);
    for (size_t i = 0; i < n; ++i) {
        const double *from = previous.data() + 9 * i, *to = current.data() + 9 * i;
        const double back[9] = {from[0], from[3], from[6], from[1], from[4], from[7], from[2], from[5], from[8]};
        double step[9], vector[3];
        multiply(back, to, step);
        logarithm(step, vector);
        for (double &x : vector) x *= share;
        exponential(vector, step);
        multiply(to, step, &out.data[9 * i]);
    }
    return out.give({n, 3, 3});
}

}  // namespace

void bind_matching(nb::module_ &m) {
    m.def("extrapolated_rotations", &extrapolated_rotations);
    nb::class_<KdTree>(m, "KdTree")
        .def(nb::init<Input<double, 2>, Input<double, 2>>())
        .def("grid", &KdTree::grid)
        .def("query", &KdTree::query, nb::arg(), nb::arg("distance_upper_bound"));
    nb::class_<BodyMatcher>(m, "BodyMatcher")
        .def(nb::init<Input<int64_t, 1>, Input<double, 2>, Input<double, 1>, Input<double, 2>, Input<int64_t, 2>,
                      Input<double, 1>, Input<double, 2>, Input<double, 2>, Input<int32_t, 1>, Input<double, 2>,
                      Input<int32_t, 2>, Input<int64_t, 1>, double, double>())
        .def("solve", &BodyMatcher::solve)
        .def("assess", &BodyMatcher::assess)
        .def("search_limb", &BodyMatcher::search_limb);
}
