// Python bindings of the rasterizer, checked here once.
#include "adam.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <vector>

#include "rasterizer.h"

namespace {

bgs::View view_of(const Matrix& T_cam_world, float fx, float fy, float cx, float cy, int width, int height) {
    require(width > 0 && height > 0 && width <= 32000 && height <= 32000, "image size must be between 1 and 32000 px");
    require(fx > 0 && fy > 0, "focal lengths must be positive");
    return bgs::view_of(T_cam_world.data(), fx, fy, cx, cy, width, height);
}

int degree_of(const Planes& planes) {
    for (int degree = 0; degree <= bgs::MAX_DEGREE; ++degree)
        if (static_cast<int>(planes.shape(0)) == bgs::planes_of(degree)) return degree;
    throw std::invalid_argument("planes must have shape (14, N), (23, N), (38, N) or (59, N)");
}

void forward(bgs::Workspace& ws, const Planes& planes, const Matrix& T_cam_world, float fx, float fy, float cx, float cy, Array3& color, Array2& depth,
             Array2& alpha) {
    const int degree = degree_of(planes);
    const int height = static_cast<int>(depth.shape(0)), width = static_cast<int>(depth.shape(1));
    check_image(color, 3, height, width, "color must have shape (3, H, W) for a depth of shape (H, W)");
    check_map(alpha, height, width, "alpha must have the shape of depth");
    const bgs::View view = view_of(T_cam_world, fx, fy, cx, cy, width, height);
    const int count = static_cast<int>(planes.shape(1));
    const size_t stride = stride_of(planes, "planes");
    nb::gil_scoped_release release;
    ws.forward(planes.data(), stride, count, degree, view, color.data(), depth.data(), alpha.data());
}

void observe(bgs::Workspace& ws, const Planes& planes, const Matrix& T_cam_world, float fx, float fy, float cx, float cy, Counts& pixels,
             Array2& median_depth) {
    const int degree = degree_of(planes), count = static_cast<int>(planes.shape(1));
    require(pixels.shape(0) == planes.shape(1), "pixels must have shape (N,)");
    const bgs::View view = view_of(T_cam_world, fx, fy, cx, cy, static_cast<int>(median_depth.shape(1)), static_cast<int>(median_depth.shape(0)));
    const size_t stride = stride_of(planes, "planes");
    nb::gil_scoped_release release;
    ws.observe(planes.data(), stride, count, degree, view, pixels.data(), median_depth.data());
}

// Gradients of a loss by the three images, each null for zero.
struct ByImages {
    const float *color, *depth, *alpha;
    ByImages(const bgs::Workspace& ws, const Planes& planes, const std::optional<Array3>& by_color, const std::optional<Array2>& by_depth,
             const std::optional<Array2>& by_alpha)
        : color(by_color ? by_color->data() : nullptr), depth(by_depth ? by_depth->data() : nullptr), alpha(by_alpha ? by_alpha->data() : nullptr) {
        require(static_cast<int>(planes.shape(0)) == bgs::planes_of(ws.degree()) && static_cast<int>(planes.shape(1)) == ws.count(),
                "planes are not those of the forward pass");
        if (by_color) check_image(*by_color, 3, ws.height(), ws.width(), "grad_color must have shape (3, H, W)");
        if (by_depth) check_map(*by_depth, ws.height(), ws.width(), "grad_depth must have shape (H, W)");
        if (by_alpha) check_map(*by_alpha, ws.height(), ws.width(), "grad_alpha must have shape (H, W)");
    }
};

std::vector<double> backward(bgs::Workspace& ws, const Planes& planes, const std::optional<Array3>& grad_color, const std::optional<Array2>& grad_depth,
                             const std::optional<Array2>& grad_alpha, Planes& grads, Flags& touched, bool pose) {
    const ByImages by(ws, planes, grad_color, grad_depth, grad_alpha);
    const size_t learning = grads.shape(1);
    require(grads.shape(0) == planes.shape(0) && learning <= planes.shape(1), "grads must have shape (P, M), M at most N");
    require(!pose || learning == planes.shape(1), "the gradient by the pose needs those of all Gaussians: grads must have shape (P, N)");
    require(touched.shape(0) == learning, "touched must have shape (M,), one entry per column of grads");
    std::vector<double> twist(pose ? 6 : 0);
    const size_t stride = stride_of(planes, "planes"), grads_stride = stride_of(grads, "grads");
    nb::gil_scoped_release release;
    ws.backward(planes.data(), stride, by.color, by.depth, by.alpha, grads.data(), grads_stride, static_cast<int>(learning), touched.data(),
                pose ? twist.data() : nullptr);
    return twist;
}

std::vector<double> learn(bgs::Workspace& ws, const Planes& planes, const std::optional<Array3>& grad_color, const std::optional<Array2>& grad_depth,
                          const std::optional<Array2>& grad_alpha, Planes& params, Planes& first, Planes& second, const std::optional<Array1>& position_rate,
                          const std::vector<float>& rates, float beta1, float beta2, float epsilon, int step, bool pose) {
    const ByImages by(ws, planes, grad_color, grad_depth, grad_alpha);
    const bgs::AdamArgs adam = adam_args(params, first, second, position_rate, rates, beta1, beta2, epsilon, step);
    require(params.data() == planes.data() && params.shape(0) == planes.shape(0) && adam.count <= ws.count(), "params must be the first Gaussians of planes");
    std::vector<double> twist(pose ? 6 : 0);
    const size_t stride = stride_of(planes, "planes");
    nb::gil_scoped_release release;
    ws.learn(planes.data(), stride, by.color, by.depth, by.alpha, adam, pose ? twist.data() : nullptr);
    return twist;
}

}  // namespace

void bind_rasterizer(nb::module_& m) {
    nb::class_<bgs::Workspace>(m, "Workspace")
        .def(nb::init<>())
        .def("forward", &forward, "planes"_a.noconvert(), "T_cam_world"_a, "fx"_a, "fy"_a, "cx"_a, "cy"_a, "color"_a.noconvert(), "depth"_a.noconvert(),
             "alpha"_a.noconvert())
        .def("observe", &observe, "planes"_a.noconvert(), "T_cam_world"_a, "fx"_a, "fy"_a, "cx"_a, "cy"_a, "pixels"_a.noconvert(), "median_depth"_a.noconvert())
        .def("backward", &backward, "planes"_a.noconvert(), "grad_color"_a.noconvert().none(), "grad_depth"_a.noconvert().none(),
             "grad_alpha"_a.noconvert().none(), "grads"_a.noconvert(), "touched"_a.noconvert(), "pose"_a)
        .def("learn", &learn, "planes"_a.noconvert(), "grad_color"_a.noconvert().none(), "grad_depth"_a.noconvert().none(), "grad_alpha"_a.noconvert().none(),
             "params"_a.noconvert(), "first"_a.noconvert(), "second"_a.noconvert(), "position_rate"_a.noconvert().none(), "rates"_a, "beta1"_a, "beta2"_a,
             "epsilon"_a, "step"_a, "pose"_a)
        .def_prop_ro("count", &bgs::Workspace::count)
        .def_prop_ro("visible", &bgs::Workspace::visible)
        .def_prop_ro("bytes", &bgs::Workspace::bytes);
}
