// Vectors of doubles, one environment in each lane, and the few operations the integrator is written in.
//
// A value type V is `double` (one lane) or a GCC/Clang vector of 2, 4 or 8 doubles. Every operation here is one IEEE 754
// operation in each lane, and multiplication is fused with addition only where the code says fma (the library is
// compiled with -ffp-contract=off). A lane therefore holds the same bits whatever the width, its neighbours, the compiler.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace glb {

typedef double Double2 __attribute__((vector_size(16)));
typedef double Double4 __attribute__((vector_size(32)));
typedef double Double8 __attribute__((vector_size(64)));
typedef int64_t Long2 __attribute__((vector_size(16)));
typedef int64_t Long4 __attribute__((vector_size(32)));
typedef int64_t Long8 __attribute__((vector_size(64)));

template <class V> struct LaneTraits;
template <> struct LaneTraits<double> { using Int = int64_t; using Mask = bool; static constexpr int width = 1; };
template <> struct LaneTraits<Double2> { using Int = Long2; using Mask = Long2; static constexpr int width = 2; };
template <> struct LaneTraits<Double4> { using Int = Long4; using Mask = Long4; static constexpr int width = 4; };
template <> struct LaneTraits<Double8> { using Int = Long8; using Mask = Long8; static constexpr int width = 8; };
template <class V> using IntOf = typename LaneTraits<V>::Int;
template <class V> using MaskOf = typename LaneTraits<V>::Mask;
template <class V> constexpr int width_of = LaneTraits<V>::width;

#define GLB_INLINE inline __attribute__((always_inline))

template <class V> GLB_INLINE V broadcast(double a) {
    if constexpr (width_of<V> == 1) return a;
    else return a - V{};  // a - (+0) is exactly a
}
template <class V> GLB_INLINE IntOf<V> bits_of(V a) {
    IntOf<V> b;
    std::memcpy(&b, &a, sizeof a);
    return b;
}
template <class V> GLB_INLINE V from_bits(IntOf<V> b) {
    V a;
    std::memcpy(&a, &b, sizeof a);
    return a;
}
template <class V> GLB_INLINE V select(MaskOf<V> condition, V yes, V no) { return condition ? yes : no; }
template <class V> GLB_INLINE MaskOf<V> all_false() {
    if constexpr (width_of<V> == 1) return false;
    else return MaskOf<V>{};
}
template <class V> GLB_INLINE bool lane_of(MaskOf<V> mask, int lane) {
    if constexpr (width_of<V> == 1) return mask;
    else return mask[lane] != 0;
}
template <class V> GLB_INLINE double element(const V& a, int lane) { return reinterpret_cast<const double*>(&a)[lane]; }
template <class V> GLB_INLINE void set_element(V& a, int lane, double value) { reinterpret_cast<double*>(&a)[lane] = value; }

// Fused multiply-add, square root, minimum and maximum. The portable form works lane by lane; the x86 forms are one instruction.
template <class V> struct Portable {
    static GLB_INLINE V fma(V a, V b, V c) {
        V r;
        for (int i = 0; i < width_of<V>; ++i) r[i] = __builtin_fma(a[i], b[i], c[i]);
        return r;
    }
    static GLB_INLINE V sqrt(V a) {
        V r;
        for (int i = 0; i < width_of<V>; ++i) r[i] = __builtin_sqrt(a[i]);
        return r;
    }
    static GLB_INLINE V min(V a, V b) { return a < b ? a : b; }
    static GLB_INLINE V max(V a, V b) { return a > b ? a : b; }
};
template <class V> struct Native : Portable<V> {};
template <> struct Native<double> {
    static GLB_INLINE double fma(double a, double b, double c) { return __builtin_fma(a, b, c); }
    static GLB_INLINE double sqrt(double a) { return __builtin_sqrt(a); }
    static GLB_INLINE double min(double a, double b) { return a < b ? a : b; }
    static GLB_INLINE double max(double a, double b) { return a > b ? a : b; }
};
#if defined(__x86_64__) && defined(__FMA__)
template <> struct Native<Double2> {
    static GLB_INLINE Double2 fma(Double2 a, Double2 b, Double2 c) { return _mm_fmadd_pd(a, b, c); }
    static GLB_INLINE Double2 sqrt(Double2 a) { return _mm_sqrt_pd(a); }
    static GLB_INLINE Double2 min(Double2 a, Double2 b) { return _mm_min_pd(a, b); }
    static GLB_INLINE Double2 max(Double2 a, Double2 b) { return _mm_max_pd(a, b); }
};
template <> struct Native<Double4> {
    static GLB_INLINE Double4 fma(Double4 a, Double4 b, Double4 c) { return _mm256_fmadd_pd(a, b, c); }
    static GLB_INLINE Double4 sqrt(Double4 a) { return _mm256_sqrt_pd(a); }
    static GLB_INLINE Double4 min(Double4 a, Double4 b) { return _mm256_min_pd(a, b); }
    static GLB_INLINE Double4 max(Double4 a, Double4 b) { return _mm256_max_pd(a, b); }
};
#endif
#if defined(__x86_64__) && defined(__AVX512F__)
template <> struct Native<Double8> {
    static GLB_INLINE Double8 fma(Double8 a, Double8 b, Double8 c) { return _mm512_fmadd_pd(a, b, c); }
    static GLB_INLINE Double8 sqrt(Double8 a) { return _mm512_sqrt_pd(a); }
    static GLB_INLINE Double8 min(Double8 a, Double8 b) { return _mm512_min_pd(a, b); }
    static GLB_INLINE Double8 max(Double8 a, Double8 b) { return _mm512_max_pd(a, b); }
};
#endif

template <class V> GLB_INLINE V fma(V a, V b, V c) { return Native<V>::fma(a, b, c); }
template <class V> GLB_INLINE V fms(V a, V b, V c) { return Native<V>::fma(a, b, -c); }    // a*b - c
template <class V> GLB_INLINE V fnma(V a, V b, V c) { return Native<V>::fma(-a, b, c); }   // c - a*b
template <class V> GLB_INLINE V sqrt_of(V a) { return Native<V>::sqrt(a); }
// As on x86: the second operand when either is not a number, or when they are equal.
template <class V> GLB_INLINE V min_of(V a, V b) { return Native<V>::min(a, b); }
template <class V> GLB_INLINE V max_of(V a, V b) { return Native<V>::max(a, b); }
template <class V> GLB_INLINE V inv_of(V a) { return broadcast<V>(1.0) / a; }
template <class V> GLB_INLINE V abs_of(V a) { return from_bits<V>(bits_of(a) & INT64_C(0x7fffffffffffffff)); }
template <class V> GLB_INLINE V sign_of(V a) {
    const V zero = broadcast<V>(0.0);
    return select<V>(a > zero, broadcast<V>(1.0), select<V>(a < zero, broadcast<V>(-1.0), a));
}

}  // namespace glb
