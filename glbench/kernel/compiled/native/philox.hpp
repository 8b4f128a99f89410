// Random numbers that are a function of an address: Philox4x32-10, several counters at once.
//
// Salmon, Moraes, Dror and Shaw (2011), "Parallel random numbers: as easy as 1, 2, 3", SC'11, doi 10.1145/2063384.2063405.
// Only whole numbers are multiplied and every conversion is exact: the bits are those of glbench/env/random.py everywhere.
#pragma once
#include "lanes.hpp"

namespace glb {

#if defined(__x86_64__) && defined(__AVX512F__)
using DrawLanes = Double8;
constexpr Long8 LANE_NUMBERS = {0, 1, 2, 3, 4, 5, 6, 7};
GLB_INLINE Long8 product32(Long8 a, Long8 b) { return reinterpret_cast<Long8>(_mm512_mul_epu32(reinterpret_cast<__m512i>(a), reinterpret_cast<__m512i>(b))); }
#elif defined(__x86_64__) && defined(__AVX2__)
using DrawLanes = Double4;
constexpr Long4 LANE_NUMBERS = {0, 1, 2, 3};
GLB_INLINE Long4 product32(Long4 a, Long4 b) { return reinterpret_cast<Long4>(_mm256_mul_epu32(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b))); }
#elif defined(__x86_64__)
using DrawLanes = Double2;
constexpr Long2 LANE_NUMBERS = {0, 1};
GLB_INLINE Long2 product32(Long2 a, Long2 b) { return reinterpret_cast<Long2>(_mm_mul_epu32(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b))); }
#else
using DrawLanes = double;
constexpr int64_t LANE_NUMBERS = 0;
GLB_INLINE int64_t product32(int64_t a, int64_t b) { return static_cast<int64_t>(static_cast<uint64_t>(a) * static_cast<uint64_t>(b)); }
#endif

using Words = IntOf<DrawLanes>;  // words of 32 bits, each in 64
constexpr int64_t WORD = INT64_C(0xffffffff);

GLB_INLINE Words words(int64_t a) { return Words{} + a; }
// The upper half of a product; the shift copies the sign, the mask takes it away again.
GLB_INLINE Words upper(Words a) { return (a >> 32) & WORD; }

// A number below 2^52 as a double.
GLB_INLINE DrawLanes as_double(Words a) {
    return from_bits<DrawLanes>(a | bits_of(broadcast<DrawLanes>(0x1p52))) - broadcast<DrawLanes>(0x1p52);
}
// 27 bits of one word and 26 of the next are a number in [0, 1) with 53 bits.
GLB_INLINE DrawLanes uniform(Words first, Words second) {
    const DrawLanes sum = as_double(first >> 5) * broadcast<DrawLanes>(67108864.0) + as_double(second >> 6);
    return sum * broadcast<DrawLanes>(0x1p-53);
}

constexpr int MOST_DRAWN = 256;                       // numbers a step, checked where programs are made
constexpr int DRAW_ROOM = MOST_DRAWN + 2 * 8;

// `count` numbers of one step of the stream of `key`: numbers 2b and 2b + 1 are those of the counter (step, b, 0, 0).
inline void draw(const uint64_t* key, int64_t step, int64_t count, double* numbers) {
    constexpr int W = width_of<DrawLanes>;
    const int64_t blocks = (count + 1) / 2;
    for (int64_t first = 0; first < blocks; first += W) {
        Words c0 = words(step & WORD), c1 = words(first), c2 = words(0), c3 = words(0);
        c1 += LANE_NUMBERS;
        uint32_t k0 = static_cast<uint32_t>(key[0]), k1 = static_cast<uint32_t>(key[1]);
        for (int round = 0; round < 10; ++round) {
            const Words left = product32(c0, words(0xD2511F53)), right = product32(c2, words(0xCD9E8D57));
            c0 = upper(right) ^ c1 ^ words(k0);
            c1 = right & WORD;
            c2 = upper(left) ^ c3 ^ words(k1);
            c3 = left & WORD;
            k0 += 0x9E3779B9u;
            k1 += 0xBB67AE85u;
        }
        const DrawLanes both[2] = {uniform(c0, c1), uniform(c2, c3)};
        const double* even = reinterpret_cast<const double*>(both);
        for (int lane = 0; lane < W; ++lane)
            numbers[2 * (first + lane)] = even[lane], numbers[2 * (first + lane) + 1] = even[W + lane];
    }
}

}  // namespace glb
