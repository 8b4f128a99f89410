// exp, log, pow, tanh, cos for any number of lanes, from IEEE operations only: no call into libm, so no bit depends on it.
//
// Largest errors found against 50-digit arithmetic are asserted by tests/kernel_compiled/test_math.py. All polynomials are
// minimax fits (Remez exchange in 60 digits) rounded to double, unless called Taylor.
#pragma once
#include "lanes.hpp"

namespace glb {

constexpr double SIXTEEN_LOG2_E = 0x1.71547652b82fep+4;
constexpr double LN_2 = 0x1.62e42fefa39efp-1, LN_2_REST = 0x1.abc9e3b39803fp-56;
constexpr double ROUNDER = 0x1.8p52;  // adding it leaves the nearest integer in the lowest bits
constexpr double SMALLEST_NORMAL = 0x1p-1022;

// 2^(j/16) for j = 0..15, as bits, less j << 48: adding the whole number of sixteenths << 48 then gives the power.
alignas(64) constexpr int64_t SIXTEENTHS[16] = {
    0x3ff0000000000000, 0x3fefb5586cf9890f, 0x3fef72b83c7d517b, 0x3fef387a6e756238,
    0x3fef06fe0a31b715, 0x3feedea64c123422, 0x3feebfdad5362a27, 0x3feeab07dd485429,
    0x3feea09e667f3bcd, 0x3feea11473eb0187, 0x3feeace5422aa0db, 0x3feec49182a3f090,
    0x3feee89f995ad3ad, 0x3fef199bdd85529c, 0x3fef5818dcfba487, 0x3fefa4afa2a490da};
// Reciprocals near the middle of [1 + j/16, 1 + (j + 1)/16), of few bits, and minus their binary logarithms.
alignas(64) constexpr double RECIPROCALS[16] = {
    0x1.f0p-1, 0x1.d4p-1, 0x1.bap-1, 0x1.a4p-1, 0x1.9p-1, 0x1.7ep-1, 0x1.6cp-1, 0x1.5cp-1,
    0x1.4ep-1, 0x1.42p-1, 0x1.36p-1, 0x1.2ap-1, 0x1.2p-1, 0x1.16p-1, 0x1.0cp-1, 0x1.04p-1};
alignas(64) constexpr double LOGARITHMS[16] = {
    0x1.77394c9d958d5p-5, 0x1.097e38ce60649p-3, 0x1.b2602497d5346p-3, 0x1.249cd2b13cd6cp-2,
    0x1.6cb0f6865c8eap-2, 0x1.b0b67f4f46810p-2, 0x1.f804ae8d0cd02p-2, 0x1.1d368296b5255p-1,
    0x1.3b8b1c68fa6edp-1, 0x1.5692101d9b4a6p-1, 0x1.729fd26b707c8p-1, 0x1.8fc924c89ac84p-1,
    0x1.a8ff971810a5ep-1, 0x1.c31a27dd00b4ap-1, 0x1.de298ec0bac0dp-1, 0x1.f48c34bd1e96fp-1};

// table[index modulo 16] in each lane.
template <class V, class T> GLB_INLINE V lookup(const T (&table)[16], IntOf<V> index) {
    const double* values = reinterpret_cast<const double*>(table);
    if constexpr (width_of<V> == 1) return values[index & 15];
    else {
#if defined(__x86_64__) && defined(__AVX512F__)
        if constexpr (width_of<V> == 8)
            return _mm512_permutex2var_pd(_mm512_load_pd(values), reinterpret_cast<__m512i>(index), _mm512_load_pd(values + 8));
#endif
        V r{};
        for (int i = 0; i < width_of<V>; ++i) r[i] = values[index[i] & 15];
        return r;
    }
}

// 2^(n/16) 2^(r/16) for |r| <= 0.5 and `shifted` = n + ROUNDER. The polynomial is (2^(r/16) - 1)/r, error 7e-18.
template <class V> GLB_INLINE V power_of_two(V shifted, V r) {
    V p = broadcast<V>(0x1.430a992fc77d4p-37);
    p = fma(p, r, broadcast<V>(0x1.5d89bdfe6a276p-30));
    p = fma(p, r, broadcast<V>(0x1.3b2ab6fa982cep-23));
    p = fma(p, r, broadcast<V>(0x1.c6b08d6e8b0f8p-17));
    p = fma(p, r, broadcast<V>(0x1.ebfbdff82c59dp-11));
    p = fma(p, r, broadcast<V>(0x1.62e42fefa39fdp-5));
    const IntOf<V> count = bits_of(shifted);
    const V power = from_bits<V>(bits_of(lookup<V>(SIXTEENTHS, count)) + (count << 48));
    return fma<V>(power * r, p, power);
}

// 2^(t/16) for t <= 16384, error below 1.1 ulp; below -16000 the result stays at 2^-1000. Not a number gives not a number.
//
// This is how every exponential of the model is evaluated: the factor 16 log2(e) is part of the constants in its argument.
// Rounding t to an integer takes additions only, which have execution units of their own.
template <class V> GLB_INLINE V exp16_of_limited(V t) {
    t = max_of(broadcast<V>(-16000.0), t);
    const V rounder = broadcast<V>(ROUNDER);
    const V shifted = t + rounder;
    return power_of_two(shifted, t - (shifted - rounder));
}

// The same for any t: beyond 16368 the result stays at 2^1023.
template <class V> GLB_INLINE V exp16_of(V t) { return exp16_of_limited(min_of(broadcast<V>(16368.0), t)); }

// e^x, an error of at most 1.6 + 1.2 |x| ulp: that of rounding the product.
template <class V> GLB_INLINE V exp_of(V x) { return exp16_of(x * broadcast<V>(SIXTEEN_LOG2_E)); }

// Binary logarithm of positive normal x, absolute error below 3e-17 plus half a unit in the last place of the result.
template <class V> GLB_INLINE V log2_of_positive(V x) {
    const IntOf<V> bits = bits_of(x);
    // Exponents become doubles through the low bits of ROUNDER: exact, and the same on every machine.
    const V k = from_bits<V>((bits >> 52) + bits_of(broadcast<V>(ROUNDER))) - broadcast<V>(ROUNDER + 1023.0);
    const V m = from_bits<V>((bits & INT64_C(0x000fffffffffffff)) | INT64_C(0x3ff0000000000000));
    const IntOf<V> interval = bits >> 48;
    const V f = fms(m, lookup<V>(RECIPROCALS, interval), broadcast<V>(1.0));
    V p = broadcast<V>(-0x1.72329949ab8f4p-3);  // log2(1 + f)/f
    p = fma(p, f, broadcast<V>(0x1.a6e2ebc875d58p-3));
    p = fma(p, f, broadcast<V>(-0x1.ec70631faa9bap-3));
    p = fma(p, f, broadcast<V>(0x1.2776b02313a27p-2));
    p = fma(p, f, broadcast<V>(-0x1.71547655db065p-2));
    p = fma(p, f, broadcast<V>(0x1.ec709dc534283p-2));
    p = fma(p, f, broadcast<V>(-0x1.71547652b821fp-1));
    p = fma(p, f, broadcast<V>(0x1.71547652b82dep+0));
    return fma(p, f, lookup<V>(LOGARITHMS, interval)) + k;
}

// x^(y/16) for positive normal x and y with |y| < 15: an error of at most 1.5 + 0.1 |log2(x) y| ulp: that of rounding log2(x) and the product.
template <class V> GLB_INLINE V pow16_of_root(V x, V y) {
    const V t = y * log2_of_positive(x), rounder = broadcast<V>(ROUNDER);
    const V shifted = t + rounder;
    return power_of_two(shifted, t - (shifted - rounder));
}

// x^y for positive normal x, the error as above. Powers stay between 2^-1000 and 2^1023.
template <class V> GLB_INLINE V pow_of_positive(V x, V y) { return exp16_of(broadcast<V>(16.0) * y * log2_of_positive(x)); }

// x^y as above; 0 for x below the smallest normal number (and positive y), not a number for negative x.
template <class V> GLB_INLINE V pow_of(V x, V y) {
    const V zero = broadcast<V>(0.0);
    const V other = select<V>(x < zero, broadcast<V>(__builtin_nan("")), zero);
    return select<V>(x >= broadcast<V>(SMALLEST_NORMAL), pow_of_positive(x, y), x == x ? other : x);
}

// x = m 2^k with m in [sqrt(1/2), sqrt(2)), for positive normal x.
template <class V> struct Split { V m, k; };
template <class V> GLB_INLINE Split<V> split(V x) {
    constexpr int64_t half_root = INT64_C(0x3fe6a09e667f3bcd);  // sqrt(1/2)
    const IntOf<V> exponent = (bits_of(x) - half_root) >> 52;   // arithmetic shift: floor
    const V m = from_bits<V>(bits_of(x) - (exponent << 52));
    const V k = from_bits<V>(exponent + bits_of(broadcast<V>(ROUNDER))) - broadcast<V>(ROUNDER);
    return {m, k};
}

// Natural logarithm, error below 2 ulp; minus infinity below the smallest normal number, not a number for negative x.
template <class V> GLB_INLINE V log_of(V x) {
    const Split<V> a = split(x);
    const V one = broadcast<V>(1.0);
    const V s = (a.m - one) / (a.m + one), z = s * s;
    V p = broadcast<V>(0x1.0c09cf4475f33p-3);
    p = fma(p, z, broadcast<V>(0x1.0fbdf25e862c7p-3));
    p = fma(p, z, broadcast<V>(0x1.3b1c3bf7fdd25p-3));
    p = fma(p, z, broadcast<V>(0x1.745cf8e293768p-3));
    p = fma(p, z, broadcast<V>(0x1.c71c7201b2ad8p-3));
    p = fma(p, z, broadcast<V>(0x1.2492492476948p-2));
    p = fma(p, z, broadcast<V>(0x1.9999999999a39p-2));
    p = fma(p, z, broadcast<V>(0x1.5555555555555p-1));
    const V tail = fma(s * z, p, a.k * broadcast<V>(LN_2_REST));
    const V r = fma(a.k, broadcast<V>(LN_2), fma(broadcast<V>(2.0), s, tail));
    const V other = select<V>(x < broadcast<V>(0.0), broadcast<V>(__builtin_nan("")), broadcast<V>(-__builtin_inf()));
    return select<V>(x >= broadcast<V>(SMALLEST_NORMAL), r, select<V>(x == x, other, x));
}

// Hyperbolic tangent, error below 3 ulp: Taylor polynomial of (e^z - 1)/z near zero, e^z - 1 beyond.
template <class V> GLB_INLINE V tanh_of(V x) {
    const V one = broadcast<V>(1.0);
    const V a = min_of(broadcast<V>(20.0), abs_of(x));  // not a number stays one; beyond 20 the result is 1
    const V z = a + a;
    const V beyond = exp_of(z) - one;
    V p = broadcast<V>(0x1.6827863b97d97p-53);          // 1/18!
    p = fma(p, z, broadcast<V>(0x1.952c77030ad4ap-49));
    p = fma(p, z, broadcast<V>(0x1.ae7f3e733b81fp-45));
    p = fma(p, z, broadcast<V>(0x1.ae7f3e733b81fp-41));
    p = fma(p, z, broadcast<V>(0x1.93974a8c07c9dp-37));
    p = fma(p, z, broadcast<V>(0x1.6124613a86d09p-33));
    p = fma(p, z, broadcast<V>(0x1.1eed8eff8d898p-29));
    p = fma(p, z, broadcast<V>(0x1.ae64567f544e4p-26));
    p = fma(p, z, broadcast<V>(0x1.27e4fb7789f5cp-22));
    p = fma(p, z, broadcast<V>(0x1.71de3a556c734p-19));
    p = fma(p, z, broadcast<V>(0x1.a01a01a01a01ap-16));
    p = fma(p, z, broadcast<V>(0x1.a01a01a01a01ap-13));
    p = fma(p, z, broadcast<V>(0x1.6c16c16c16c17p-10));
    p = fma(p, z, broadcast<V>(0x1.1111111111111p-7));
    p = fma(p, z, broadcast<V>(0x1.5555555555555p-5));
    p = fma(p, z, broadcast<V>(0x1.5555555555555p-3));
    p = fma(p, z, broadcast<V>(0.5));
    const V near = fma(z * z, p, z);
    const V less_one = select<V>(z <= broadcast<V>(0.6931471805599453), near, beyond);
    const V t = less_one / (less_one + broadcast<V>(2.0));
    return from_bits<V>(bits_of(t) | (bits_of(x) & INT64_MIN));
}

// Cosine, absolute error below 2e-16 for |x| <= 1e5: reduced by multiples of pi/2 in three parts, Taylor polynomials.
template <class V> GLB_INLINE V cos_of(V x) {
    const V rounder = broadcast<V>(ROUNDER);
    const V shifted = x * broadcast<V>(0x1.45f306dc9c883p-1) + rounder;
    const V n = shifted - rounder;
    V r = fnma(n, broadcast<V>(0x1.921fb54442d18p+0), x);
    r = fnma(n, broadcast<V>(0x1.1a62633145c07p-54), r);
    const V z = r * r;
    V c = broadcast<V>(4.779477332387385e-14);                    // 1/16!
    c = fma(c, z, broadcast<V>(-1.1470745597729725e-11));         // 1/14!
    c = fma(c, z, broadcast<V>(2.08767569878681e-09));
    c = fma(c, z, broadcast<V>(-2.755731922398589e-07));
    c = fma(c, z, broadcast<V>(2.48015873015873e-05));
    c = fma(c, z, broadcast<V>(-0.001388888888888889));
    c = fma(c, z, broadcast<V>(0.041666666666666664));
    c = fma(c, z, broadcast<V>(-0.5));
    c = fma(c, z, broadcast<V>(1.0));
    V s = broadcast<V>(-7.647163731819816e-13);                   // 1/15!
    s = fma(s, z, broadcast<V>(1.605904383682161e-10));
    s = fma(s, z, broadcast<V>(-2.505210838544172e-08));
    s = fma(s, z, broadcast<V>(2.7557319223985893e-06));
    s = fma(s, z, broadcast<V>(-0.0001984126984126984));
    s = fma(s, z, broadcast<V>(0.008333333333333333));
    s = fma(s, z, broadcast<V>(-0.16666666666666666));
    s = fma(s * z, r, r);
    // cos(n pi/2 + r) = c, -s, -c, s for n = 0, 1, 2, 3 modulo 4.
    const IntOf<V> quarter = bits_of(shifted);
    const V value = select<V>((quarter & 1) != 0, s, c);
    const IntOf<V> flip = ((quarter + 1) & 2) << 62;
    return from_bits<V>(bits_of(value) ^ flip);
}

}  // namespace glb
