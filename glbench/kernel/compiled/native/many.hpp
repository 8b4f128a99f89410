// The same slow function of several independent values.
//
// With many lanes this is a sequence of calls. With one lane the values are packed into vectors, which takes about the
// time of a single call; the lanes do the same operations, so the results are the same bits.
#pragma once
#include <utility>

#include "math.hpp"

namespace glb {

template <class V, int N> struct Many { V v[N]; };

#if defined(__AVX512F__)
constexpr int NATIVE_WIDTH = 8;
#elif defined(__AVX__)
constexpr int NATIVE_WIDTH = 4;
#else
constexpr int NATIVE_WIDTH = 2;
#endif

template <int W> struct VectorOf;
template <> struct VectorOf<1> { using type = double; };
template <> struct VectorOf<2> { using type = Double2; };
template <> struct VectorOf<4> { using type = Double4; };
template <> struct VectorOf<8> { using type = Double8; };

// Width of the vector that holds `left` values without waste, at most the machine's.
constexpr int pack_width(int left) {
    const int wanted = left >= 5 ? 8 : left >= 3 ? 4 : left == 2 ? 2 : 1;
    return wanted < NATIVE_WIDTH ? wanted : NATIVE_WIDTH;
}

template <int Start, class P, int N, int... I>
GLB_INLINE P packed(const double (&a)[N], std::integer_sequence<int, I...>) {
    if constexpr (width_of<P> == 1) return a[Start];
    else return P{a[Start + I < N ? Start + I : N - 1]...};
}
template <int Start, class P, int N> GLB_INLINE void unpack(P value, double (&r)[N]) {
    if constexpr (width_of<P> == 1) r[Start] = value;
    else
        for (int i = 0; i < width_of<P> && Start + i < N; ++i) r[Start + i] = value[i];
}

#define GLB_MANY_OF_ONE(NAME, FUNCTION)                                                                        \
    template <int Start, int N> GLB_INLINE void NAME##_from(const double (&a)[N], double (&r)[N]) {            \
        if constexpr (Start < N) {                                                                             \
            using P = typename VectorOf<pack_width(N - Start)>::type;                                          \
            const P p = packed<Start, P>(a, std::make_integer_sequence<int, width_of<P>>{});                   \
            unpack<Start>(FUNCTION(p), r);                                                                     \
            NAME##_from<Start + width_of<P>>(a, r);                                                            \
        }                                                                                                      \
    }                                                                                                          \
    template <class V, class... A> GLB_INLINE Many<V, sizeof...(A)> NAME(A... a) {                             \
        if constexpr (width_of<V> > 1) return {{FUNCTION(V(a))...}};                                           \
        else {                                                                                                 \
            const double in[sizeof...(A)] = {a...};                                                            \
            Many<V, sizeof...(A)> out;                                                                         \
            NAME##_from<0>(in, out.v);                                                                         \
            return out;                                                                                        \
        }                                                                                                      \
    }
GLB_MANY_OF_ONE(many_exp, exp_of)
GLB_MANY_OF_ONE(many_exp16, exp16_of)
GLB_MANY_OF_ONE(many_exp16_limited, exp16_of_limited)
GLB_MANY_OF_ONE(many_log, log_of)
GLB_MANY_OF_ONE(many_inv, inv_of)
GLB_MANY_OF_ONE(many_sqrt, sqrt_of)
GLB_MANY_OF_ONE(many_tanh, tanh_of)
#undef GLB_MANY_OF_ONE

// Powers: the first half of the arguments are the bases, the second half the exponents.
#define GLB_MANY_OF_TWO(NAME, FUNCTION)                                                                        \
    template <int Start, int N> GLB_INLINE void NAME##_from(const double (&a)[N], const double (&b)[N], double (&r)[N]) { \
        if constexpr (Start < N) {                                                                             \
            using P = typename VectorOf<pack_width(N - Start)>::type;                                          \
            const P p = packed<Start, P>(a, std::make_integer_sequence<int, width_of<P>>{});                   \
            const P q = packed<Start, P>(b, std::make_integer_sequence<int, width_of<P>>{});                   \
            unpack<Start>(FUNCTION(p, q), r);                                                                  \
            NAME##_from<Start + width_of<P>>(a, b, r);                                                         \
        }                                                                                                      \
    }                                                                                                          \
    template <class V, class... A> GLB_INLINE Many<V, sizeof...(A) / 2> NAME(A... a) {                         \
        constexpr int n = sizeof...(A) / 2;                                                                    \
        const V in[2 * n] = {a...};                                                                            \
        Many<V, n> out;                                                                                        \
        if constexpr (width_of<V> > 1) {                                                                       \
            NAME##_each<V, n>(in, out, std::make_integer_sequence<int, n>{});                                  \
        } else {                                                                                               \
            double base[n], exponent[n];                                                                       \
            for (int i = 0; i < n; ++i) base[i] = in[i], exponent[i] = in[n + i];                              \
            NAME##_from<0>(base, exponent, out.v);                                                             \
        }                                                                                                      \
        return out;                                                                                            \
    }
template <class V, int N, int... I>
GLB_INLINE void many_pow_each(const V* in, Many<V, N>& out, std::integer_sequence<int, I...>) {
    ((out.v[I] = pow_of<V>(in[I], in[N + I])), ...);
}
template <class V, int N, int... I>
GLB_INLINE void many_pow_positive_each(const V* in, Many<V, N>& out, std::integer_sequence<int, I...>) {
    ((out.v[I] = pow_of_positive<V>(in[I], in[N + I])), ...);
}
template <class V, int N, int... I>
GLB_INLINE void many_pow16_root_each(const V* in, Many<V, N>& out, std::integer_sequence<int, I...>) {
    ((out.v[I] = pow16_of_root<V>(in[I], in[N + I])), ...);
}
GLB_MANY_OF_TWO(many_pow, pow_of)
GLB_MANY_OF_TWO(many_pow16_root, pow16_of_root)
GLB_MANY_OF_TWO(many_pow_positive, pow_of_positive)
#undef GLB_MANY_OF_TWO

template <class V> GLB_INLINE MaskOf<V> not_of(MaskOf<V> m) {
    if constexpr (width_of<V> == 1) return !m;
    else return ~m;
}

}  // namespace glb
