// Python bindings of the loss terms, checked here once.
#include "bindings.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <tuple>
#include <vector>

#include "losses.h"

namespace {

std::tuple<double, double, double> photometric(const Array3& image, const Array3& target, const Array3& mean, const Array3& variance, float weight_l1,
                                               float weight_l2, float weight_ssim, std::optional<Array3> grad) {
    const int channels = static_cast<int>(image.shape(0)), height = static_cast<int>(image.shape(1)), width = static_cast<int>(image.shape(2));
    for (const Array3* a : {&target, &mean, &variance}) check_image(*a, channels, height, width, "target, mean and variance must have the image's shape");
    if (grad) check_image(*grad, channels, height, width, "grad must have the image's shape");
    bgs::PhotometricArgs args{};
    args.image = image.data(), args.target = target.data(), args.target_mean = mean.data(), args.target_variance = variance.data();
    args.grad = grad ? grad->data() : nullptr;
    args.width = width, args.height = height, args.channels = channels;
    args.weight_l1 = weight_l1, args.weight_l2 = weight_l2, args.weight_ssim = weight_ssim;
    nb::gil_scoped_release release;
    const bgs::PhotometricResult result = bgs::photometric(args);
    return {result.l1, result.l2, result.ssim};
}

void target_statistics(const Array3& target, Array3& mean, Array3& variance) {
    const int channels = static_cast<int>(target.shape(0)), height = static_cast<int>(target.shape(1)), width = static_cast<int>(target.shape(2));
    for (const Array3* a : {&mean, &variance}) check_image(*a, channels, height, width, "mean and variance must have the target's shape");
    nb::gil_scoped_release release;
    bgs::target_statistics(target.data(), mean.data(), variance.data(), width, height, channels);
}

bgs::SurfaceArgs surface_of(const Array2& depth, const Array2& alpha, float covered, float fx, float fy, float cx, float cy, float weight, Array2& grad_depth,
                            bool add) {
    const int height = static_cast<int>(depth.shape(0)), width = static_cast<int>(depth.shape(1));
    check_map(alpha, height, width, "alpha must have the shape of depth");
    check_map(grad_depth, height, width, "grad_depth must have the shape of depth");
    require(fx > 0 && fy > 0, "focal lengths must be positive");
    bgs::SurfaceArgs s{};
    s.depth = depth.data(), s.alpha = alpha.data(), s.grad = {grad_depth.data(), weight, add};
    s.width = width, s.height = height, s.covered = covered;
    s.inv_fx = 1.0f / fx, s.inv_fy = 1.0f / fy, s.cx = cx, s.cy = cy;
    return s;
}

double normal_loss(const Array2& depth, const Array2& alpha, float covered, const Array3& target_normals, const Mask& target_valid, float fx, float fy,
                   float cx, float cy, float weight, Array2& grad_depth, bool add) {
    bgs::NormalArgs args{surface_of(depth, alpha, covered, fx, fy, cx, cy, weight, grad_depth, add), target_normals.data(), target_valid.data()};
    check_image(target_normals, 3, args.surface.height, args.surface.width, "target_normals must have shape (3, H, W) for a depth of shape (H, W)");
    check_mask(target_valid, args.surface.height, args.surface.width, "target_valid must have the shape of depth");
    nb::gil_scoped_release release;
    return bgs::normal_loss(args);
}

double smooth_loss(const Array2& depth, const Array2& alpha, float covered, const std::vector<int>& distances, float fx, float fy, float cx, float cy,
                   float weight, Array2& grad_depth, bool add) {
    for (const int distance : distances) require(distance >= 1, "distances must be at least 1");
    const bgs::SurfaceArgs surface = surface_of(depth, alpha, covered, fx, fy, cx, cy, weight, grad_depth, add);
    nb::gil_scoped_release release;
    return bgs::smooth_loss({surface, distances.data(), static_cast<int>(distances.size()), 0});
}

double geo_loss(const Array2& depth, const std::optional<Array2>& alpha, const Array2& target_depth, const Mask& depth_mask,
                const std::optional<Array2>& edge_weight, int stride, float weight, Array2& grad_depth, std::optional<Array2> grad_alpha, bool add) {
    const int height = static_cast<int>(depth.shape(0)), width = static_cast<int>(depth.shape(1));
    require(stride >= 1, "stride must be at least 1");
    require(alpha.has_value() == grad_alpha.has_value(), "give alpha and grad_alpha, or neither");
    check_map(target_depth, height, width, "target_depth must have the shape of depth");
    check_mask(depth_mask, height, width, "depth_mask must have the shape of depth");
    check_map(grad_depth, height, width, "grad_depth must have the shape of depth");
    if (alpha) check_map(*alpha, height, width, "alpha must have the shape of depth");
    if (grad_alpha) check_map(*grad_alpha, height, width, "grad_alpha must have the shape of depth");
    if (edge_weight) check_map(*edge_weight, height, width, "edge_weight must have the shape of depth");
    bgs::GeoArgs args{};
    args.depth = depth.data(), args.target = target_depth.data(), args.mask = depth_mask.data();
    args.alpha = alpha ? alpha->data() : nullptr, args.edge_weight = edge_weight ? edge_weight->data() : nullptr;
    args.grad_depth = {grad_depth.data(), weight, add}, args.grad_alpha = {grad_alpha ? grad_alpha->data() : nullptr, weight, add};
    args.width = width, args.height = height, args.stride = stride;
    nb::gil_scoped_release release;
    return bgs::geo_loss(args);
}

}  // namespace

void bind_losses(nb::module_& m) {
    m.def("photometric", &photometric, "image"_a.noconvert(), "target"_a.noconvert(), "mean"_a.noconvert(), "variance"_a.noconvert(), "weight_l1"_a,
          "weight_l2"_a, "weight_ssim"_a, "grad"_a.noconvert().none());
    m.def("target_statistics", &target_statistics, "target"_a.noconvert(), "mean"_a.noconvert(), "variance"_a.noconvert());
    m.def("normal_loss", &normal_loss, "depth"_a.noconvert(), "alpha"_a.noconvert(), "covered"_a, "target_normals"_a.noconvert(), "target_valid"_a.noconvert(),
          "fx"_a, "fy"_a, "cx"_a, "cy"_a, "weight"_a, "grad_depth"_a.noconvert(), "add"_a);
    m.def("smooth_loss", &smooth_loss, "depth"_a.noconvert(), "alpha"_a.noconvert(), "covered"_a, "distances"_a, "fx"_a, "fy"_a, "cx"_a, "cy"_a, "weight"_a,
          "grad_depth"_a.noconvert(), "add"_a);
    m.def("geo_loss", &geo_loss, "depth"_a.noconvert(), "alpha"_a.noconvert().none(), "target_depth"_a.noconvert(), "depth_mask"_a.noconvert(),
          "edge_weight"_a.noconvert().none(), "stride"_a, "weight"_a, "grad_depth"_a.noconvert(), "grad_alpha"_a.noconvert().none(), "add"_a);
}
