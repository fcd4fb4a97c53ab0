// The tracker's part of the core: feature extraction, matching and least squares behind typed arrays.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "tracking_kernels.h"

namespace bgs {

const TrackingTable& tracking();  // the build of the kernels that runs here

struct OrbLevel {
    std::unique_ptr<uint8_t[]> pixels;
    int width, height;
};

struct OrbResult {
    std::vector<double> xy;  // (N, 2), pixels of the full image
    std::vector<int64_t> octave;
    std::vector<uint64_t> descriptors;  // (N, 4)
    std::vector<OrbLevel> levels;       // octaves 1 and up; octave 0 is the image itself
};

// FAST-scored ORB, spread over the image by buckets. Holds only settings, so threads may share one.
class OrbExtractor {
public:
    OrbExtractor(int features, int octaves, double scale_factor, int threshold, std::vector<float> tests);
    OrbResult extract(const uint8_t* image, int width, int height) const;

private:
    void extract_octave(const GreyImage& image, int octave, const GreyImage& full, OrbResult& out) const;

    std::vector<int> wanted_;  // keypoints of each octave
    double scale_factor_;
    int threshold_;
    std::vector<float> tests_;  // (1024,): all ax, ay, bx, by
};

// The corners to keep: at most `wanted`, the strongest of every bucket first, then every second strongest, and so on.
std::vector<Corner> bucketed(const std::vector<Corner>& corners, int wanted, int bucket, int width, int height);

// Keypoints in order of a cell number: those of cell c are order[start[c] .. start[c + 1]], indices ascending.
struct CellIndex {
    std::vector<int32_t> start, order;
    CellIndex(const std::vector<int32_t>& cell, int cells);
};

}  // namespace bgs
