// Python bindings: typed arrays, checked here once.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>

#include "engine.h"

namespace nb = nanobind;
using namespace nb::literals;

void bind_tracking(nb::module_& m);  // tracking_bindings.cpp

namespace {

using Array2 = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Array3 = nb::ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Array1 = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<bool, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Mask = nb::ndarray<bool, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::shape<4, 4>, nb::c_contig, nb::device::cpu>;

void require(bool ok, const char* what) {
    if (!ok) throw std::invalid_argument(what);
}

void check_image(const Array3& a, int channels, int height, int width, const char* what) {
    require(static_cast<int>(a.shape(0)) == channels && static_cast<int>(a.shape(1)) == height && static_cast<int>(a.shape(2)) == width, what);
}

void check_map(const Array2& a, int height, int width, const char* what) {
    require(static_cast<int>(a.shape(0)) == height && static_cast<int>(a.shape(1)) == width, what);
}

bgs::View view_of(const Matrix& T_cam_world, float fx, float fy, float cx, float cy, int width, int height) {
    require(width > 0 && height > 0 && width <= 32000 && height <= 32000, "image size must be between 1 and 32000 px");
    require(fx > 0 && fy > 0, "focal lengths must be positive");
    bgs::View v{};
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) v.R[3 * r + c] = static_cast<float>(T_cam_world(r, c));
        v.t[r] = static_cast<float>(T_cam_world(r, 3));
    }
    v.fx = fx, v.fy = fy, v.cx = cx, v.cy = cy, v.width = width, v.height = height;
    // As in gsplat, where pixel centres are at .5.
    constexpr auto margin = static_cast<float>(bgs::JACOBIAN_MARGIN);
    const float margin_x = margin * static_cast<float>(width) / fx, margin_y = margin * static_cast<float>(height) / fy;
    v.x_over_z_min = -((cx + 0.5f) / fx + margin_x), v.x_over_z_max = (static_cast<float>(width) - cx - 0.5f) / fx + margin_x;
    v.y_over_z_min = -((cy + 0.5f) / fy + margin_y), v.y_over_z_max = (static_cast<float>(height) - cy - 0.5f) / fy + margin_y;
    return v;
}

void forward(bgs::Workspace& ws, const Array2& planes, const Matrix& T_cam_world, float fx, float fy, float cx, float cy, Array3& color,
             Array2& depth, Array2& alpha) {
    require(planes.shape(0) == bgs::planes_of(0), "planes must have shape (14, N)");
    const int height = static_cast<int>(depth.shape(0)), width = static_cast<int>(depth.shape(1));
    check_image(color, 3, height, width, "color must have shape (3, H, W) for a depth of shape (H, W)");
    check_map(alpha, height, width, "alpha must have the shape of depth");
    const bgs::View view = view_of(T_cam_world, fx, fy, cx, cy, width, height);
    const int count = static_cast<int>(planes.shape(1));
    nb::gil_scoped_release release;
    ws.forward(planes.data(), planes.shape(1), count, 0, view, color.data(), depth.data(), alpha.data());
}

std::vector<double> backward(bgs::Workspace& ws, const Array2& planes, const std::optional<Array3>& grad_color,
                             const std::optional<Array2>& grad_depth, const std::optional<Array2>& grad_alpha, Array2& grads, Flags& touched,
                             bool pose) {
    require(static_cast<int>(planes.shape(0)) == bgs::planes_of(ws.degree()) && static_cast<int>(planes.shape(1)) == ws.count(), "planes are not those of the forward pass");
    require(grads.shape(0) == planes.shape(0) && grads.shape(1) == planes.shape(1), "grads must have the shape of planes");
    require(touched.shape(0) == planes.shape(1), "touched must have shape (N,)");
    if (grad_color) check_image(*grad_color, 3, ws.height(), ws.width(), "grad_color must have shape (3, H, W)");
    if (grad_depth) check_map(*grad_depth, ws.height(), ws.width(), "grad_depth must have shape (H, W)");
    if (grad_alpha) check_map(*grad_alpha, ws.height(), ws.width(), "grad_alpha must have shape (H, W)");
    std::vector<double> twist(pose ? 6 : 0);
    nb::gil_scoped_release release;
    ws.backward(planes.data(), planes.shape(1), grad_color ? grad_color->data() : nullptr, grad_depth ? grad_depth->data() : nullptr,
                grad_alpha ? grad_alpha->data() : nullptr, grads.data(), grads.shape(1), touched.data(),
                pose ? twist.data() : nullptr);
    return twist;
}

std::pair<double, double> photometric(const Array3& image, const Array3& target, const Array3& mean, const Array3& variance, float weight_l1,
                                      float weight_ssim, std::optional<Array3> grad) {
    const int channels = static_cast<int>(image.shape(0)), height = static_cast<int>(image.shape(1)), width = static_cast<int>(image.shape(2));
    for (const Array3* a : {&target, &mean, &variance}) check_image(*a, channels, height, width, "target, mean and variance must have the image's shape");
    if (grad) check_image(*grad, channels, height, width, "grad must have the image's shape");
    bgs::PhotometricArgs args{};
    args.image = image.data(), args.target = target.data(), args.target_mean = mean.data(), args.target_variance = variance.data();
    args.grad = grad ? grad->data() : nullptr;
    args.width = width, args.height = height, args.channels = channels;
    args.weight_l1 = weight_l1, args.weight_ssim = weight_ssim;
    nb::gil_scoped_release release;
    const bgs::PhotometricResult result = bgs::photometric(args);
    return {result.l1, result.ssim};
}

void target_statistics(const Array3& target, Array3& mean, Array3& variance) {
    const int channels = static_cast<int>(target.shape(0)), height = static_cast<int>(target.shape(1)), width = static_cast<int>(target.shape(2));
    for (const Array3* a : {&mean, &variance}) check_image(*a, channels, height, width, "mean and variance must have the target's shape");
    nb::gil_scoped_release release;
    bgs::target_statistics(target.data(), mean.data(), variance.data(), width, height, channels);
}

void adam_step(Array2& params, Array2& first, Array2& second, const Array2& grads, std::optional<Array1> position_rate,
               const std::vector<float>& rates, float beta1, float beta2, float epsilon, int step,
               std::optional<Flags> touched) {
    const size_t planes = params.shape(0), n = params.shape(1);
    for (const Array2* a : {static_cast<const Array2*>(&params), static_cast<const Array2*>(&first), static_cast<const Array2*>(&second), &grads})
        require(a->shape(0) == planes && a->shape(1) == n, "params, first, second and grads must all have the same shape");
    require(rates.size() == planes, "rates must have one entry per plane");
    require(!position_rate || position_rate->shape(0) == n, "position_rate must have shape (N,)");
    require(!touched || touched->shape(0) == n, "touched must have shape (N,)");
    bgs::AdamArgs args{};
    args.params = params.data(), args.first = first.data(), args.second = second.data(), args.grads = grads.data();
    args.stride = n, args.grads_stride = n, args.count = static_cast<int>(n);
    args.touched = touched ? touched->data() : nullptr;
    args.position_rate = position_rate ? position_rate->data() : nullptr;
    args.rates = rates.data(), args.planes = static_cast<int>(planes);
    args.beta1 = beta1, args.beta2 = beta2, args.epsilon = epsilon;
    args.correction1 = static_cast<float>(1.0 / (1.0 - std::pow(static_cast<double>(beta1), step)));
    args.correction2 = static_cast<float>(1.0 / (1.0 - std::pow(static_cast<double>(beta2), step)));
    nb::gil_scoped_release release;
    bgs::adam(args);
}

void check_mask(const Mask& a, int height, int width, const char* what) {
    require(static_cast<int>(a.shape(0)) == height && static_cast<int>(a.shape(1)) == width, what);
}

bgs::SurfaceArgs surface_of(const Array2& depth, const Array2& alpha, float covered, float fx, float fy, float cx, float cy, Array2& grad_depth) {
    const int height = static_cast<int>(depth.shape(0)), width = static_cast<int>(depth.shape(1));
    check_map(alpha, height, width, "alpha must have the shape of depth");
    check_map(grad_depth, height, width, "grad_depth must have the shape of depth");
    require(fx > 0 && fy > 0, "focal lengths must be positive");
    bgs::SurfaceArgs s{};
    s.depth = depth.data(), s.alpha = alpha.data(), s.grad = grad_depth.data();
    s.width = width, s.height = height, s.covered = covered;
    s.inv_fx = 1.0f / fx, s.inv_fy = 1.0f / fy, s.cx = cx, s.cy = cy;
    return s;
}

double normal_loss(const Array2& depth, const Array2& alpha, float covered, const Array3& target_normals, const Mask& target_valid, float fx,
                   float fy, float cx, float cy, Array2& grad_depth) {
    bgs::NormalArgs args{surface_of(depth, alpha, covered, fx, fy, cx, cy, grad_depth), target_normals.data(), target_valid.data()};
    check_image(target_normals, 3, args.surface.height, args.surface.width, "target_normals must have shape (3, H, W) for a depth of shape (H, W)");
    check_mask(target_valid, args.surface.height, args.surface.width, "target_valid must have the shape of depth");
    nb::gil_scoped_release release;
    return bgs::normal_loss(args);
}

double smooth_loss(const Array2& depth, const Array2& alpha, float covered, const std::vector<int>& distances, float fx, float fy, float cx,
                   float cy, Array2& grad_depth) {
    for (const int distance : distances) require(distance >= 1, "distances must be at least 1");
    const bgs::SurfaceArgs surface = surface_of(depth, alpha, covered, fx, fy, cx, cy, grad_depth);
    nb::gil_scoped_release release;
    return bgs::smooth_loss({surface, distances.data(), static_cast<int>(distances.size()), 0});
}

double geo_loss(const Array2& depth, const std::optional<Array2>& alpha, const Array2& target_depth, const Mask& depth_mask,
                const std::optional<Array2>& edge_weight, int stride, Array2& grad_depth, std::optional<Array2> grad_alpha) {
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
    args.grad_depth = grad_depth.data(), args.grad_alpha = grad_alpha ? grad_alpha->data() : nullptr;
    args.width = width, args.height = height, args.stride = stride;
    nb::gil_scoped_release release;
    return bgs::geo_loss(args);
}

void bind_schema(nb::module_& m) {
    nb::dict planes, thresholds;
    for (const auto& [name, first] : {std::pair("mean", bgs::MEAN), {"log_scale", bgs::LOG_SCALE}, {"quaternion", bgs::QUATERNION}, {"opacity_logit", bgs::OPACITY_LOGIT},
                                      {"color", bgs::COLOR}, {"harmonics", bgs::HARMONICS}})
        planes[name] = static_cast<int>(first);
    for (const auto& [name, value] : {std::pair("near_m", bgs::NEAR_M), {"low_pass_px2", bgs::LOW_PASS_PX2}, {"alpha_min", bgs::ALPHA_MIN}, {"alpha_max", bgs::ALPHA_MAX},
                                      {"transmittance_end", bgs::TRANSMITTANCE_END}, {"jacobian_margin", bgs::JACOBIAN_MARGIN}})
        thresholds[name] = value;
    m.attr("FIRST_PLANE") = planes;
    m.attr("THRESHOLDS") = thresholds;
    m.attr("MAX_DEGREE") = bgs::MAX_DEGREE;
    m.attr("SH_C0") = bgs::SH_C0;
}

}  // namespace

NB_MODULE(_native, m) {
    m.doc() = "The C++ core of the CPU rasterizer. Use it through plugins/rasterizers/cpu.py.";
    m.def("instruction_set", [] { return std::string(bgs::kernels().name); }, "Which build of the kernels runs on this machine.");
    bind_schema(m);
    m.def("threads", [] { return bgs::pool().threads(); });
    m.def("set_threads", [](int threads) {
        require(threads >= 1 && threads <= 1024, "threads must be between 1 and 1024");
        bgs::set_threads(threads);
    });
    nb::class_<bgs::Workspace>(m, "Workspace")
        .def(nb::init<>())
        .def("forward", &forward, "planes"_a.noconvert(), "T_cam_world"_a, "fx"_a, "fy"_a, "cx"_a, "cy"_a, "color"_a.noconvert(),
             "depth"_a.noconvert(), "alpha"_a.noconvert())
        .def("backward", &backward, "planes"_a.noconvert(), "grad_color"_a.noconvert().none(), "grad_depth"_a.noconvert().none(),
             "grad_alpha"_a.noconvert().none(), "grads"_a.noconvert(), "touched"_a.noconvert(), "pose"_a)
        .def_prop_ro("count", &bgs::Workspace::count)
        .def_prop_ro("visible", &bgs::Workspace::visible)
        .def_prop_ro("bytes", &bgs::Workspace::bytes);
    m.def("photometric", &photometric, "image"_a.noconvert(), "target"_a.noconvert(), "mean"_a.noconvert(), "variance"_a.noconvert(),
          "weight_l1"_a, "weight_ssim"_a, "grad"_a.noconvert().none());
    m.def("target_statistics", &target_statistics, "target"_a.noconvert(), "mean"_a.noconvert(), "variance"_a.noconvert());
    m.def("adam_step", &adam_step, "params"_a.noconvert(), "first"_a.noconvert(), "second"_a.noconvert(), "grads"_a.noconvert(),
          "position_rate"_a.noconvert().none(), "rates"_a, "beta1"_a, "beta2"_a, "epsilon"_a, "step"_a, "touched"_a.noconvert().none());
    m.def("normal_loss", &normal_loss, "depth"_a.noconvert(), "alpha"_a.noconvert(), "covered"_a, "target_normals"_a.noconvert(),
          "target_valid"_a.noconvert(), "fx"_a, "fy"_a, "cx"_a, "cy"_a, "grad_depth"_a.noconvert());
    m.def("smooth_loss", &smooth_loss, "depth"_a.noconvert(), "alpha"_a.noconvert(), "covered"_a, "distances"_a, "fx"_a, "fy"_a, "cx"_a,
          "cy"_a, "grad_depth"_a.noconvert());
    m.def("geo_loss", &geo_loss, "depth"_a.noconvert(), "alpha"_a.noconvert().none(), "target_depth"_a.noconvert(), "depth_mask"_a.noconvert(),
          "edge_weight"_a.noconvert().none(), "stride"_a, "grad_depth"_a.noconvert(), "grad_alpha"_a.noconvert().none());
    bind_tracking(m);
}
