// The rasterizer: projection, binning and blending, forward and backward.
#pragma once

#include "engine.h"

namespace bgs {

// T_cam_world: row-major 4x4, camera from world; focal lengths and principal point in pixels.
View view_of(const double* T_cam_world, float fx, float fy, float cx, float cy, int width, int height);

// One render: what the forward pass leaves for the backward pass.
class Workspace {
public:
    void forward(const float* planes, size_t stride, int count, int degree, const View& view, float* color, float* depth, float* alpha);
    // Per Gaussian the pixels that see it before half of their light is gone, and where that is; NaN where it never is.
    void observe(const float* planes, size_t stride, int count, int degree, const View& view, int* pixels, float* median_depth);
    // Of the first `learning` Gaussians, of all for a `pose` (6 values, or null); null image gradients count as zero.
    void backward(const float* planes, size_t stride, const float* grad_color, const float* grad_depth, const float* grad_alpha, float* grads,
                  size_t grads_stride, int learning, bool* touched, double* pose);
    // The same, and a step of Adam with the gradients, which are in memory for a chunk of Gaussians at a time.
    void learn(const float* planes, size_t stride, const float* grad_color, const float* grad_depth, const float* grad_alpha, const AdamArgs& adam,
               double* pose);
    int count() const { return count_; }
    int degree() const { return degree_; }
    int visible() const { return visible_; }
    int width() const { return view_.width; }
    int height() const { return view_.height; }
    size_t bytes() const;

private:
    void project(const float* planes, size_t stride, int count, int degree, const View& view);
    RasterArgs raster_args() const;
    // Runs the blending backwards; the rest is of chunks of the first `count` Gaussians.
    ProjectBackwardArgs raster_backward(const float* planes, size_t stride, const float* grad_color, const float* grad_depth, const float* grad_alpha,
                                        int count, bool with_pose);
    void sum_pose(int chunks, double* pose) const;
    void sort_by_depth(int chunks);
    void bin();

    View view_{};
    int count_ = 0, degree_ = 0, visible_ = 0, tiles_x_ = 0, tiles_y_ = 0;
    size_t slots_used_ = 0;
    float *color_ = nullptr, *depth_ = nullptr, *alpha_ = nullptr;  // the caller keeps them alive until backward
    Buffer<Record> records_;
    Buffer<uint64_t> groups_;                  // of eight Gaussians that may be in view
    Buffer<int> first_record_, chunk_counts_;  // of each chunk; once sorted, chunk_counts_ has how many are visible before it
    Buffer<uint32_t> first_slot_, tile_start_, tile_list_, bin_counts_;
    const uint32_t* by_depth_ = nullptr;  // places of records, nearest first; until bin() has run
    Buffer<uint64_t> tile_blocks_;
    Buffer<TileBox> boxes_;
    Buffer<int32_t> place_;
    Buffer<float> slots_;  // gradient slots of the backward pass; in the forward pass, scratch of the sort
    Buffer<double> pose_;
};

}  // namespace bgs
