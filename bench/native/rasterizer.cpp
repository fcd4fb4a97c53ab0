// Runs the rasterizer's kernels stage by stage.
#include "rasterizer.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <numeric>
#include <utility>
#include <vector>

namespace bgs {

View view_of(const double* T_cam_world, float fx, float fy, float cx, float cy, int width, int height) {
    const auto T = [&](int row, int column) { return T_cam_world[4 * row + column]; };
    View v{};
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) v.R[3 * r + c] = static_cast<float>(T(r, c));
        v.t[r] = static_cast<float>(T(r, 3));
    }
    for (int k = 0; k < 3; ++k) v.center[k] = static_cast<float>(-(T(0, k) * T(0, 3) + T(1, k) * T(1, 3) + T(2, k) * T(2, 3)));
    v.fx = fx, v.fy = fy, v.cx = cx, v.cy = cy, v.width = width, v.height = height;
    // As in gsplat, where pixel centres are at .5.
    constexpr auto margin = static_cast<float>(JACOBIAN_MARGIN);
    const float margin_x = margin * static_cast<float>(width) / fx, margin_y = margin * static_cast<float>(height) / fy;
    v.x_over_z_min = -((cx + 0.5f) / fx + margin_x), v.x_over_z_max = (static_cast<float>(width) - cx - 0.5f) / fx + margin_x;
    v.y_over_z_min = -((cy + 0.5f) / fy + margin_y), v.y_over_z_max = (static_cast<float>(height) - cy - 0.5f) / fy + margin_y;
    return v;
}

// Records of the visible Gaussians, nearest first in the list of each tile.
void Workspace::project(const float* planes, size_t stride, int count, int degree, const View& view) {
    view_ = view, count_ = count, degree_ = degree;
    tiles_x_ = (view.width + TILE_W - 1) / TILE_W, tiles_y_ = (view.height + TILE_H - 1) / TILE_H;
    const int chunks = (count + CHUNK - 1) / CHUNK;
    const KernelTable& k = kernels();
    uint64_t* groups = groups_.reserve(static_cast<size_t>(chunks) * GROUP_WORDS);
    int* first_record = first_record_.reserve(static_cast<size_t>(chunks) + 1);
    const CullArgs cull{planes, stride, count, view, groups, first_record};
    pool().run(chunks, [&](int chunk) { k.cull(cull, chunk); });
    int candidates = 0;
    for (int c = 0; c < chunks; ++c) candidates += std::exchange(first_record[c], candidates);
    first_record[chunks] = candidates;
    const auto most = static_cast<size_t>(candidates);
    const ProjectArgs project{planes,
                              stride,
                              count,
                              degree,
                              view,
                              groups,
                              first_record,
                              records_.reserve(most),
                              boxes_.reserve(most),
                              place_.reserve(static_cast<size_t>(count)),
                              chunk_counts_.reserve(static_cast<size_t>(chunks) + 1),
                              first_slot_.reserve(static_cast<size_t>(chunks) + 1)};
    pool().run(chunks, [&](int chunk) { k.project(project, chunk); });
    sort_by_depth(chunks);
    bin();
}

RasterArgs Workspace::raster_args() const {
    return {records_.data(), tile_start_.data(), tile_list_.data(), tile_blocks_.data(), view_.width, view_.height, tiles_x_, tiles_y_, color_, depth_, alpha_};
}

void Workspace::forward(const float* planes, size_t stride, int count, int degree, const View& view, float* color, float* depth, float* alpha) {
    project(planes, stride, count, degree, view);
    color_ = color, depth_ = depth, alpha_ = alpha;
    const RasterArgs raster = raster_args();
    pool().run(tiles_x_ * tiles_y_, [&](int tile) { kernels().raster_forward(raster, tile); });
}

void Workspace::observe(const float* planes, size_t stride, int count, int degree, const View& view, int* pixels, float* median_depth) {
    project(planes, stride, count, degree, view);
    static_assert(sizeof(int) == sizeof(float), "the counts borrow a buffer of floats");
    int* slots = reinterpret_cast<int*>(slots_.reserve(slots_used_));
    const ObserveArgs args{raster_args(), slots, first_slot_.data(), median_depth};
    pool().run(tiles_x_ * tiles_y_, [&](int tile) { kernels().raster_observe(args, tile); });
    std::fill(pixels, pixels + count, 0);
    const int* starts = chunk_counts_.data();
    for (int i = 0; i < count; ++i) {
        const int chunk = i / CHUNK;
        if (starts[chunk] == starts[chunk + 1]) i = (chunk + 1) * CHUNK - 1;
        else if (place_.data()[i] >= 0) {
            const Record& r = records_.data()[place_.data()[i]];
            const int* mine = slots + first_slot_.data()[r.chunk] + r.slot;
            pixels[i] = std::accumulate(mine, mine + r.box.tiles(), 0);
        }
    }
}

// Stable radix sort of the visible Gaussians by depth; equal depths keep the order of the map.
void Workspace::sort_by_depth(int chunks) {
    constexpr int BITS = 11, RADIX = 1 << BITS;
    int* starts = chunk_counts_.data();
    uint32_t* slots = first_slot_.data();
    int total = 0;
    uint32_t all_slots = 0;
    for (int c = 0; c < chunks; ++c) {
        const int n = starts[c];
        const uint32_t s = slots[c];
        starts[c] = total, slots[c] = all_slots;
        total += n, all_slots += s;
    }
    starts[chunks] = total;
    visible_ = total, slots_used_ = all_slots;
    const size_t n = static_cast<size_t>(total);
    // All of this is over when bin() has run, so it lives where the backward pass puts the gradient slots.
    static_assert(sizeof(uint32_t) == sizeof(float), "the sort borrows a buffer of floats");
    uint32_t *keys = reinterpret_cast<uint32_t*>(slots_.reserve(4 * n)), *keys_other = keys + n, *order = keys_other + n, *order_other = order + n;
    pool().run(chunks, [&](int c) {
        const auto first = static_cast<uint32_t>(first_record_.data()[c]);
        const Record* from = records_.data() + first;
        for (int j = 0, at = starts[c]; at < starts[c + 1]; ++j, ++at) {
            std::memcpy(&keys[at], &from[j].depth, sizeof(uint32_t));  // the bits of a positive float sort like the float
            order[at] = first + static_cast<uint32_t>(j);
        }
    });
    // Each part of the threads counts and then places its own stretch; the parts' buckets follow one another.
    const int parts = pool().threads();
    std::vector<std::array<uint32_t, RADIX>> histograms(static_cast<size_t>(parts));
    const auto stretch = [&](int part) { return n * static_cast<size_t>(part) / static_cast<size_t>(parts); };
    for (int shift = 0; shift < 3 * BITS; shift += BITS) {
        pool().run(parts, [&](int part) {
            auto& h = histograms[static_cast<size_t>(part)];
            h.fill(0);
            for (size_t j = stretch(part); j < stretch(part + 1); ++j) ++h[(keys[j] >> shift) & (RADIX - 1)];
        });
        uint32_t sum = 0;
        for (int bucket = 0; bucket < RADIX; ++bucket)
            for (auto& h : histograms) {
                const uint32_t size = h[static_cast<size_t>(bucket)];
                h[static_cast<size_t>(bucket)] = sum;
                sum += size;
            }
        pool().run(parts, [&](int part) {
            auto& h = histograms[static_cast<size_t>(part)];
            for (size_t j = stretch(part); j < stretch(part + 1); ++j) {
                const uint32_t to = h[(keys[j] >> shift) & (RADIX - 1)]++;
                keys_other[to] = keys[j], order_other[to] = order[j];
            }
        });
        std::swap(keys, keys_other), std::swap(order, order_other);
    }
    by_depth_ = order;
}

// Counting sort of (Gaussian, tile) pairs into tiles; within a tile the nearest come first.
void Workspace::bin() {
    const int tiles = tiles_x_ * tiles_y_, parts = pool().threads();
    uint32_t* counts = bin_counts_.reserve(static_cast<size_t>(tiles) * parts);
    uint32_t* start = tile_start_.reserve(static_cast<size_t>(tiles) + 1);
    const TileBox* boxes = boxes_.data();
    const uint32_t* by_depth = by_depth_;
    // Each part takes a stretch of the depth order; its tiles are visited nearest first.
    const auto each_pair = [&](int part, auto&& visit) {
        const int begin = static_cast<int>(static_cast<int64_t>(visible_) * part / parts);
        const int end = static_cast<int>(static_cast<int64_t>(visible_) * (part + 1) / parts);
        for (int j = begin; j < end; ++j) {
            if (j + 16 < end) __builtin_prefetch(&boxes[by_depth[j + 16]]);
            const TileBox box = boxes[by_depth[j]];
            for (int ty = box.y0; ty <= box.y1; ++ty)
                for (int tx = box.x0; tx <= box.x1; ++tx) visit(ty * tiles_x_ + tx, by_depth[j]);
        }
    };
    pool().run(parts, [&](int part) {
        uint32_t* mine = counts + static_cast<size_t>(part) * tiles;
        std::fill(mine, mine + tiles, 0u);
        each_pair(part, [&](int tile, uint32_t) { ++mine[tile]; });
    });
    uint32_t sum = 0;
    for (int tile = 0; tile < tiles; ++tile) {
        start[tile] = sum;
        for (int part = 0; part < parts; ++part) {
            uint32_t& entry = counts[static_cast<size_t>(part) * tiles + tile];
            const uint32_t size = entry;
            entry = sum;
            sum += size;
        }
    }
    start[tiles] = sum;
    uint32_t* list = tile_list_.reserve(sum);
    tile_blocks_.reserve(sum);
    pool().run(parts, [&](int part) {
        uint32_t* mine = counts + static_cast<size_t>(part) * tiles;
        each_pair(part, [&](int tile, uint32_t place) { list[mine[tile]++] = place; });
    });
}

ProjectBackwardArgs Workspace::raster_backward(const float* planes, size_t stride, const float* grad_color, const float* grad_depth, const float* grad_alpha,
                                               int count, bool with_pose) {
    float* slots = slots_.reserve(slots_used_ * SLOT);
    const RasterBackwardArgs raster{raster_args(), grad_color, grad_depth, grad_alpha, slots, first_slot_.data()};
    pool().run(tiles_x_ * tiles_y_, [&](int tile) { kernels().raster_backward(raster, tile); });
    ProjectBackwardArgs project{};
    project.planes = planes, project.stride = stride, project.count = count, project.degree = degree_, project.view = view_;
    project.records = records_.data(), project.chunk_starts = chunk_counts_.data(), project.place = place_.data();
    project.slots = slots, project.first_slot = first_slot_.data();
    project.pose = with_pose ? pose_.reserve(static_cast<size_t>((count + CHUNK - 1) / CHUNK) * 6) : nullptr;
    return project;
}

void Workspace::sum_pose(int chunks, double* pose) const {
    std::fill(pose, pose + 6, 0.0);
    for (int c = 0; c < chunks; ++c)
        for (int j = 0; j < 6; ++j) pose[j] += pose_.data()[6 * c + j];
}

void Workspace::backward(const float* planes, size_t stride, const float* grad_color, const float* grad_depth, const float* grad_alpha, float* grads,
                         size_t grads_stride, int learning, bool* touched, double* pose) {
    ProjectBackwardArgs project = raster_backward(planes, stride, grad_color, grad_depth, grad_alpha, learning, pose != nullptr);
    project.grads = grads, project.grads_stride = grads_stride, project.touched = touched;
    const int chunks = (learning + CHUNK - 1) / CHUNK;
    pool().run(chunks, [&](int chunk) { kernels().project_backward(project, chunk); });
    if (pose != nullptr) sum_pose(chunks, pose);
}

void Workspace::learn(const float* planes, size_t stride, const float* grad_color, const float* grad_depth, const float* grad_alpha, const AdamArgs& adam,
                      double* pose) {
    const int count = pose == nullptr ? adam.count : count_, chunks = (count + CHUNK - 1) / CHUNK;
    const ProjectBackwardArgs all = raster_backward(planes, stride, grad_color, grad_depth, grad_alpha, count, pose != nullptr);
    pool().run(chunks, [&](int chunk) {
        static thread_local Buffer<float> grads;
        static thread_local Buffer<bool> touched;
        ProjectBackwardArgs project = all;
        project.first = chunk * CHUNK, project.grads_stride = CHUNK;
        project.grads = grads.reserve(static_cast<size_t>(planes_of(degree_)) * CHUNK), project.touched = touched.reserve(CHUNK);
        kernels().project_backward(project, chunk);
        if (project.chunk_starts[chunk] == project.chunk_starts[chunk + 1]) return;
        AdamArgs step = adam;
        step.grads = project.grads, step.grads_stride = CHUNK, step.grads_first = project.first, step.touched = project.touched;
        kernels().adam(step, chunk);
    });
    if (pose != nullptr) sum_pose(chunks, pose);
}

size_t Workspace::bytes() const {
    return records_.bytes() + groups_.bytes() + first_record_.bytes() + first_slot_.bytes() + chunk_counts_.bytes() + tile_start_.bytes() + tile_list_.bytes() +
           tile_blocks_.bytes() + boxes_.bytes() + bin_counts_.bytes() + place_.bytes() + slots_.bytes() + pose_.bytes();
}

}  // namespace bgs
