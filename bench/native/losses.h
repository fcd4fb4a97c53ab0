// The loss terms that the core evaluates; what they derive from the rest of `args` they fill in themselves.
#pragma once

#include "engine.h"

namespace bgs {

struct PhotometricResult {
    double l1, l2, ssim;
};
PhotometricResult photometric(PhotometricArgs args);
void target_statistics(const float* target, float* mean, float* variance, int width, int height, int channels);

// On rendered depth (depth_losses.cpp): unweighted values, weighted gradients.
double normal_loss(NormalArgs args);
double smooth_loss(SmoothArgs args);
double geo_loss(GeoArgs args);

}  // namespace bgs
