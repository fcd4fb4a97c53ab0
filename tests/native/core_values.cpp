// What the core computes of a small scene of its own, without Python, written to the standard output: for each array a line
// "NAME COUNT", then COUNT float64. The scene is made of whole numbers alone, so that it is the same on every processor
// (tools/core_on_aarch64.py compares them).
#include <cstdint>
#include <cstdio>
#include <initializer_list>
#include <memory>
#include <vector>

#include "losses.h"
#include "rasterizer.h"

namespace {

constexpr int WIDTH = 203, HEIGHT = 117, PIXELS = WIDTH * HEIGHT;  // no multiple of eight, of a tile or of a band
constexpr int COUNT = 5003, DEGREE = 3;                            // three chunks

uint64_t state = 1;

// Uniform on a grid of 2^-16 of what lies between the two; the ends here are such that nothing is rounded.
float between(float low, float high) {
    state = state * 6364136223846793005ull + 1442695040888963407ull;
    return low + (high - low) * (static_cast<float>(state >> 48) / 65536.0f);
}

std::vector<float> random_floats(size_t count, float low, float high) {
    std::vector<float> values(count);
    for (float& value : values) value = between(low, high);
    return values;
}

std::unique_ptr<bool[]> random_flags(size_t count, float share) {
    auto flags = std::make_unique<bool[]>(count);
    for (size_t k = 0; k < count; ++k) flags[k] = between(0, 1) < share;
    return flags;
}

template <typename T> void write(const char* name, const T* values, size_t count) {
    const std::vector<double> wide(values, values + count);
    std::printf("%s %zu\n", name, count);
    std::fwrite(wide.data(), sizeof(double), count, stdout);
}

void write(const char* name, std::initializer_list<double> values) { write(name, values.begin(), values.size()); }

std::vector<float> random_map() {
    const struct {
        int first, planes;
        float low, high;
    } parts[] = {{bgs::MEAN, 2, -6, 6},
                 {bgs::MEAN + 2, 1, -1, 20},
                 {bgs::LOG_SCALE, 3, -5, 0},
                 {bgs::QUATERNION, 4, -1, 1},
                 {bgs::OPACITY_LOGIT, 1, -3, 6},
                 {bgs::COLOR, 3, -1.5f, 1.5f},
                 {bgs::HARMONICS, bgs::planes_of(DEGREE) - bgs::HARMONICS, -0.25f, 0.25f}};
    std::vector<float> planes(static_cast<size_t>(bgs::planes_of(DEGREE)) * COUNT);
    for (const auto& part : parts)
        for (int k = part.first * COUNT; k < (part.first + part.planes) * COUNT; ++k) planes[static_cast<size_t>(k)] = between(part.low, part.high);
    return planes;
}

}  // namespace

int main() {
    bgs::set_threads(2);
    std::vector<float> planes = random_map(), color(3 * PIXELS), depth(PIXELS), alpha(PIXELS);
    const double T_cam_world[] = {0.96, 0, 0.28, 0.25, 0, 1, 0, -0.125, -0.28, 0, 0.96, 0.5, 0, 0, 0, 1};
    const bgs::View view = bgs::view_of(T_cam_world, 150, 152, 101.25f, 57.5f, WIDTH, HEIGHT);
    bgs::Workspace workspace;
    workspace.forward(planes.data(), COUNT, COUNT, DEGREE, view, color.data(), depth.data(), alpha.data());
    write("visible", {static_cast<double>(workspace.visible())});
    write("color", color.data(), color.size()), write("depth", depth.data(), PIXELS), write("alpha", alpha.data(), PIXELS);

    // The losses' gradients are those that go back through the rasterizer, as in mapping.
    std::vector<float> target = random_floats(3 * PIXELS, 0, 1), mean(3 * PIXELS), variance(3 * PIXELS), by_color(3 * PIXELS);
    bgs::target_statistics(target.data(), mean.data(), variance.data(), WIDTH, HEIGHT, 3);
    write("target mean", mean.data(), mean.size()), write("target variance", variance.data(), variance.size());
    bgs::PhotometricArgs photometric{};
    photometric.image = color.data(), photometric.target = target.data();
    photometric.target_mean = mean.data(), photometric.target_variance = variance.data(), photometric.grad = by_color.data();
    photometric.width = WIDTH, photometric.height = HEIGHT, photometric.channels = 3;
    photometric.weight_l1 = 0.5f, photometric.weight_l2 = 0.25f, photometric.weight_ssim = 0.25f;
    const bgs::PhotometricResult values = bgs::photometric(photometric);
    write("L1, L2, SSIM", {values.l1, values.l2, values.ssim});
    write("gradient by color", by_color.data(), by_color.size());

    std::vector<float> by_depth(PIXELS), by_alpha(PIXELS);
    const std::vector<float> true_depth = random_floats(PIXELS, 2, 20), edges = random_floats(PIXELS, 0, 1);
    std::vector<float> normals(3 * PIXELS);
    for (int k = 0; k < PIXELS; ++k) normals[static_cast<size_t>(k + (k % 3) * PIXELS)] = k % 2 == 0 ? 1.0f : -1.0f;
    const auto known = random_flags(PIXELS, 0.8f);
    bgs::GeoArgs geo{};
    geo.depth = depth.data(), geo.alpha = alpha.data(), geo.target = true_depth.data(), geo.mask = known.get(), geo.edge_weight = edges.data();
    geo.grad_depth = {by_depth.data(), 0.5f, false}, geo.grad_alpha = {by_alpha.data(), 0.5f, false};
    geo.width = WIDTH, geo.height = HEIGHT, geo.stride = 2;
    bgs::SurfaceArgs surface{};
    surface.depth = depth.data(), surface.alpha = alpha.data(), surface.grad = {by_depth.data(), 0.125f, true};
    surface.width = WIDTH, surface.height = HEIGHT, surface.covered = 0.5f;
    surface.inv_fx = 1 / 150.0f, surface.inv_fy = 1 / 152.0f, surface.cx = 101.25f, surface.cy = 57.5f;
    const int distances[] = {1, 4};
    const double geo_value = bgs::geo_loss(geo), normal_value = bgs::normal_loss({surface, normals.data(), known.get()});
    write("geo, normal, smooth", {geo_value, normal_value, bgs::smooth_loss({surface, distances, 2, 0})});
    write("gradient by depth", by_depth.data(), PIXELS), write("gradient by alpha", by_alpha.data(), PIXELS);

    std::vector<float> grads(planes.size());
    const auto touched = std::make_unique<bool[]>(COUNT);
    double pose[6];
    workspace.backward(planes.data(), COUNT, by_color.data(), by_depth.data(), by_alpha.data(), grads.data(), COUNT, COUNT, touched.get(), pose);
    for (int plane = 0; plane < bgs::planes_of(DEGREE); ++plane)
        for (int k = 0; k < COUNT; ++k)
            if (!touched[static_cast<size_t>(k)]) grads[static_cast<size_t>(plane) * COUNT + static_cast<size_t>(k)] = 0;
    write("gradient by Gaussians", grads.data(), grads.size()), write("gradient by pose", pose, 6);

    std::vector<float> first(planes.size()), second(planes.size());
    const std::vector<float> rates(static_cast<size_t>(bgs::planes_of(DEGREE)), 0.01f);
    bgs::AdamArgs adam{};
    adam.params = planes.data(), adam.first = first.data(), adam.second = second.data();
    adam.stride = adam.first_stride = adam.second_stride = COUNT;
    adam.count = COUNT, adam.planes = bgs::planes_of(DEGREE), adam.rates = rates.data();
    adam.beta1 = 0.875f, adam.beta2 = 0.9375f, adam.epsilon = 1e-8f, adam.correction1 = 8, adam.correction2 = 16;
    workspace.learn(planes.data(), COUNT, by_color.data(), by_depth.data(), by_alpha.data(), adam, nullptr);
    write("Gaussians after a step of Adam", planes.data(), planes.size());
    return 0;
}
