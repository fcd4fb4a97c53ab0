// Runs the kernels stage by stage on the thread pool, and owns the scratch memory (it only grows, and is reused).
#pragma once

#include <algorithm>
#include <array>
#include <memory>
#include <vector>

#include "kernels.h"
#include "thread_pool.h"

namespace bgs {

// Memory that is never initialised twice and never given back before the end.
template <typename T>
class Buffer {
public:
    T* reserve(size_t count) {
        if (count > capacity_) {
            capacity_ = std::max(count, capacity_ + capacity_ / 8);
            data_.reset(static_cast<T*>(::operator new[](capacity_ * sizeof(T), std::align_val_t(64))));
        }
        return data_.get();
    }
    T* data() const { return data_.get(); }
    size_t bytes() const { return capacity_ * sizeof(T); }

private:
    struct Free {
        void operator()(T* p) const { ::operator delete[](p, std::align_val_t(64)); }
    };
    std::unique_ptr<T[], Free> data_;
    size_t capacity_ = 0;
};

ThreadPool& pool();
void set_threads(int threads);
const KernelTable& kernels();

// One render: what the forward pass leaves for the backward pass.
class Workspace {
public:
    void forward(const float* planes, size_t stride, int count, int degree, const View& view, float* color, float* depth, float* alpha);
    // `pose` (6 values) may be null; null image gradients count as zero.
    void backward(const float* planes, size_t stride, const float* grad_color, const float* grad_depth, const float* grad_alpha,
                  float* grads, size_t grads_stride, bool* touched, double* pose);
    int count() const { return count_; }
    int degree() const { return degree_; }
    int visible() const { return visible_; }
    int width() const { return view_.width; }
    int height() const { return view_.height; }
    size_t bytes() const;

private:
    void sort_by_depth(int chunks);
    void bin();

    View view_{};
    int count_ = 0, degree_ = 0, visible_ = 0, tiles_x_ = 0, tiles_y_ = 0;
    size_t slots_used_ = 0;
    float *color_ = nullptr, *depth_ = nullptr, *alpha_ = nullptr;  // the caller keeps them alive until backward
    Buffer<Record> records_;
    Buffer<int> chunk_counts_;
    Buffer<uint32_t> first_slot_, tile_start_, tile_list_, bin_counts_;
    const uint32_t* by_depth_ = nullptr;  // places of records, nearest first; until bin() has run
    Buffer<uint64_t> tile_blocks_;
    Buffer<TileBox> boxes_;
    Buffer<int32_t> place_;
    Buffer<float> slots_;  // gradient slots of the backward pass; in the forward pass, scratch of the sort
    Buffer<double> pose_;
};

struct PhotometricResult {
    double l1, ssim;
};
PhotometricResult photometric(PhotometricArgs args);
void target_statistics(const float* target, float* mean, float* variance, int width, int height, int channels);
void adam(const AdamArgs& args);

// The geometric loss terms (geometry.cpp); what they derive from the rest of `args` they fill in themselves.
double normal_loss(NormalArgs args);
double smooth_loss(SmoothArgs args);
double geo_loss(GeoArgs args);

}  // namespace bgs
