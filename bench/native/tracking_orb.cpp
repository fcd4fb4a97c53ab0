// ORB features of one image: pyramid, FAST corners in buckets, descriptors.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "engine.h"
#include "tracking.h"

namespace bgs {

namespace {

constexpr int BUCKET = 30;  // side in pixels of the keypoint's octave

// Where a parabola through the scores before, at and after a corner has its top, in steps from the corner.
double peak(const uint8_t* score, ptrdiff_t step) {
    const int before = score[-step], centre = score[0], after = score[step], curvature = before + after - 2 * centre;
    return curvature < 0 ? std::clamp(0.5 * (before - after) / curvature, -0.5, 0.5) : 0.0;
}

}  // namespace

const TrackingTable& tracking() {
#if defined(BGS_HAVE_X86_KERNELS)
    static const bool avx512 = std::strcmp(kernels().name, "avx512") == 0, avx2 = std::strcmp(kernels().name, "avx2") == 0;
    if (avx512) return tracking_avx512;
    if (avx2) return tracking_avx2;
#endif
    return tracking_baseline;
}

CellIndex::CellIndex(const std::vector<int32_t>& cell, int cells) : start(static_cast<size_t>(cells) + 1), order(cell.size()) {
    for (const int32_t c : cell) ++start[static_cast<size_t>(c) + 1];
    for (size_t c = 1; c < start.size(); ++c) start[c] += start[c - 1];
    std::vector<int32_t> next(start.begin(), start.end() - 1);
    for (size_t i = 0; i < cell.size(); ++i) order[static_cast<size_t>(next[static_cast<size_t>(cell[i])]++)] = static_cast<int32_t>(i);
}

std::vector<Corner> bucketed(const std::vector<Corner>& corners, int wanted, int bucket, int width, int height) {
    const int across = width / bucket + 1, down = height / bucket + 1;
    std::vector<int32_t> weakness(corners.size());
    for (size_t i = 0; i < corners.size(); ++i) weakness[i] = 255 - static_cast<int32_t>(corners[i].score);
    const CellIndex strongest(weakness, 256);
    std::vector<int32_t> taken(static_cast<size_t>(across) * static_cast<size_t>(down)), rank(corners.size());
    for (size_t i = 0; i < corners.size(); ++i) {
        const Corner& corner = corners[static_cast<size_t>(strongest.order[i])];
        rank[i] = taken[static_cast<size_t>(corner.y / bucket * across + corner.x / bucket)]++;
    }
    const int ranks = taken.empty() ? 0 : *std::max_element(taken.begin(), taken.end());
    const CellIndex by_rank(rank, std::max(ranks, 1));
    std::vector<Corner> kept(std::min(corners.size(), static_cast<size_t>(wanted)));
    for (size_t i = 0; i < kept.size(); ++i) kept[i] = corners[static_cast<size_t>(strongest.order[static_cast<size_t>(by_rank.order[i])])];
    return kept;
}

OrbExtractor::OrbExtractor(int features, int octaves, double scale_factor, int threshold, std::vector<float> tests)
    : scale_factor_(scale_factor), threshold_(threshold), tests_(std::move(tests)) {
    double total = 0.0;
    for (int o = 0; o < octaves; ++o) total += std::pow(scale_factor, -o);
    for (int o = 0; o < octaves; ++o) wanted_.push_back(static_cast<int>(std::lround(features * std::pow(scale_factor, -o) / total)));
}

OrbResult OrbExtractor::extract(const uint8_t* image, int width, int height) const {
    OrbResult out;
    std::vector<uint16_t> rows(2 * static_cast<size_t>(width));
    const GreyImage full{image, width, height, width};
    GreyImage level = full;
    for (int octave = 0; octave < static_cast<int>(wanted_.size()); ++octave) {
        if (octave > 0) {
            const double scale = std::pow(scale_factor_, octave);
            const int w = std::max(1, static_cast<int>(std::lround(width / scale))), h = std::max(1, static_cast<int>(std::lround(height / scale)));
            out.levels.push_back({std::unique_ptr<uint8_t[]>(new uint8_t[static_cast<size_t>(w) * static_cast<size_t>(h)]), w, h});
            uint8_t* pixels = out.levels.back().pixels.get();
            tracking().shrink(level, pixels, w, h, rows.data());
            level = GreyImage{pixels, w, h, w};
        }
        extract_octave(level, octave, full, out);
    }
    return out;
}

void OrbExtractor::extract_octave(const GreyImage& image, int octave, const GreyImage& full, OrbResult& out) const {
    const size_t pixels = static_cast<size_t>(image.width) * static_cast<size_t>(image.height);
    if (image.width < 2 * FAST_BORDER || image.height < 2 * FAST_BORDER) return;
    const std::unique_ptr<uint8_t[]> scores(new uint8_t[pixels]);
    std::vector<Corner> corners(pixels / 4 + 1);
    corners.resize(static_cast<size_t>(tracking().fast_corners(image, threshold_, scores.get(), corners.data())));
    corners = bucketed(corners, wanted_[static_cast<size_t>(octave)], BUCKET, image.width, image.height);
    if (corners.empty()) return;
    const double ratio_x = static_cast<double>(full.width) / image.width, ratio_y = static_cast<double>(full.height) / image.height;
    for (const Corner& corner : corners) {
        const uint8_t* score = scores.get() + static_cast<ptrdiff_t>(corner.y) * image.width + corner.x;
        out.xy.push_back((corner.x + peak(score, 1) + 0.5) * ratio_x - 0.5);
        out.xy.push_back((corner.y + peak(score, image.width) + 0.5) * ratio_y - 0.5);
    }
    const std::unique_ptr<uint8_t[]>& smooth = scores;  // the scores are done with
    std::vector<uint16_t> rows(7 * static_cast<size_t>(image.width));
    tracking().blur(image, smooth.get(), rows.data());
    const size_t before = out.octave.size();
    out.octave.resize(before + corners.size(), octave);
    out.descriptors.resize(4 * out.octave.size());
    tracking().describe(image, GreyImage{smooth.get(), image.width, image.height, image.width}, corners.data(), static_cast<int>(corners.size()), tests_.data(),
                        out.descriptors.data() + 4 * before);
}

}  // namespace bgs
