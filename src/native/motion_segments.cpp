// Segments of a motion from their bytes to positions, for codecs/liu2006/decoding.py; the same as there up to rounding.
//
//   payload ─► head, bits of key frames, streams of integers ─► key frames, values, bases ─► splines of each segment
//   splines ─► normalisation markers ─► frames of the body ─► poses ─► positions, blended with those of the neighbours

#include <nanobind/stl/optional.h>

#include <cmath>
#include <optional>
#include <vector>

#include "arrays.h"
#include "body_frames.h"
#include "cursor.h"
#include "householder.h"
#include "splines.h"
#include "state_streams.h"

namespace {

using fields::Reader;
using fields::require;
using splines::Frames;
using splines::PoseSpline;
using splines::TrackSpline;
using state_streams::StateStreams;

using Integers = std::vector<int64_t>;

constexpr size_t MOST_INTEGERS = size_t(1) << 24;        // coder.MAX_INTEGERS
constexpr size_t MOST_OF_ONE_STATE = size_t(1) << 16;    // coder.ONE_STATE_SYMBOLS_SPARSE
constexpr uint64_t LARGEST_BLEND_MARGIN = 1 << 16, FINEST = 96, FREE_STEPS = 1 << 28, STEPS_PER_BYTE = 1 << 14;
constexpr int64_t LADDER = 64, LARGEST_RUNG = 60 * LADDER;

// quantise.step
double step_of(int64_t rung) {
    const int64_t part = (rung % LADDER + LADDER) % LADDER;
    return std::ldexp(std::pow(2.0, double(part) / double(LADDER)), int((rung - part) / LADDER));
}

// segment_model.SegmentModel
struct Segment {
    int64_t start, stop, before, after;
    TrackSpline markers;
    std::vector<PoseSpline> groups;
};

// Reads bits from the highest of each byte to the lowest.
struct Bits {
    bool next() {
        require(at < 8 * data.left());
        const bool bit = data.at[at / 8] >> (7 - at % 8) & 1;
        ++at;
        return bit;
    }

    // Whether fewer than eight bits are left, all of them 0.
    bool are_read() {
        if (8 * data.left() - at >= 8) return false;
        while (at < 8 * data.left())
            if (next()) return false;
        return true;
    }

    Reader data;
    size_t at = 0;
};

struct Keys {
    Frames by_level, sizes;

    size_t count() const { return by_level.size(); }
};

class MotionSegments {
public:
    // streams: of the usual and of the long ladder of laws. unpack: coder.unpack, for streams of other kinds. markers, groups:
    // columns of the points. up: the vertical axis.
    MotionSegments(const StateStreams &usual, const StateStreams &large, nb::callable unpack, Input<int64_t, 1> markers, nb::list groups,
                   size_t points, size_t up, int64_t blend_frames)
        : usual_(usual), large_(large), unpack_(unpack), markers_(columns_of(markers, points)), points_(points), up_(up),
          half_blend_(blend_frames / 2) {
        for (nb::handle group : groups) groups_.push_back(columns_of(nb::cast<Input<int64_t, 1>>(group), points));
        if (up > 2 || (!groups_.empty() && markers_.size() != 3)) throw std::invalid_argument("MotionSegments: three markers");
    }

    MotionSegments(const MotionSegments &) = delete;

    // Adds the segment of frames [start, stop), which follows the previous one; returns the bytes of its gaps and of its
    // residual. None for bytes that no encoder writes.
    std::optional<nb::tuple> read(nb::bytes payload, int64_t start, int64_t stop) {
        const uint8_t *data = static_cast<const uint8_t *>(payload.data());
        try {
            std::vector<Reader> sections = split(Reader{data, data + payload.size()});
            segments_.push_back(segment_of(sections, start, stop));
            const Reader gaps = sections[sections.size() - 2], residual = sections.back();
            return nb::make_tuple(bytes_of(gaps), bytes_of(residual));
        } catch (const fields::Damaged &) {
            return std::nullopt;
        }
    }

    // Positions of frames [start, stop), which the segments cover.
    void place(int64_t start, int64_t stop, InPlace<double, 3> positions) {
        if (stop < start || positions.shape(0) != size_t(stop - start) || positions.shape(1) != points_ || positions.shape(2) != 3)
            throw std::invalid_argument("place: shapes differ");
        double *out = positions.data();
        nb::gil_scoped_release release;
        for (size_t i = 0; i < segments_.size(); ++i) {
            const int64_t first = std::max(segments_[i].start, start), last = std::min(segments_[i].stop, stop);
            if (first < last) place_segment(i, first, size_t(last - first), out + size_t(first - start) * points_ * 3);
        }
    }

private:
    static Integers columns_of(const Input<int64_t, 1> &columns, size_t points) {
        Integers out(columns.data(), columns.data() + columns.shape(0));
        for (int64_t column : out)
            if (uint64_t(column) >= points) throw std::invalid_argument("MotionSegments: no such point");
        return out;
    }

    static nb::bytes bytes_of(const Reader &reader) { return nb::bytes(reader.at, reader.left()); }

    // segment_model.split_sections
    std::vector<Reader> split(Reader data) const {
        std::vector<uint64_t> sizes(5 + 2 * groups_.size());
        for (uint64_t &size : sizes) size = data.varint();
        std::vector<Reader> sections;
        for (uint64_t size : sizes) {
            require(size <= data.left());
            const uint8_t *first = data.take(size_t(size));
            sections.push_back({first, first + size});
        }
        sections.push_back(data);
        return sections;
    }

    // segment_model.unpack
    Segment segment_of(const std::vector<Reader> &sections, int64_t start, int64_t stop) {
        Reader head = sections[0];
        Bits bits{sections[1]};
        const uint64_t before = head.varint(), after = head.varint();
        require(before <= 2 * LARGEST_BLEND_MARGIN && after <= 2 * LARGEST_BLEND_MARGIN - before);
        const int64_t rung = read_rung(head);
        TrackSpline markers = track(sections[2], keys_of(bits, stop - start), rung, 3 * markers_.size());
        size_t dimensions = 0;
        for (const Integers &group : groups_) dimensions += group.size();
        const Integers means = integers(sections[3], dimensions, 3);
        Segment found{start, stop, int64_t(before), int64_t(after), std::move(markers), {}};
        const int64_t *mean = means.data();
        for (size_t group = 0; group < groups_.size(); ++group) {
            const size_t width = 3 * groups_[group].size();
            const int64_t of_group = read_rung(head);
            const uint64_t k = head.varint();
            require(k <= width);
            for (uint64_t i = 0, precision = 0; i < k; ++i) {  // the first precision, then by how much each is lower
                const uint64_t drop = head.varint();
                require(drop <= (i ? precision : FINEST));
                precision = i ? precision - drop : drop;
            }
            const Keys keys = keys_of(bits, int64_t(before) + stop - start + int64_t(after));
            const std::vector<double> basis = basis_of(sections[4 + 2 * group], width, size_t(k), mean);
            const double step = step_of(of_group) / std::sqrt(double(keys.count()));
            std::vector<double> middle(width);
            for (size_t i = 0; i < width; ++i) middle[i] = double(mean[i]) * step;
            found.groups.emplace_back(track(sections[5 + 2 * group], keys, of_group, size_t(k)), size_t(k), basis.data(), middle.data(), width);
            mean += width;
        }
        require(bits.are_read() && !head.left());
        return found;
    }

    static int64_t read_rung(Reader &head) {
        const int64_t rung = head.folded();
        require(std::abs(rung) <= LARGEST_RUNG);
        return rung;
    }

    // spline.from_splits
    static Keys keys_of(Bits &bits, int64_t frames) {
        require(frames > 0);
        Keys keys;
        splines::halve(frames, [&](int64_t) { return bits.next(); }, keys.by_level, keys.sizes);
        return keys;
    }

    // segment_model._unpack_track
    TrackSpline track(const Reader &data, const Keys &keys, int64_t rung, size_t k) {
        const Integers numbers = integers(data, keys.count(), k);
        std::vector<double> values(numbers.size());
        const double step = step_of(rung);
        auto decode = [&](size_t i, const double *prediction, double *value) {
            for (size_t c = 0; c < k; ++c) value[c] = prediction[c] + double(numbers[i * k + c]) * step;
        };
        splines::descend(keys.by_level.data(), keys.count(), keys.sizes.data(), keys.sizes.size(), k, values.data(), decode);
        return TrackSpline(keys.by_level.data(), keys.count(), values.data(), k);
    }

    // basis.unpack, (n, k), predicted by segment_model._nearest_marker of the mean pose.
    std::vector<double> basis_of(Reader data, size_t n, size_t k, const int64_t *mean) {
        require(uint64_t(n) * k * k <= FREE_STEPS + STEPS_PER_BYTE * data.left());
        const uint64_t leading = data.varint();
        require(leading <= k);
        Integers entries = integers(data, n, k), alike(n);
        for (size_t i = 0; i < n; ++i) alike[i] = i < 3 ? -1 : 3 * body_frames::nearest_earlier(mean, i / 3) + int64_t(i % 3);
        householder::sum_differences(entries.data(), n, k, alike.data(), size_t(leading));
        std::vector<double> basis(n * k);
        householder::compose_basis(entries.data(), n, k, basis.data());
        return basis;
    }

    // coder.unpack. Raises Corrupt.
    Integers integers(const Reader &data, size_t steps, size_t lanes) {
        require(steps * lanes <= MOST_INTEGERS && (steps * lanes || !data.left()));
        Integers out(steps * lanes);
        if (!data.left() || usual_.read(data.at, data.left(), steps, lanes, MOST_OF_ONE_STATE, out.data()) ||
            large_.read(data.at, data.left(), steps, lanes, MOST_OF_ONE_STATE, out.data()))
            return out;
        const auto found = nb::cast<Input<int64_t, 2>>(unpack_(bytes_of(data), nb::make_tuple(steps, lanes)));
        require(found.shape(0) == steps && found.shape(1) == lanes);
        std::copy_n(found.data(), out.size(), out.data());
        return out;
    }

    // decoding.reconstruct of frames of segment i, from `first` on.
    void place_segment(size_t i, int64_t first, size_t frames, double *out) {
        Segment &segment = segments_[i];
        const size_t row = points_ * 3;
        std::vector<double> origins(3 * frames), headings(2 * frames), curve(3 * markers_.size()), placed(curve.size());
        for (size_t t = 0; t < frames; ++t) {
            segment.markers.spline().at(first - segment.start + int64_t(t), curve.data());
            from_trajectories(curve, placed);
            for (size_t m = 0; m < markers_.size(); ++m) std::copy_n(&placed[3 * m], 3, out + t * row + size_t(markers_[m]) * 3);
            if (!groups_.empty()) body_frames::from_markers(placed.data(), up_, &origins[3 * t], &headings[2 * t]);
        }
        if (groups_.empty()) return;
        place_poses(segment, first, frames, origins.data(), headings.data(), out);
        blend(i, first, frames, origins.data(), headings.data(), out);
    }

    // segment_model._from_trajectories
    static void from_trajectories(const std::vector<double> &curve, std::vector<double> &markers) {
        if (curve.size() != 9) {
            markers = curve;
            return;
        }
        static const double ROTATION[3][3] = {{1 / std::sqrt(3.0), 1 / std::sqrt(3.0), 1 / std::sqrt(3.0)},
                                              {0, -1 / std::sqrt(2.0), 1 / std::sqrt(2.0)},
                                              {-2 / std::sqrt(6.0), 1 / std::sqrt(6.0), 1 / std::sqrt(6.0)}};
        for (size_t m = 0; m < 3; ++m)
            for (size_t d = 0; d < 3; ++d)
                markers[3 * m + d] = curve[d] * ROTATION[0][m] + curve[3 + d] * ROTATION[1][m] + curve[6 + d] * ROTATION[2][m];
    }

    // The poses of all groups at frames of the motion, transformed from these frames of the body.
    void place_poses(Segment &segment, int64_t first, size_t frames, const double *origins, const double *headings, double *out) {
        for (size_t group = 0; group < groups_.size(); ++group) {
            const Integers &columns = groups_[group];
            const body_frames::World world(columns.data(), columns.size(), origins, headings, up_, points_, out);
            segment.groups[group].place(first - (segment.start - segment.before), frames, world);
        }
    }

    // decoding._blend. Computes all changes before it applies any.
    void blend(size_t i, int64_t first, size_t frames, const double *origins, const double *headings, double *out) {
        const size_t row = points_ * 3;
        struct Change {
            size_t from;
            std::vector<double> by;
        };
        std::vector<Change> changes;
        for (const size_t j : {i - 1, i + 1}) {
            if (j >= segments_.size()) continue;
            Segment &neighbour = segments_[j];
            const int64_t low = std::max(first, neighbour.start - neighbour.before);
            const int64_t high = std::min(first + int64_t(frames), neighbour.stop + neighbour.after);
            if (low >= high) continue;
            const size_t from = size_t(low - first), count = size_t(high - low);
            std::vector<double> others(out + from * row, out + (from + count) * row);
            place_poses(neighbour, low, count, origins + 3 * from, headings + 2 * from, others.data());
            for (size_t t = 0; t < count; ++t) {
                const double weight = weight_of(neighbour, low + int64_t(t));
                for (size_t c = 0; c < row; ++c) others[t * row + c] = weight * (others[t * row + c] - out[(from + t) * row + c]);
            }
            changes.push_back({from, std::move(others)});
        }
        for (const Change &change : changes)
            for (size_t c = 0; c < change.by.size(); ++c) out[change.from * row + c] += change.by[c];
    }

    // decoding._neighbours: the share of a segment in the frames around one.
    double weight_of(const Segment &segment, int64_t frame) const {
        const int64_t first = std::max(frame - half_blend_, segments_.front().start);
        const int64_t last = std::min(frame + half_blend_ + 1, segments_.back().stop);
        const int64_t shared = std::min(last, segment.stop) - std::max(first, segment.start);
        return double(std::max<int64_t>(shared, 0)) / double(last - first);
    }

    const StateStreams &usual_, &large_;
    nb::callable unpack_;
    Integers markers_;
    std::vector<Integers> groups_;
    size_t points_, up_;
    int64_t half_blend_;
    std::vector<Segment> segments_;
};

}  // namespace

void bind_motion_segments(nb::module_ &m) {
    nb::class_<MotionSegments>(m, "MotionSegments")
        .def(nb::init<const StateStreams &, const StateStreams &, nb::callable, Input<int64_t, 1>, nb::list, size_t, size_t, int64_t>(),
             nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>())
        .def("read", &MotionSegments::read)
        .def("place", &MotionSegments::place, nb::arg(), nb::arg(), nb::arg().noconvert());
}
