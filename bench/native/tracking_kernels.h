// What the tracker's kernel file offers, compiled once for each instruction set, and the plain data that it works on.
//
// Conventions: pixel (x, y) has its centre at integer coordinates; p_cam = R_cam_world p_world + t; lengths in metres.
// The kernels allocate nothing: every buffer is the caller's (tracking.cpp). All of them are single-threaded, so the
// same input gives the same bits.
#pragma once

#include <cstddef>
#include <cstdint>

namespace bgs {

constexpr int FAST_BORDER = 19;  // the descriptor's tests reach 18.4 px from the keypoint
constexpr int SSD_SHIFTS = 11;   // shifts -5 .. 5 px of stereo's sub-pixel search
constexpr int SSD_HALF_WINDOW = 5;

struct GreyImage {
    const uint8_t* data;
    int width, height;
    ptrdiff_t stride;
};

struct Corner {
    uint16_t x, y;
    uint32_t score;
};

// Descriptors: (N, 4) uint64, apart by the number of differing bits, or (N, 64) int8, apart by the length of the difference.
enum class DescriptorKind { BITS, BYTES };

// Keypoints as the kernels see them: position in pixels of the full image, octave, descriptor.
struct Keypoints {
    const double* xy;        // (N, 2)
    const int64_t* octave;   // (N,)
    const void* descriptor;  // (N, words of the kind)
    DescriptorKind kind;
    int count;
};

struct StereoPairArgs {
    Keypoints left, right;        // descriptors of one kind
    const double* band;           // (left.count,): rows by which a match may be off
    double nearest_left, beyond;  // a match lies in [x - nearest_left, x + beyond]
    int max_distance;
    const int32_t *row_start, *by_row;  // right keypoints in order of floor(y): those of row r are by_row[row_start[r] ...]
    int rows;
    int32_t* best_right;     // (left.count,): out, -1 = none
    int32_t* best_distance;  // out; squared between bytes
};

struct BoxMatchArgs {
    const double *uv, *radius, *octave, *disparity;  // queries: (Q, 2), (Q,), (Q,), (Q,); disparity may be NaN
    const void* descriptor;                          // (Q, words), of the keypoints' kind
    int queries;
    Keypoints keypoints;
    const double* keypoint_disparity;     // (N,) pixels or NaN
    const int32_t *cell_start, *by_cell;  // keypoints by cell of the grid, row by row
    int cells_x, cells_y;
    double cell;  // side of a cell in pixels
    int max_distance;
    double ratio, octave_tolerance;
    int32_t *best_keypoint, *best_distance;  // (Q,): out, -1 = none; squared between bytes
};

struct Pinhole {
    double fx, fy, cx, cy, bf;  // bf = fx * baseline, pixels times metres
};

// M measurements: (u, v, disparity or NaN, weight 1 / sigma^2).
struct PoseArgs {
    Pinhole camera;
    const double *points, *measured;  // (M, 3) in the world; (M, 4)
    int count;
    int rounds, iterations;
    bool gate_first;  // leave out from the beginning what is beyond its gate at the start
    double* pose;     // (12): R row by row, then t; in: start, out: result
    uint8_t* inlier;  // (M,): out
    double* squared;  // out: sum over inliers of the squared (u, v) residual
};

struct BundleArgs {
    Pinhole camera;
    int keyframes, fixed, points, count;
    double *pose, *point;             // (K, 12), (P, 3); in: start, out: result
    const int32_t* keyframe;          // (M,)
    const double* measured;           // (M, 4)
    const int32_t *start, *by_point;  // observations of point p are by_point[start[p] .. start[p + 1]]
    const int* rounds;                // iterations of each round
    int round_count;
    uint8_t* inlier;  // (M,): out
    double* scratch;  // bundle_scratch() doubles
};

// Doubles that `bundle` needs for f free poses, p points and m observations.
inline size_t bundle_scratch(int f, int keyframes, int p, int m) {
    const size_t n = 6 * static_cast<size_t>(f);
    return 48 * static_cast<size_t>(f) * f + n * n + 3 * n + 12 * static_cast<size_t>(keyframes) + 15 * static_cast<size_t>(p) + 24 * static_cast<size_t>(m);
}

struct TrackingTable {
    void (*shrink)(const GreyImage& image, uint8_t* out, int width, int height, uint16_t* rows);
    void (*blur)(const GreyImage& image, uint8_t* out, uint16_t* rows);
    int (*fast_corners)(const GreyImage& image, int threshold, uint8_t* scores, Corner* corners);
    void (*describe)(const GreyImage& image, const GreyImage& blurred, const Corner* corners, int count, const float* tests, uint64_t* descriptors);
    void (*pair_rows)(const StereoPairArgs&);
    void (*ssd_profile)(const GreyImage& left, const GreyImage& right, int x_left, int y, int x_right, float* cost);
    void (*match_boxes)(const BoxMatchArgs&);
    void (*optimise_pose)(const PoseArgs&);
    void (*bundle)(const BundleArgs&);
};

extern const TrackingTable tracking_baseline;
#if defined(BGS_HAVE_X86_KERNELS)
extern const TrackingTable tracking_avx2, tracking_avx512;
#endif

}  // namespace bgs
