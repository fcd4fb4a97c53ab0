// Runs the kernels of L1 + L2 + SSIM.
#include <vector>

#include "losses.h"

namespace bgs {

PhotometricResult photometric(PhotometricArgs args) {
    args.band_height = 128;
    const int tasks = args.channels * ((args.height + args.band_height - 1) / args.band_height);
    std::vector<double> sums(static_cast<size_t>(tasks) * 3);
    args.sums = sums.data();
    const KernelTable& k = kernels();
    pool().run(tasks, [&](int task) {
        static thread_local Buffer<float> scratch;
        k.photometric(args, task, scratch.reserve(photometric_scratch(args.width)));
    });
    PhotometricResult result{0, 0, 0};
    for (int t = 0; t < tasks; ++t) result.l1 += sums[3 * t], result.l2 += sums[3 * t + 1], result.ssim += sums[3 * t + 2];
    const double elements = static_cast<double>(args.width) * args.height * args.channels;
    result.l1 /= elements, result.l2 /= elements, result.ssim /= elements;
    return result;
}

void target_statistics(const float* target, float* mean, float* variance, int width, int height, int channels) {
    const size_t plane = static_cast<size_t>(width) * height;
    pool().run(channels, [&](int c) {
        static thread_local Buffer<float> scratch;
        kernels().target_statistics(target + c * plane, mean + c * plane, variance + c * plane, width, height, scratch.reserve(photometric_scratch(width)));
    });
}

}  // namespace bgs
