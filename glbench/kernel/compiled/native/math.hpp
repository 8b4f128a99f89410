// exp, log, pow, tanh, cos for any number of lanes, from IEEE operations only: no call into libm, so no bit depends on it.
//
// Largest errors found against 50-digit arithmetic are asserted by tests/kernel_compiled/test_math.py. All polynomials are
// minimax fits (Remez exchange in 60 digits) rounded to double; even and odd parts are summed apart to shorten the chain.
#pragma once
#include "lanes.hpp"

namespace glb {

constexpr double LOG2_E = 0x1.71547652b82fep+0, LOG2_E_REST = 0x1.777d0ffda0d24p-56;
constexpr double LN_2 = 0x1.62e42fefa39efp-1, LN_2_REST = 0x1.abc9e3b39803fp-56;
constexpr double ROUNDER = 0x1.8p52;  // adding it leaves the nearest integer in the lowest bits
constexpr double SMALLEST_NORMAL = 0x1p-1022;

// 2^(n + r) for |r| <= 0.5 and `shifted` = n + ROUNDER; the polynomial is (2^r - 1)/r, relative error 3.4e-18.
template <class V> GLB_INLINE V power_of_two_minus_one(V r) {
    const V s = r * r;
    V even = broadcast<V>(0x1.e79d5237d65acp-32), odd = broadcast<V>(0x1.e61b39c22df4cp-28);
    even = fma(even, s, broadcast<V>(0x1.b5267b9bcb044p-24));
    odd = fma(odd, s, broadcast<V>(0x1.62bfc7ab417cbp-20));
    even = fma(even, s, broadcast<V>(0x1.ffcbfbaa3f2e7p-17));
    odd = fma(odd, s, broadcast<V>(0x1.4309130ed28b2p-13));
    even = fma(even, s, broadcast<V>(0x1.5d87fe78cd3a6p-10));
    odd = fma(odd, s, broadcast<V>(0x1.3b2ab6fba013ep-7));
    even = fma(even, s, broadcast<V>(0x1.c6b08d7049fe9p-5));
    odd = fma(odd, s, broadcast<V>(0x1.ebfbdff82c5a4p-3));
    even = fma(even, s, broadcast<V>(0x1.62e42fefa39efp-1));
    return r * fma(odd, r, even);
}
template <class V> GLB_INLINE V scale(V a, V shifted) {
    return from_bits<V>(bits_of(a) + (bits_of(shifted) << 52));
}

// e^x, error below 1 ulp. The argument is held in [-708, 709]: beyond, the result stays at 3.3e-308 or 8.2e307.
// Not a number gives not a number.
template <class V> GLB_INLINE V exp_of(V x) {
    x = max_of(broadcast<V>(-708.0), min_of(broadcast<V>(709.0), x));
    const V rounder = broadcast<V>(ROUNDER);
    const V shifted = x * broadcast<V>(LOG2_E) + rounder;
    const V n = shifted - rounder;
    const V r = fma(x, broadcast<V>(LOG2_E_REST), fms(x, broadcast<V>(LOG2_E), n));
    return scale(broadcast<V>(1.0) + power_of_two_minus_one(r), shifted);
}

// x = m 2^k with m in [sqrt(1/2), sqrt(2)), for positive normal x.
template <class V> struct Split { V m, k; };
template <class V> GLB_INLINE Split<V> split(V x) {
    constexpr int64_t half_root = INT64_C(0x3fe6a09e667f3bcd);  // sqrt(1/2)
    const IntOf<V> offset = bits_of(x) - half_root;
    const IntOf<V> exponent = offset >> 52;  // arithmetic shift: floor
    const V m = from_bits<V>(bits_of(x) - (exponent << 52));
    // The integer becomes a double through the low bits of ROUNDER: exact, and the same on every machine.
    const V k = from_bits<V>(exponent + bits_of(broadcast<V>(ROUNDER))) - broadcast<V>(ROUNDER);
    return {m, k};
}

// x^y for positive normal x, error below 1 ulp while |y| <= 1 (it grows with |y| beyond, about 0.3 |y| ulp).
// The integer part of log2(x) times y is kept exactly, so the error does not grow with log(x).
template <class V> GLB_INLINE V pow_of_positive(V x, V y) {
    const Split<V> a = split(x);
    const V one = broadcast<V>(1.0), rounder = broadcast<V>(ROUNDER);
    const V s = (a.m - one) / (a.m + one), z = s * s, w = z * z;
    V even = broadcast<V>(0x1.c42838a04c00ep-3), odd = broadcast<V>(0x1.b810a5cb4d7e0p-3);
    even = fma(even, w, broadcast<V>(0x1.484af2ce6b19ap-2));
    odd = fma(odd, w, broadcast<V>(0x1.0ca2e7413e3abp-2));
    even = fma(even, w, broadcast<V>(0x1.2776c50ecf73ap-1));
    odd = fma(odd, w, broadcast<V>(0x1.a61762f0cee87p-2));
    even = fma(even, w, broadcast<V>(0x1.71547652b82fep+1));
    odd = fma(odd, w, broadcast<V>(0x1.ec709dc3a0553p-1));
    const V log2_m = s * fma(odd, z, even);
    V whole = y * a.k;
    V rest = fma(y, log2_m, fms(y, a.k, whole));
    whole = max_of(broadcast<V>(-1021.0), min_of(broadcast<V>(1022.0), whole));
    const V shifted = (whole + rest) + rounder;
    const V r = (whole - (shifted - rounder)) + rest;
    return scale(one + power_of_two_minus_one(r), shifted);
}

// x^y as above; 0 for x below the smallest normal number (and positive y), not a number for negative x.
template <class V> GLB_INLINE V pow_of(V x, V y) {
    const V zero = broadcast<V>(0.0);
    const V other = select<V>(x < zero, broadcast<V>(__builtin_nan("")), zero);
    return select<V>(x >= broadcast<V>(SMALLEST_NORMAL), pow_of_positive(x, y), x == x ? other : x);
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

// Hyperbolic tangent, error below 3 ulp, from e^(2|x|) - 1 without cancellation.
template <class V> GLB_INLINE V tanh_of(V x) {
    const V one = broadcast<V>(1.0), rounder = broadcast<V>(ROUNDER);
    const V a = min_of(broadcast<V>(20.0), abs_of(x));  // not a number stays one; beyond 20 the result is 1
    const V twice = a + a;
    const V shifted = twice * broadcast<V>(LOG2_E) + rounder;
    const V n = shifted - rounder;
    const V r = fma(twice, broadcast<V>(LOG2_E_REST), fms(twice, broadcast<V>(LOG2_E), n));
    const V power = scale(one, shifted);
    const V less_one = fma(power, power_of_two_minus_one(r), power - one);
    const V t = less_one / (less_one + broadcast<V>(2.0));
    const IntOf<V> sign = bits_of(x) & INT64_MIN;
    return from_bits<V>(bits_of(t) | sign);
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
