// The Python module: the schema of a map, the threads, and the parts bound in files of their own.
#include "bindings.h"

#include <nanobind/stl/string.h>

#include <string>
#include <utility>

#if defined(__GLIBC__)
#include <malloc.h>
#endif

#include "engine.h"

namespace {

void bind_schema(nb::module_& m) {
    nb::dict planes, thresholds;
    for (const auto& [name, first] : {std::pair("mean", bgs::MEAN),
                                      {"log_scale", bgs::LOG_SCALE},
                                      {"quaternion", bgs::QUATERNION},
                                      {"opacity_logit", bgs::OPACITY_LOGIT},
                                      {"color", bgs::COLOR},
                                      {"harmonics", bgs::HARMONICS}})
        planes[name] = static_cast<int>(first);
    for (const auto& [name, value] : {std::pair("near_m", bgs::NEAR_M),
                                      {"low_pass_px2", bgs::LOW_PASS_PX2},
                                      {"alpha_min", bgs::ALPHA_MIN},
                                      {"alpha_max", bgs::ALPHA_MAX},
                                      {"transmittance_end", bgs::TRANSMITTANCE_END},
                                      {"jacobian_margin", bgs::JACOBIAN_MARGIN}})
        thresholds[name] = value;
    m.attr("FIRST_PLANE") = planes;
    m.attr("THRESHOLDS") = thresholds;
    m.attr("MAX_DEGREE") = bgs::MAX_DEGREE;
    m.attr("SH_C0") = bgs::SH_C0;
}

}  // namespace

NB_MODULE(_native, m) {
#if defined(__GLIBC__)
    // One heap for all threads: what one thread frees, another uses. With a heap for each a run holds a tenth more memory.
    mallopt(M_ARENA_MAX, 1);
#endif
    m.doc() = "The C++ core: the CPU rasterizer, loss terms and Adam of mapping, and the kernels of tracking; the end of a hung process.";
    m.def("instruction_set", [] { return std::string(bgs::kernels().name); }, "Which build of the kernels runs on this machine.");
    m.def("threads", [] { return bgs::pool().threads(); });
    m.def("set_threads", [](int threads) {
        require(threads >= 1 && threads <= 1024, "threads must be between 1 and 1024");
        bgs::set_threads(threads);
    });
    bind_schema(m);
    bind_rasterizer(m);
    bind_losses(m);
    bind_adam(m);
    bind_tracking(m);
    bind_last_resort(m);
}
