// Adam over the planes of a map: its Python binding, checked here once, and its run over chunks of Gaussians.
#include "adam.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <cmath>

#include "engine.h"

bgs::AdamArgs adam_args(Planes& params, Planes& first, Planes& second, const std::optional<Array1>& position_rate, const std::vector<float>& rates, float beta1,
                        float beta2, float epsilon, int step) {
    const size_t planes = params.shape(0), n = params.shape(1), learning = first.shape(1);
    require(first.shape(0) == planes && second.shape(0) == planes && second.shape(1) == learning && learning <= n,
            "first and second must have the same shape (P, M), M at most N, for params of shape (P, N)");
    require(rates.size() == planes, "rates must have one entry per plane");
    require(!position_rate || position_rate->shape(0) == learning, "position_rate must have shape (M,), one entry per column of first");
    bgs::AdamArgs args{};
    args.params = params.data(), args.first = first.data(), args.second = second.data();
    args.stride = stride_of(params, "params");
    args.first_stride = stride_of(first, "first"), args.second_stride = stride_of(second, "second");
    args.count = static_cast<int>(learning);
    args.position_rate = position_rate ? position_rate->data() : nullptr;
    args.rates = rates.data(), args.planes = static_cast<int>(planes);
    args.beta1 = beta1, args.beta2 = beta2, args.epsilon = epsilon;
    args.correction1 = static_cast<float>(1.0 / (1.0 - std::pow(static_cast<double>(beta1), step)));
    args.correction2 = static_cast<float>(1.0 / (1.0 - std::pow(static_cast<double>(beta2), step)));
    return args;
}

namespace {

void adam_step(Planes& params, Planes& first, Planes& second, const Planes& grads, const std::optional<Array1>& position_rate, const std::vector<float>& rates,
               float beta1, float beta2, float epsilon, int step, const std::optional<Flags>& touched) {
    bgs::AdamArgs args = adam_args(params, first, second, position_rate, rates, beta1, beta2, epsilon, step);
    const auto learning = static_cast<size_t>(args.count);
    require(grads.shape(0) == params.shape(0) && grads.shape(1) >= learning, "grads must have shape (P, M), or more columns");
    require(!touched || touched->shape(0) >= learning, "touched must have shape (M,), or more entries");
    args.grads = grads.data(), args.grads_stride = stride_of(grads, "grads");
    args.touched = touched ? touched->data() : nullptr;
    nb::gil_scoped_release release;
    const bgs::KernelTable& k = bgs::kernels();
    bgs::pool().run((args.count + bgs::CHUNK - 1) / bgs::CHUNK, [&](int chunk) { k.adam(args, chunk); });
}

}  // namespace

void bind_adam(nb::module_& m) {
    m.def("adam_step", &adam_step, "params"_a.noconvert(), "first"_a.noconvert(), "second"_a.noconvert(), "grads"_a.noconvert(),
          "position_rate"_a.noconvert().none(), "rates"_a, "beta1"_a, "beta2"_a, "epsilon"_a, "step"_a, "touched"_a.noconvert().none());
}
