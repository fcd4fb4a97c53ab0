// Adam over the planes of a map: its Python binding, checked here once, and its run over chunks of Gaussians.
#include "bindings.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <optional>
#include <vector>

#include "engine.h"

namespace {

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
    const bgs::KernelTable& k = bgs::kernels();
    bgs::pool().run((args.count + bgs::CHUNK - 1) / bgs::CHUNK, [&](int chunk) { k.adam(args, chunk); });
}

}  // namespace

void bind_adam(nb::module_& m) {
    m.def("adam_step", &adam_step, "params"_a.noconvert(), "first"_a.noconvert(), "second"_a.noconvert(), "grads"_a.noconvert(),
          "position_rate"_a.noconvert().none(), "rates"_a, "beta1"_a, "beta2"_a, "epsilon"_a, "step"_a, "touched"_a.noconvert().none());
}
