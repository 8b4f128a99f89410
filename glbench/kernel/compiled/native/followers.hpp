// Followers: slow states that are held while the others move through a step, and follow at its end.
//
// Their rates read followers, inputs, and rates of moving states; for each of the latter its mean over the step, which the moving state
// gives exactly. What does not depend on followers is computed once, then one explicit step of order 3 goes over the whole of it
// (A. Ralston 1962, Math. Comp. 16, 431-437): follower_inputs and follower_rates are generated in front of this file.
#pragma once
#include "rosenbrock.hpp"
#include "rows.hpp"

namespace glb {

constexpr int HELD = model::DISTURBANCES + model::FOLLOWERS;
constexpr int FOLLOWER_ROOM = (model::FOLLOWERS + 7) / 8 * 8;
template <class V> using Followers = V[width_of<V> == 1 ? FOLLOWER_ROOM : model::FOLLOWERS];

// Disturbances and behind them the followers: what is held within a step.
inline void hold(const double* d, const double* x, double* held) {
    std::memcpy(held, d, model::DISTURBANCES * sizeof(double));
    for (int k = 0; k < model::FOLLOWERS; ++k) held[model::DISTURBANCES + k] = x[model::FOLLOWER_STATE[k]];
}

// The elements of d, p and u that the followers read.
template <class V> GLB_INLINE void read_inputs(const V* p, const V* u, const V* d, V* q) {
    for (int k = 0; model::READ_D[k] >= 0; ++k) *q++ = d[model::READ_D[k]];
    for (int k = 0; model::READ_P[k] >= 0; ++k) *q++ = p[model::READ_P[k]];
    for (int k = 0; model::READ_U[k] >= 0; ++k) *q++ = u[model::READ_U[k]];
}

// Mean rates of the drivers over a step, from the state before it; `after(n)` is moving state n after it.
template <class After> GLB_INLINE void mean_rates(const double* before, const After& after, double h, double* v) {
    for (int k = 0; k < model::DRIVERS; ++k) v[k] = (after(model::DRIVER[k]) - before[model::MOVING_STATE[model::DRIVER[k]]]) / h;
}

// Points 0, h/2 and 3h/4, and weights of their rates.
constexpr double FOLLOWER_POINT[3] = {0.0, 0.5, 0.75}, FOLLOWER_WEIGHT[3] = {2.0 / 9.0, 1.0 / 3.0, 4.0 / 9.0};

// Advances x by h, with the mean rates v of the drivers.
template <class V> void follow(const V* q, const V* v, double h, V* x) {
    using C = Chunk<V>;
    constexpr int CHUNKS = sizeof(Followers<V>) / sizeof(C);
    alignas(64) V s[model::STORED_FOR_FOLLOWERS + 1];
    alignas(64) Followers<V> slope = {}, point, end;
    model::follower_inputs<V>(q, v, s);
    std::memcpy(static_cast<void*>(point), x, sizeof point);
    std::memcpy(static_cast<void*>(end), x, sizeof end);
    for (int stage = 0; stage < 3; ++stage) {
        model::follower_rates<V>(point, s, slope);
        const C weight = broadcast<C>(h * FOLLOWER_WEIGHT[stage]), next = broadcast<C>(stage < 2 ? h * FOLLOWER_POINT[stage + 1] : 0.0);
        for (int i = 0; i < CHUNKS; ++i) {
            const C rate = load(slope, i);
            store(end, i, fma<C>(weight, rate, load(end, i)));
            if (stage < 2) store(point, i, fma<C>(next, rate, load(x, i)));
        }
    }
    std::memcpy(static_cast<void*>(x), end, sizeof end);
}

// Whether `count` numbers are finite.
inline bool all_finite(const double* a, int count) {
    using Pack = typename VectorOf<NATIVE_WIDTH>::type;
    Pack rest = broadcast<Pack>(0.0);
    double sum = 0.0;
    int i = 0;
    for (; i + NATIVE_WIDTH <= count; i += NATIVE_WIDTH) {
        Pack values;
        std::memcpy(&values, a + i, sizeof values);
        rest = rest + (values - values);
    }
    for (; i < count; ++i) sum = sum + (a[i] - a[i]);
    for (int k = 0; k < NATIVE_WIDTH; ++k) sum = sum + rest[k];
    return sum == 0.0;
}

// Rows that have finished but for their followers.
template <class V> struct Finished {
    static constexpr int W = width_of<V>;
    int count = 0;
    int64_t row[W];
    int32_t taken[W];
    double after[W][model::STATES];
    V q[model::READS + 1], v[model::DRIVERS + 1];
    alignas(64) Followers<V> x = {};

    // The next row, whose `after` has its moving states.
    void add(const double* before, const double* reads, double h) {
        const double* end = after[count];
        double mean[model::DRIVERS + 1];
        mean_rates(before, [&](int n) { return end[model::MOVING_STATE[n]]; }, h, mean);
        const int last = count == 0 ? W : count + 1;  // the first one fills the other lanes, too: something usual is to be there
        for (int lane = count; lane < last; ++lane) {
            for (int k = 0; k < model::READS; ++k) set_element(q[k], lane, reads[k]);
            for (int k = 0; k < model::DRIVERS; ++k) set_element(v[k], lane, mean[k]);
            for (int k = 0; k < model::FOLLOWERS; ++k) set_element(x[k], lane, before[model::FOLLOWER_STATE[k]]);
        }
        ++count;
    }

    void follow(double h) {
        glb::follow<V>(q, v, h, x);
        for (int k = 0; k < model::FOLLOWERS; ++k)
            for (int lane = 0; lane < count; ++lane) after[lane][model::FOLLOWER_STATE[k]] = element(x[k], lane);
    }

    // The state of a row that is not finite, or NO_STATE.
    int problem(int lane) const {
        if (!all_finite(after[lane], model::STATES))
            for (int k = 0; k < model::FOLLOWERS; ++k)
                if (!all_finite(after[lane] + model::FOLLOWER_STATE[k], 1)) return model::FOLLOWER_STATE[k];
        return NO_STATE;
    }
};

}  // namespace glb
