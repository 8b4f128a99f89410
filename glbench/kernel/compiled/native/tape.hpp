// Straight-line arithmetic as data: a tape of operations on registers, for one row or one row in each lane.
//
// What a task makes of a step (its accounts, reward, actuation) is not known when the library is built, and is too little
// work to be worth a compiler. Every operation is one IEEE 754 operation, except exp, log and powers, which are the C library's like
// everywhere outside the integrator; the bits are those of the same operations in NumPy, in the same order. A condition is 1 or 0.
#pragma once
#include <cmath>

#include "lanes.hpp"

namespace glb {

enum Operator : int32_t {
    ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATIVE, MAXIMUM, MINIMUM, SIGN, EXP, LOG, POWER, SQUARE_ROOT, MAGNITUDE, LESS, LESS_OR_EQUAL, EQUAL,
    NOT_EQUAL, NOT, AND, OR, IF_ELSE_ZERO
};

struct Operation { int32_t op, a, b; };              // the result of operation i is register constants + inputs + i
struct Slot { int32_t source, index; };              // where an input comes from
struct Sink { int32_t target, index, reg; };         // where a register goes to

struct Tape {
    int64_t constants, inputs, operations, outputs;
    const double* constant;      // registers 0 ... constants - 1
    const Slot* input;           // the registers after these
    const Operation* operation;  // the registers after those
    const Sink* output;
};

constexpr int MOST_REGISTERS = 1024;  // checked where tapes are made

// A function of the C library's, lane by lane.
template <class V, class F> GLB_INLINE V each_lane(V a, V b, F function) {
    if constexpr (width_of<V> == 1) return function(a, b);
    else {
        V r;
        for (int lane = 0; lane < width_of<V>; ++lane) r[lane] = function(a[lane], b[lane]);
        return r;
    }
}

// Not a number stays one, as in numpy.
template <class V> GLB_INLINE V maximum_of(V a, V b) { return select<V>((a > b) | (a != a), a, b); }
template <class V> GLB_INLINE V minimum_of(V a, V b) { return select<V>((a < b) | (a != a), a, b); }
template <class V> GLB_INLINE V signum_of(V a) {
    const V zero = broadcast<V>(0.0);
    const V other = select<V>(a == zero, zero, a);
    return select<V>(a > zero, broadcast<V>(1.0), select<V>(a < zero, broadcast<V>(-1.0), other));
}

// Puts the constants in place and runs the operations; the inputs must be there already.
template <class V> void evaluate(const Tape& tape, V* r) {
    for (int64_t i = 0; i < tape.constants; ++i) r[i] = broadcast<V>(tape.constant[i]);
    V* to = r + tape.constants + tape.inputs;
    const V zero = broadcast<V>(0.0), one = broadcast<V>(1.0);
    for (int64_t i = 0; i < tape.operations; ++i) {
        const Operation step = tape.operation[i];
        const V a = r[step.a], b = r[step.b];
        switch (step.op) {
            case ADD: to[i] = a + b; break;
            case SUBTRACT: to[i] = a - b; break;
            case MULTIPLY: to[i] = a * b; break;
            case DIVIDE: to[i] = a / b; break;
            case NEGATIVE: to[i] = -a; break;
            case MAXIMUM: to[i] = maximum_of(a, b); break;
            case MINIMUM: to[i] = minimum_of(a, b); break;
            case SIGN: to[i] = signum_of(a); break;
            case EXP: to[i] = each_lane(a, b, [](double x, double) { return std::exp(x); }); break;
            case LOG: to[i] = each_lane(a, b, [](double x, double) { return std::log(x); }); break;
            case POWER: to[i] = each_lane(a, b, [](double x, double y) { return std::pow(x, y); }); break;
            case SQUARE_ROOT: to[i] = sqrt_of(a); break;
            case MAGNITUDE: to[i] = abs_of(a); break;
            case LESS: to[i] = select<V>(a < b, one, zero); break;
            case LESS_OR_EQUAL: to[i] = select<V>(a <= b, one, zero); break;
            case EQUAL: to[i] = select<V>(a == b, one, zero); break;
            case NOT_EQUAL: to[i] = select<V>(a != b, one, zero); break;
            case NOT: to[i] = select<V>(a == zero, one, zero); break;
            case AND: to[i] = select<V>((a != zero) & (b != zero), one, zero); break;
            case OR: to[i] = select<V>((a != zero) | (b != zero), one, zero); break;
            case IF_ELSE_ZERO: to[i] = select<V>(a != zero, b, zero); break;
        }
    }
}

}  // namespace glb
