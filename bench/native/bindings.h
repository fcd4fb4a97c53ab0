// What the Python bindings share: typed arrays (on the CPU, contiguous unless said) and their checks.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <stdexcept>
#include <string>

namespace nb = nanobind;
using namespace nb::literals;

void bind_rasterizer(nb::module_& m);
void bind_losses(nb::module_& m);
void bind_adam(nb::module_& m);
void bind_tracking(nb::module_& m);
void bind_last_resort(nb::module_& m);

// (P, N) whose rows may lie farther apart than N floats: the front of a buffer with room to grow.
using Planes = nb::ndarray<float, nb::ndim<2>, nb::device::cpu>;
using Array2 = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Array3 = nb::ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Array1 = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<bool, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Counts = nb::ndarray<int, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Mask = nb::ndarray<bool, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::shape<4, 4>, nb::c_contig, nb::device::cpu>;

inline void require(bool ok, const char* what) {
    if (!ok) throw std::invalid_argument(what);
}

// Floats between two rows.
inline size_t stride_of(const Planes& a, const char* name) {
    const auto count = static_cast<int64_t>(a.shape(1));
    if (count == 0) return 0;
    if ((count > 1 && a.stride(1) != 1) || (a.shape(0) > 1 && a.stride(0) < count))
        throw std::invalid_argument(std::string(name) +
                                    ": each row must be contiguous and the rows must not overlap, as in buffer[:, :n]; a transpose needs .contiguous()");
    return static_cast<size_t>(a.stride(0));
}

inline void check_image(const Array3& a, int channels, int height, int width, const char* what) {
    require(static_cast<int>(a.shape(0)) == channels && static_cast<int>(a.shape(1)) == height && static_cast<int>(a.shape(2)) == width, what);
}

inline void check_map(const Array2& a, int height, int width, const char* what) {
    require(static_cast<int>(a.shape(0)) == height && static_cast<int>(a.shape(1)) == width, what);
}

inline void check_mask(const Mask& a, int height, int width, const char* what) {
    require(static_cast<int>(a.shape(0)) == height && static_cast<int>(a.shape(1)) == width, what);
}
