// What the kernel file offers, compiled once for each instruction set, and the plain data that it works on.
//
// Conventions: pixel (x, y) has its centre at integer coordinates (OpenCV); p_cam = R_cam_world p_world + t.
#pragma once

#include <cstddef>
#include <cstdint>

#include "schema.h"

namespace bgs {

constexpr float LOG2_255 = 7.99435344f;  // alpha >= ALPHA_MIN where log2(alpha) >= -LOG2_255
constexpr int TILE_W = 32, TILE_H = 16;
constexpr int SLOT = 10;                     // sums a Gaussian collects in a tile: 6 moments, 3 colours, depth
constexpr int LOSS_BAND = 32;                // rows of one task of a loss term on depth
constexpr float ALPHA_FLOOR = 1e-6f;         // depth / alpha divides by at least this
constexpr int CHUNK = 2048;                  // Gaussians of one projection task; a multiple of 512
constexpr int GROUP_WORDS = CHUNK / 8 / 64;  // of 64 bits, one for eight Gaussians, to mark what a chunk has in view

struct View {
    float R[9], t[3], center[3];  // of world to camera; the camera's centre in the world
    float fx, fy, cx, cy;
    int width, height;
    float x_over_z_min, x_over_z_max, y_over_z_min, y_over_z_max;  // where the Jacobian is evaluated at most
};

// The tiles that a Gaussian reaches: first and last column, first and last row.
struct TileBox {
    uint16_t x0, x1, y0, y1;
    int tiles() const { return (x1 - x0 + 1) * (y1 - y0 + 1); }
};

// One visible Gaussian in image space: exactly one cache line.
struct alignas(64) Record {
    float x, y;     // projected centre, px
    float a, b, c;  // a dx^2 + b dx dy + c dy^2 = -log2(exp(...)): the conic with log2(e)/2 folded in
    float level;    // log2(opacity): alpha = 2^(level - the quadratic form)
    float color[3];
    float depth;
    TileBox box;     // of alpha >= 1/255
    uint32_t slot;   // first of its private gradient slots in its chunk's, one a tile of the bounding box
    uint32_t chunk;  // which chunk of Gaussians it is of
};
static_assert(sizeof(Record) == 64, "a record is one cache line");

struct CullArgs {
    const float* planes;
    size_t stride;
    int count;
    View view;
    uint64_t* groups;  // GROUP_WORDS a chunk: the groups of eight Gaussians of which the view may show one
    int* candidates;   // of each chunk: at most that many are visible
};

struct ProjectArgs {
    const float* planes;
    size_t stride;
    int count, degree;  // of the spherical harmonics
    View view;
    const uint64_t* groups;  // what cull() left, and from where on each chunk writes
    const int* first_record;
    Record* records;
    TileBox* boxes;         // of each record: binning walks them out of order, and these fit the cache
    int32_t* place;         // of each Gaussian's record, -1 if it is not visible; not written for a chunk without records
    int* chunk_counts;      // how many records chunk k wrote
    uint32_t* chunk_slots;  // how many (Gaussian, tile) pairs they have; record.slot counts from the chunk's first
};

struct RasterArgs {
    const Record* records;
    const uint32_t* tile_start;  // tiles + 1
    const uint32_t* tile_list;   // places of records, nearest first within a tile
    uint64_t* tile_blocks;       // beside each entry: the blocks of the tile that the Gaussian reaches; the forward pass writes it
    int width, height, tiles_x, tiles_y;
    float *color, *depth, *alpha;  // planar (3, H, W), (H, W), (H, W)
};

struct RasterBackwardArgs {
    RasterArgs forward;                                 // its outputs are read
    const float *grad_color, *grad_depth, *grad_alpha;  // null = zero
    float* slots;
    const uint32_t* first_slot;  // of each chunk
};

struct ObserveArgs {
    RasterArgs forward;          // without outputs and blocks
    int* slots;                  // of each (Gaussian, tile) pair: pixels
    const uint32_t* first_slot;  // of each chunk
    float* median_depth;         // (H, W)
};

struct ProjectBackwardArgs {
    const float* planes;
    size_t stride;
    int count, degree;  // count: of those whose gradients are wanted, the first ones of the map
    View view;
    const Record* records;
    const int* chunk_starts;  // chunks + 1: how many are visible before each chunk
    const int32_t* place;     // of each Gaussian's record, -1 if not visible
    const float* slots;
    const uint32_t* first_slot;  // of each chunk
    float* grads;                // planes like the parameters, from the Gaussian `first` on; written for groups of eight with a visible one
    size_t grads_stride;
    bool* touched;  // per Gaussian from `first` on: whether it was visible
    int first;
    double* pose;  // per chunk 6 sums (translation, rotation), or null
};

struct PhotometricArgs {
    const float* image;  // planar (channels, H, W)
    const float* target;
    const float* target_mean;      // Gaussian-weighted local mean of the target, zero padded
    const float* target_variance;  // likewise its local variance
    float* grad;                   // written; may be null
    int width, height, channels;
    float weight_l1, weight_l2, weight_ssim;  // of the mean absolute error, of the mean squared error and of 1 - mean SSIM
    int band_height;
    double* sums;  // per task: sum of |error|, sum of error^2, sum of SSIM
};

// Where a loss term's gradient by an image goes.
struct GradientSum {
    float* image;  // null: nowhere
    float weight;  // of the term
    bool add;      // to what is there; else it is overwritten
};

// A rendered surface, and where the gradient of a loss on its normals goes.
struct SurfaceArgs {
    const float *depth, *alpha;
    int width, height;
    float inv_fx, inv_fy, cx, cy;
    float covered;     // a pixel's depth is known where alpha is above this
    float scale;       // of the gradient: 1 / number of normals
    GradientSum grad;  // by depth
};

struct NormalArgs {
    SurfaceArgs surface;
    const float* target;  // planar unit normals (3, H, W)
    const bool* target_valid;
};

struct SmoothArgs {
    SurfaceArgs surface;
    const int* distances;
    int distance_count;
    int reach;  // the largest distance that is smaller than the height
};

struct GeoArgs {
    const float *depth, *alpha;  // alpha: null where the raw depth is compared, else depth / alpha is
    const float* target;
    const bool* mask;
    const float* edge_weight;            // null = 1
    GradientSum grad_depth, grad_alpha;  // grad_alpha is null where alpha is
    int width, height, stride;
    float per_pixel;  // 1 / number of pixels on the grid
};

struct AdamArgs {
    float *params, *first, *second;
    const float* grads;  // from the Gaussian `grads_first` on, like touched
    size_t stride, first_stride, second_stride, grads_stride;
    int count, planes;  // Gaussians that have moments: the first ones of the map
    int grads_first;
    const bool* touched;         // only these are updated; null = all
    const float* position_rate;  // per Gaussian factor on the rate of its position; null = 1
    const float* rates;          // of each plane
    float beta1, beta2, epsilon, correction1, correction2;
};

struct KernelTable {
    const char* name;
    void (*cull)(const CullArgs&, int chunk);
    void (*project)(const ProjectArgs&, int chunk);
    void (*raster_forward)(const RasterArgs&, int tile);
    void (*raster_backward)(const RasterBackwardArgs&, int tile);
    void (*raster_observe)(const ObserveArgs&, int tile);
    void (*project_backward)(const ProjectBackwardArgs&, int chunk);
    void (*photometric)(const PhotometricArgs&, int task, float* scratch);
    void (*target_statistics)(const float* target, float* mean, float* variance, int width, int height, float* scratch);
    void (*adam)(const AdamArgs&, int chunk);
    int64_t (*count_normals)(const SurfaceArgs&, const bool* target_valid, int task);
    double (*normal_loss)(const NormalArgs&, int task, float* scratch);
    double (*smooth_loss)(const SmoothArgs&, int task, float* scratch);
    double (*geo_loss)(const GeoArgs&, int task, float* scratch);
};

// floats of scratch that one photometric task needs
inline size_t photometric_scratch(int width) { return static_cast<size_t>(width + 32) * (11 * 6 + 3); }

// and that one task of a term on depth needs
inline size_t geo_scratch(int width) { return static_cast<size_t>(width + 16); }
inline size_t normal_scratch(int width) { return static_cast<size_t>(width + 16) * 4; }
inline size_t smooth_scratch(int width, int reach) { return static_cast<size_t>(width + 16) * 7 * (static_cast<size_t>(reach) + 2); }

extern const KernelTable kernels_baseline;
#if defined(BGS_HAVE_X86_KERNELS)
extern const KernelTable kernels_avx2, kernels_avx512;
#endif

}  // namespace bgs
