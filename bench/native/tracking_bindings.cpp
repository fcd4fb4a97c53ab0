// Python bindings of the tracker's kernels: typed arrays, checked here once.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "tracking.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

template <typename T, int N> using In = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
using Doubles = In<double, 1>;
using Rows = In<double, 2>;
using Ints = In<int64_t, 1>;
using Described = nb::ndarray<nb::ro, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Grey = In<uint8_t, 2>;
using Levels = std::vector<Grey>;

void require(bool ok, const char* what) {
    if (!ok) throw std::invalid_argument(what);
}

// A numpy array that owns the vector's memory.
template <typename T> nb::object array(std::vector<T>&& values, std::initializer_list<size_t> shape) {
    auto* held = new std::vector<T>(std::move(values));
    nb::capsule owner(held, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return nb::cast(nb::ndarray<nb::numpy, T>(held->data(), shape, owner));
}

size_t rows(const Rows& a, size_t columns, const char* what) {
    require(a.shape(1) == columns, what);
    return a.shape(0);
}

bgs::GreyImage image_of(const Grey& a) { return {a.data(), static_cast<int>(a.shape(1)), static_cast<int>(a.shape(0)), static_cast<ptrdiff_t>(a.shape(1))}; }

bgs::DescriptorKind kind_of(const Described& descriptors) {
    const bool bits = descriptors.dtype() == nb::dtype<uint64_t>() && descriptors.shape(1) == 4;
    require(bits || (descriptors.dtype() == nb::dtype<int8_t>() && descriptors.shape(1) == 64), "descriptors must be (N, 4) uint64 or (N, 64) int8");
    return bits ? bgs::DescriptorKind::BITS : bgs::DescriptorKind::BYTES;
}

bgs::Keypoints keypoints_of(const Rows& xy, const Ints& octave, const Described& descriptors) {
    const size_t n = rows(xy, 2, "positions must have shape (N, 2)");
    require(octave.shape(0) == n && descriptors.shape(0) == n, "octaves (N,) and descriptors (N, 4) or (N, 64) must match the positions");
    return {xy.data(), octave.data(), descriptors.data(), kind_of(descriptors), static_cast<int>(n)};
}

bgs::Pinhole camera_of(const std::vector<double>& c) {
    require(c.size() == 5, "camera must be (fx, fy, cx, cy, fx * baseline)");
    return {c[0], c[1], c[2], c[3], c[4]};
}

std::vector<double> pack_pose(const double* T) { return {T[0], T[1], T[2], T[4], T[5], T[6], T[8], T[9], T[10], T[3], T[7], T[11]}; }

void unpack_pose(const double* packed, double* T) {
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) T[4 * r + c] = packed[3 * r + c];
        T[4 * r + 3] = packed[9 + r], T[12 + r] = 0.0;
    }
    T[15] = 1.0;
}

nb::tuple extract(const bgs::OrbExtractor& extractor, const Grey& image) {
    const int width = static_cast<int>(image.shape(1)), height = static_cast<int>(image.shape(0));
    require(width > 0 && height > 0 && width <= 32000 && height <= 32000, "image size must be between 1 and 32000 px");
    bgs::OrbResult found;
    {
        nb::gil_scoped_release release;
        found = extractor.extract(image.data(), width, height);
    }
    const size_t n = found.octave.size();
    nb::list levels;
    for (bgs::OrbLevel& level : found.levels) {
        const size_t h = static_cast<size_t>(level.height), w = static_cast<size_t>(level.width);
        uint8_t* pixels = level.pixels.release();
        nb::capsule owner(pixels, [](void* p) noexcept { delete[] static_cast<uint8_t*>(p); });
        levels.append(nb::cast(nb::ndarray<nb::numpy, uint8_t>(pixels, {h, w}, owner)));
    }
    return nb::make_tuple(array(std::move(found.xy), {n, 2}), array(std::move(found.octave), {n}), array(std::move(found.descriptors), {n, 4}), levels);
}

nb::tuple bucketed(const In<int64_t, 2>& corners, int wanted, int bucket) {
    require(corners.shape(1) == 3 && wanted >= 0 && bucket > 0, "corners must have shape (N, 3): x, y, score");
    std::vector<bgs::Corner> all(corners.shape(0));
    int width = 1, height = 1;
    for (size_t i = 0; i < all.size(); ++i) {
        require(corners(i, 0) >= 0 && corners(i, 0) < 32000 && corners(i, 1) >= 0 && corners(i, 1) < 32000 && corners(i, 2) >= 0 && corners(i, 2) < 256,
                "x and y must be in 0 .. 31999, scores in 0 .. 255");
        all[i] = {static_cast<uint16_t>(corners(i, 0)), static_cast<uint16_t>(corners(i, 1)), static_cast<uint32_t>(corners(i, 2))};
        width = std::max(width, all[i].x + 1), height = std::max(height, all[i].y + 1);
    }
    nb::list kept;
    for (const bgs::Corner& c : bgs::bucketed(all, wanted, bucket, width, height)) kept.append(nb::make_tuple(int(c.x), int(c.y), int(c.score)));
    return nb::tuple(kept);
}

nb::tuple pair_rows(const Rows& left_xy, const Ints& left_octave, const Described& left, const Rows& right_xy, const Ints& right_octave, const Described& right,
                    const Doubles& band, double nearest_left, double beyond, int max_distance) {
    bgs::StereoPairArgs args{};
    args.left = keypoints_of(left_xy, left_octave, left), args.right = keypoints_of(right_xy, right_octave, right);
    require(max_distance >= 0 && max_distance <= 1000, "max_distance must be in 0 .. 1000");
    require(args.left.kind == args.right.kind, "both images must have descriptors of one kind");
    require(band.shape(0) == left_xy.shape(0), "band must have shape (N,)");
    args.band = band.data(), args.nearest_left = nearest_left, args.beyond = beyond, args.max_distance = max_distance;
    const size_t n = left_xy.shape(0);
    std::vector<int32_t> best(n), distance(n);
    {
        nb::gil_scoped_release release;
        std::vector<int32_t> row(right_xy.shape(0));
        double last = 0.0;
        for (size_t j = 0; j < row.size(); ++j) last = std::max(last, args.right.xy[2 * j + 1]);
        require(last < 32000.0, "keypoints must lie inside an image");
        args.rows = static_cast<int>(last) + 1;
        for (size_t j = 0; j < row.size(); ++j) row[j] = static_cast<int32_t>(std::max(0.0, args.right.xy[2 * j + 1]));  // NaN becomes 0
        const bgs::CellIndex index(row, args.rows);
        args.row_start = index.start.data(), args.by_row = index.order.data();
        args.best_right = best.data(), args.best_distance = distance.data();
        bgs::tracking().pair_rows(args);
    }
    return nb::make_tuple(array(std::move(best), {n}), array(std::move(distance), {n}));
}

// Disparity in octave pixels and RMS difference; NaN where there is no minimum inside the search.
nb::tuple refine_disparity(const Levels& left, const Levels& right, const Ints& octave, const In<int64_t, 2>& at_left, const Ints& x_right) {
    const size_t n = octave.shape(0), levels = left.size();
    require(right.size() == levels && at_left.shape(0) == n && at_left.shape(1) == 2 && x_right.shape(0) == n, "arrays of matches must have equal length");
    for (size_t l = 0; l < levels; ++l)
        require(left[l].shape(0) == right[l].shape(0) && left[l].shape(1) == right[l].shape(1), "both pyramids must have the same sizes");
    for (size_t i = 0; i < n; ++i) require(octave(i) >= 0 && octave(i) < static_cast<int64_t>(levels), "octave without an image");
    const double unknown = std::numeric_limits<double>::quiet_NaN();
    std::vector<double> disparity(n, unknown), rms(n, unknown);
    {
        nb::gil_scoped_release release;
        constexpr int H = bgs::SSD_HALF_WINDOW, S = bgs::SSD_SHIFTS / 2, SIDE = 2 * H + 1;
        for (size_t i = 0; i < n; ++i) {
            const bgs::GreyImage l = image_of(left[static_cast<size_t>(octave(i))]), r = image_of(right[static_cast<size_t>(octave(i))]);
            const int64_t x = at_left(i, 0), y = at_left(i, 1), other = x_right(i);
            if (y < H || y >= l.height - H || x < H || x >= l.width - H || other < H + S || other >= l.width - H - S) continue;
            float cost[bgs::SSD_SHIFTS];
            bgs::tracking().ssd_profile(l, r, static_cast<int>(x), static_cast<int>(y), static_cast<int>(other), cost);
            const int best = static_cast<int>(std::min_element(cost, cost + bgs::SSD_SHIFTS) - cost);
            if (best == 0 || best == bgs::SSD_SHIFTS - 1) continue;
            const double before = cost[best - 1], centre = cost[best], after = cost[best + 1], curvature = before + after - 2.0 * centre;
            if (!(curvature > 0.0)) continue;
            disparity[i] = static_cast<double>(x - other - best + S) - 0.5 * (before - after) / curvature;
            rms[i] = std::sqrt(std::max(centre, 0.0)) / SIDE;
        }
    }
    return nb::make_tuple(array(std::move(disparity), {n}), array(std::move(rms), {n}));
}

nb::tuple match_boxes(const Rows& uv, const Doubles& radius, const Doubles& octave, const Doubles& disparity, const Described& described,
                      const Rows& keypoint_xy, const Ints& keypoint_octave, const Doubles& keypoint_disparity, const Described& keypoint_described,
                      int max_distance, double ratio, double octave_tolerance) {
    const size_t n = rows(uv, 2, "uv must have shape (Q, 2)");
    require(radius.shape(0) == n && octave.shape(0) == n && disparity.shape(0) == n && described.shape(0) == n,
            "radius, octave, disparity (Q,) and descriptors (Q, 4) or (Q, 64) must match uv");
    bgs::BoxMatchArgs args{};
    args.uv = uv.data(), args.radius = radius.data(), args.octave = octave.data(), args.disparity = disparity.data();
    args.descriptor = described.data(), args.queries = static_cast<int>(n);
    args.keypoints = keypoints_of(keypoint_xy, keypoint_octave, keypoint_described), args.keypoint_disparity = keypoint_disparity.data();
    require(keypoint_disparity.shape(0) == keypoint_xy.shape(0), "the keypoints' disparities must have shape (N,)");
    require(max_distance >= 0 && max_distance <= 1000, "max_distance must be in 0 .. 1000");
    require(kind_of(described) == args.keypoints.kind, "queries and keypoints must have descriptors of one kind");
    args.max_distance = max_distance, args.ratio = ratio, args.octave_tolerance = octave_tolerance, args.cell = 16.0;
    std::vector<int32_t> keypoint(n), distance(n);
    {
        nb::gil_scoped_release release;
        const size_t count = static_cast<size_t>(args.keypoints.count);
        double width = 0.0, height = 0.0;
        for (size_t j = 0; j < count; ++j) width = std::max(width, args.keypoints.xy[2 * j]), height = std::max(height, args.keypoints.xy[2 * j + 1]);
        require(width < 32000.0 && height < 32000.0, "keypoints must lie inside an image");
        args.cells_x = static_cast<int>(width / args.cell) + 1, args.cells_y = static_cast<int>(height / args.cell) + 1;
        std::vector<int32_t> cell(count);
        for (size_t j = 0; j < count; ++j)
            cell[j] = static_cast<int32_t>(std::max(0.0, args.keypoints.xy[2 * j + 1]) / args.cell) * args.cells_x +
                      static_cast<int32_t>(std::max(0.0, args.keypoints.xy[2 * j]) / args.cell);
        const bgs::CellIndex index(cell, args.cells_x * args.cells_y);
        args.cell_start = index.start.data(), args.by_cell = index.order.data();
        args.best_keypoint = keypoint.data(), args.best_distance = distance.data();
        bgs::tracking().match_boxes(args);
    }
    return nb::make_tuple(array(std::move(keypoint), {n}), array(std::move(distance), {n}));
}

nb::tuple optimise_pose(const std::vector<double>& camera, const Rows& points, const Rows& measured, const Rows& T_cam_world, int rounds, int iterations,
                        bool gate_first) {
    const size_t n = rows(points, 3, "points must have shape (M, 3)");
    require(rows(measured, 4, "measured must have shape (M, 4): u, v, disparity, weight") == n, "points and measured must have equal length");
    require(rows(T_cam_world, 4, "T_cam_world must have shape (4, 4)") == 4, "T_cam_world must have shape (4, 4)");
    require(rounds >= 1 && iterations >= 1, "rounds and iterations must be at least 1");
    std::vector<double> pose = pack_pose(T_cam_world.data()), out(16);
    std::vector<uint8_t> inlier(n);
    double squared = 0.0;
    const bgs::PoseArgs args{camera_of(camera), points.data(), measured.data(), static_cast<int>(n), rounds,
                             iterations,        gate_first,    pose.data(),     inlier.data(),       &squared};
    {
        nb::gil_scoped_release release;
        bgs::tracking().optimise_pose(args);
    }
    unpack_pose(pose.data(), out.data());
    return nb::make_tuple(array(std::move(out), {4, 4}), array(std::move(inlier), {n}), squared);
}

nb::tuple bundle(const std::vector<double>& camera, const In<double, 3>& T_cam_world, int fixed, const Rows& points, const Ints& keyframe, const Ints& point,
                 const Rows& measured, const std::vector<int>& iterations) {
    const size_t k = T_cam_world.shape(0), p = rows(points, 3, "points must have shape (P, 3)");
    const size_t m = rows(measured, 4, "measured must have shape (M, 4): u, v, disparity, weight");
    require(T_cam_world.shape(1) == 4 && T_cam_world.shape(2) == 4, "T_cam_world must have shape (K, 4, 4)");
    require(fixed >= 0 && static_cast<size_t>(fixed) < k, "fixed must be at least 0 and below the number of keyframes");
    require(keyframe.shape(0) == m && point.shape(0) == m, "keyframe and point must have shape (M,)");
    std::vector<int32_t> frame(m), of(m);
    for (size_t i = 0; i < m; ++i) {
        require(keyframe(i) >= 0 && keyframe(i) < static_cast<int64_t>(k) && point(i) >= 0 && point(i) < static_cast<int64_t>(p),
                "keyframe and point must index into T_cam_world and points");
        require(i == 0 || keyframe(i) >= keyframe(i - 1), "observations must be sorted by keyframe");
        frame[i] = static_cast<int32_t>(keyframe(i)), of[i] = static_cast<int32_t>(point(i));
    }
    std::vector<double> pose(12 * k), position(points.data(), points.data() + 3 * p), out(16 * k);
    for (size_t i = 0; i < k; ++i) {
        const std::vector<double> packed = pack_pose(T_cam_world.data() + 16 * i);
        std::copy(packed.begin(), packed.end(), pose.begin() + static_cast<ptrdiff_t>(12 * i));
    }
    std::vector<uint8_t> inlier(m);
    {
        nb::gil_scoped_release release;
        const bgs::CellIndex index(of, static_cast<int>(p));
        const std::unique_ptr<double[]> scratch(
            new double[bgs::bundle_scratch(static_cast<int>(k) - fixed, static_cast<int>(k), static_cast<int>(p), static_cast<int>(m))]);
        bgs::BundleArgs args{};
        args.camera = camera_of(camera);
        args.keyframes = static_cast<int>(k), args.fixed = fixed, args.points = static_cast<int>(p), args.count = static_cast<int>(m);
        args.pose = pose.data(), args.point = position.data(), args.keyframe = frame.data(), args.measured = measured.data();
        args.start = index.start.data(), args.by_point = index.order.data();
        args.rounds = iterations.data(), args.round_count = static_cast<int>(iterations.size());
        args.inlier = inlier.data(), args.scratch = scratch.get();
        bgs::tracking().bundle(args);
    }
    for (size_t i = 0; i < k; ++i) unpack_pose(pose.data() + 12 * i, out.data() + 16 * i);
    return nb::make_tuple(array(std::move(out), {k, 4, 4}), array(std::move(position), {p, 3}), array(std::move(inlier), {m}));
}

}  // namespace

void bind_tracking(nb::module_& m) {
    nb::class_<bgs::OrbExtractor>(m, "OrbExtractor")
        .def(
            "__init__",
            [](bgs::OrbExtractor* self, int features, int octaves, double scale_factor, int threshold, const In<float, 2>& tests) {
                require(features > 0 && octaves > 0 && scale_factor > 1.0 && scale_factor <= 2.0,
                        "features and octaves must be positive, scale_factor above 1 and at most 2");
                require(threshold >= 1 && threshold <= 254, "threshold must be between 1 and 254");
                require(tests.shape(0) == 4 && tests.shape(1) == 256, "tests must have shape (4, 256): ax, ay, bx, by");
                new (self) bgs::OrbExtractor(features, octaves, scale_factor, threshold, std::vector<float>(tests.data(), tests.data() + 1024));
            },
            "features"_a, "octaves"_a, "scale_factor"_a, "threshold"_a, "tests"_a)
        .def("extract", &extract, "image"_a.noconvert());
    m.def("bucketed", &bucketed, "corners"_a, "wanted"_a, "bucket"_a);
    m.def("pair_rows", &pair_rows, "left_xy"_a, "left_octave"_a, "left_descriptors"_a, "right_xy"_a, "right_octave"_a, "right_descriptors"_a, "band"_a,
          "nearest_left"_a, "beyond"_a, "max_distance"_a);
    m.def("refine_disparity", &refine_disparity, "left"_a, "right"_a, "octave"_a, "at_left"_a, "x_right"_a);
    m.def("match_boxes", &match_boxes, "uv"_a, "radius"_a, "octave"_a, "disparity"_a, "descriptors"_a, "keypoint_xy"_a, "keypoint_octave"_a,
          "keypoint_disparity"_a, "keypoint_descriptors"_a, "max_distance"_a, "ratio"_a, "octave_tolerance"_a);
    m.def("optimise_pose", &optimise_pose, "camera"_a, "points"_a, "measured"_a, "T_cam_world"_a, "rounds"_a, "iterations"_a, "gate_first"_a);
    m.def("bundle_adjust", &bundle, "camera"_a, "T_cam_world"_a, "fixed"_a, "points"_a, "keyframe"_a, "point"_a, "measured"_a, "iterations"_a);
}
