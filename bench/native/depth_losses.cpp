// Runs the kernels of the loss terms on depth band by band; their sums are added in the order of the bands.
#include <vector>

#include "losses.h"

namespace bgs {

namespace {

int bands(int height) { return (height + LOSS_BAND - 1) / LOSS_BAND; }

// The sum of kernel(task, scratch) over the bands; each thread has its own scratch.
template <typename Kernel> double sum_of_bands(int height, size_t scratch_floats, const Kernel& kernel) {
    std::vector<double> sums(static_cast<size_t>(bands(height)));
    pool().run(bands(height), [&](int task) {
        static thread_local Buffer<float> scratch;
        sums[static_cast<size_t>(task)] = kernel(task, scratch.reserve(scratch_floats));
    });
    double total = 0;
    for (const double sum : sums) total += sum;
    return total;
}

double at_least_one_normal(const SurfaceArgs& surface, const bool* target_valid) {
    const auto kernel = [&](int task, float*) { return static_cast<double>(kernels().count_normals(surface, target_valid, task)); };
    const double count = sum_of_bands(surface.height, 0, kernel);
    return count < 1 ? 1 : count;
}

}  // namespace

double normal_loss(NormalArgs args) {
    const double count = at_least_one_normal(args.surface, args.target_valid);
    args.surface.scale = static_cast<float>(1 / count);
    const auto kernel = [&](int task, float* scratch) { return kernels().normal_loss(args, task, scratch); };
    return sum_of_bands(args.surface.height, normal_scratch(args.surface.width), kernel) / count;
}

double smooth_loss(SmoothArgs args) {
    const double count = at_least_one_normal(args.surface, nullptr);
    args.surface.scale = static_cast<float>(1 / count);
    args.reach = 0;
    for (int k = 0; k < args.distance_count; ++k)
        if (args.distances[k] < args.surface.height && args.distances[k] > args.reach) args.reach = args.distances[k];
    const auto kernel = [&](int task, float* scratch) { return kernels().smooth_loss(args, task, scratch); };
    return sum_of_bands(args.surface.height, smooth_scratch(args.surface.width, args.reach), kernel) / count;
}

double geo_loss(GeoArgs args) {
    const auto on_grid = [&](int size) { return (size + args.stride - 1) / args.stride; };
    args.per_pixel = static_cast<float>(1.0 / (static_cast<double>(on_grid(args.width)) * on_grid(args.height)));
    const auto kernel = [&](int task, float* scratch) { return kernels().geo_loss(args, task, scratch); };
    return sum_of_bands(args.height, geo_scratch(args.width), kernel);
}

}  // namespace bgs
