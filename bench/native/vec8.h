// Eight float lanes, written with the compiler's vector extensions: one source for SSE2, AVX2 and NEON.
//
// Everything here is in an anonymous namespace on purpose: the kernel file is compiled once for each instruction set,
// and no function may be merged across those object files by the linker.
#pragma once

#include <cstdint>
#include <cstring>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace {

typedef float f8 __attribute__((vector_size(32)));
typedef int32_t i8 __attribute__((vector_size(32)));

[[maybe_unused]] inline f8 load(const float* p) {
    f8 v;
    std::memcpy(&v, p, sizeof v);
    return v;
}

[[maybe_unused]] inline void store(float* p, f8 v) { std::memcpy(p, &v, sizeof v); }

// The first n lanes from memory, the others zero.
[[maybe_unused]] inline f8 load_part(const float* p, int n) {
    f8 v = {};
    std::memcpy(&v, p, sizeof(float) * static_cast<size_t>(n));
    return v;
}

[[maybe_unused]] inline void store_part(float* p, f8 v, int n) { std::memcpy(p, &v, sizeof(float) * static_cast<size_t>(n)); }

[[maybe_unused]] inline f8 splat(float x) { return f8{x, x, x, x, x, x, x, x}; }

[[maybe_unused]] inline f8 lanes() { return f8{0, 1, 2, 3, 4, 5, 6, 7}; }

[[maybe_unused]] inline f8 select(i8 mask, f8 a, f8 b) { return mask ? a : b; }

[[maybe_unused]] inline f8 min8(f8 a, f8 b) {
#if defined(__AVX2__)
    return reinterpret_cast<f8>(_mm256_min_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b)));
#else
    return a < b ? a : b;
#endif
}

[[maybe_unused]] inline f8 max8(f8 a, f8 b) {
#if defined(__AVX2__)
    return reinterpret_cast<f8>(_mm256_max_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b)));
#else
    return a > b ? a : b;
#endif
}

[[maybe_unused]] inline bool any(i8 mask) {
#if defined(__AVX2__)
    return _mm256_movemask_ps(reinterpret_cast<__m256>(mask)) != 0;
#else
    int64_t w[4];
    std::memcpy(w, &mask, sizeof w);
    return (w[0] | w[1] | w[2] | w[3]) != 0;
#endif
}

// The lanes of v where the mask is set, zero elsewhere, whatever v holds there.
[[maybe_unused]] inline f8 only(i8 mask, f8 v) { return reinterpret_cast<f8>(mask & reinterpret_cast<i8>(v)); }

// a b + c, rounded once where the machine can.
[[maybe_unused]] inline f8 multiply_add(f8 a, f8 b, f8 c) {
#if defined(__AVX2__)
    return reinterpret_cast<f8>(_mm256_fmadd_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b), reinterpret_cast<__m256>(c)));
#else
    return a * b + c;
#endif
}

[[maybe_unused]] inline f8 sqrt8(f8 x) {
#if defined(__AVX2__)
    return reinterpret_cast<f8>(_mm256_sqrt_ps(reinterpret_cast<__m256>(x)));
#else
    f8 r;
    for (int k = 0; k < 8; ++k) r[k] = __builtin_sqrtf(x[k]);
    return r;
#endif
}

[[maybe_unused]] inline float sum(f8 v) { return ((v[0] + v[4]) + (v[1] + v[5])) + ((v[2] + v[6]) + (v[3] + v[7])); }

// The sums of two vectors, each as sum() has it.
[[maybe_unused]] inline void store_sums(float* p, f8 a, f8 b) {
#if defined(__AVX2__)
    auto fold = [](f8 v) { return _mm_add_ps(_mm256_castps256_ps128(reinterpret_cast<__m256>(v)), _mm256_extractf128_ps(reinterpret_cast<__m256>(v), 1)); };
    const __m128 pairs = _mm_hadd_ps(fold(a), fold(b)), both = _mm_hadd_ps(pairs, pairs);
    std::memcpy(p, &both, 2 * sizeof(float));
#else
    p[0] = sum(a), p[1] = sum(b);
#endif
}

// Sums of eight vectors as one vector.
[[maybe_unused]] inline f8 sums(f8 a, f8 b, f8 c, f8 d, f8 e, f8 f, f8 g, f8 h) {
#if defined(__AVX2__)
    auto m = [](f8 v) { return reinterpret_cast<__m256>(v); };
    const __m256 abcd = _mm256_hadd_ps(_mm256_hadd_ps(m(a), m(b)), _mm256_hadd_ps(m(c), m(d)));
    const __m256 efgh = _mm256_hadd_ps(_mm256_hadd_ps(m(e), m(f)), _mm256_hadd_ps(m(g), m(h)));
    const __m256 low = _mm256_permute2f128_ps(abcd, efgh, 0x20), high = _mm256_permute2f128_ps(abcd, efgh, 0x31);
    return reinterpret_cast<f8>(_mm256_add_ps(low, high));
#else
    return f8{sum(a), sum(b), sum(c), sum(d), sum(e), sum(f), sum(g), sum(h)};
#endif
}

// 2^x of N vectors for x in -126 .. 127, relative error below 2e-7 in float32; outside, anything (also NaN), but no trap. All
// go side by side, an operation at a time: kernels_raster.inc says why.
template <int N> inline void exp2_in_range(const f8* x, f8* power) {
    const f8 magic = splat(12582912.0f);  // 1.5 * 2^23: adding it rounds to the nearest integer
    f8 shifted[N], f[N], middle[N], high[N];
    for (int k = 0; k < N; ++k) shifted[k] = x[k] + magic;
    for (int k = 0; k < N; ++k) f[k] = x[k] - (shifted[k] - magic);
    for (int k = 0; k < N; ++k) middle[k] = multiply_add(splat(5.55071346e-2f), f[k], splat(2.40221202e-1f));
    for (int k = 0; k < N; ++k) high[k] = multiply_add(splat(1.32764701e-3f), f[k], splat(9.67554096e-3f));
    for (int k = 0; k < N; ++k) power[k] = multiply_add(high[k], f[k] * f[k], middle[k]);
    // The last two steps as Horner has them: one rounding of the sum, half the error of a fully balanced tree.
    for (int k = 0; k < N; ++k) power[k] = multiply_add(power[k], f[k], splat(6.93146944e-1f));
    for (int k = 0; k < N; ++k) power[k] = multiply_add(power[k], f[k], splat(1.00000012f));
    for (int k = 0; k < N; ++k) power[k] = reinterpret_cast<f8>(reinterpret_cast<i8>(power[k]) + (reinterpret_cast<i8>(shifted[k]) << 23));
}

[[maybe_unused]] inline f8 exp2_in_range(f8 x) {
    f8 power;
    exp2_in_range<1>(&x, &power);
    return power;
}

// 2^x with x clamped to the range of normal numbers.
[[maybe_unused]] inline f8 exp2_8(f8 x) { return exp2_in_range(min8(max8(x, splat(-126.0f)), splat(126.0f))); }

[[maybe_unused]] inline f8 exp8(f8 x) { return exp2_8(x * splat(1.44269504f)); }

// log2 of positive normal numbers by the series of artanh, relative error about 1e-7.
[[maybe_unused]] inline f8 log2_8(f8 x) {
    const i8 bits = reinterpret_cast<i8>(x);
    i8 exponent = (bits >> 23) - 127;
    f8 m = reinterpret_cast<f8>((bits & 0x007fffff) | 0x3f800000);
    const i8 large = m > splat(1.41421356f);
    m = select(large, m * splat(0.5f), m);
    exponent -= large;  // a true lane is -1
    const f8 s = (m - splat(1.0f)) / (m + splat(1.0f)), s2 = s * s;
    f8 p = splat(1.0f / 9.0f);
    p = p * s2 + splat(1.0f / 7.0f);
    p = p * s2 + splat(1.0f / 5.0f);
    p = p * s2 + splat(1.0f / 3.0f);
    p = p * s2 + splat(1.0f);
    return __builtin_convertvector(exponent, f8) + s * p * splat(2.88539008f);
}

}  // namespace
