// How a map of Gaussians is laid out, and where rendering cuts off. Written here only: Python reads both from the module.
//
// A Gaussian's parameters are rows ("planes") of one float32 array, so that eight Gaussians load as one vector.
#pragma once

namespace bgs {

// First plane of each parameter. Behind the colour's come the harmonics of degree 1 and up: coefficient k >= 1 of channel
// c is plane HARMONICS + 3 (k - 1) + c.
enum Plane { MEAN = 0, LOG_SCALE = 3, QUATERNION = 6, OPACITY_LOGIT = 10, COLOR = 11, HARMONICS = 14 };

constexpr int MAX_DEGREE = 3;
constexpr int planes_of(int degree) { return COLOR + 3 * (degree + 1) * (degree + 1); }

constexpr double SH_C0 = 0.28209479177387814;  // colour = 0.5 + SH_C0 * c + harmonics of degree 1 and up, at least 0

// The thresholds of gsplat.
constexpr double NEAR_M = 0.2;             // nearer Gaussians are skipped
constexpr double LOW_PASS_PX2 = 0.3;       // added to the projected covariance (EWA)
constexpr double ALPHA_MIN = 1.0 / 255.0;  // what covers less of a pixel is not blended
constexpr double ALPHA_MAX = 0.999;
constexpr double TRANSMITTANCE_END = 1e-4;  // a pixel ends before its transmittance falls to this
constexpr double JACOBIAN_MARGIN = 0.15;    // of the image, beyond its borders, is where the projection is linearised at most

}  // namespace bgs
