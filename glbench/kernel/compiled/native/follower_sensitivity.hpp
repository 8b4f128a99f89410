// Derivatives of what `follow` does at the end of a step, forward for directions in lanes and in reverse for one cotangent.
#pragma once
#include "followers.hpp"

namespace glb {

// Where `follow` evaluated the rates.
struct FollowerPath {
    double h;
    double q[model::READS + 1], v[model::DRIVERS + 1], c[model::HELD_FOR_FOLLOWERS + 1], y[3][model::FOLLOWERS];

    // From the inputs and states of a step of `length`.
    void retrace(const double* p, const double* u, const double* d, const double* before, const double* after, double length) {
        h = length;
        read_inputs(p, u, d, q);
        mean_rates(before, [&](int n) { return after[model::MOVING_STATE[n]]; }, h, v);
        model::follower_held<double>(q, v, c);
        double slope[model::FOLLOWERS];
        for (int stage = 0; stage < 3; ++stage) {
            if (stage > 0) model::follower_slopes<double>(y[stage - 1], c, slope);
            for (int k = 0; k < model::FOLLOWERS; ++k)
                y[stage][k] = before[model::FOLLOWER_STATE[k]] + (stage > 0 ? h * FOLLOWER_POINT[stage] * slope[k] : 0.0);
        }
    }

    // Directions dx of the followers at the start become those at the end.
    template <class D> void forward(const D* dq, const D* dv, D* dx) const {
        D at_q[model::READS + 1], at_v[model::DRIVERS + 1], at_c[model::HELD_FOR_FOLLOWERS + 1], dc[model::HELD_FOR_FOLLOWERS + 1];
        D point[model::FOLLOWERS], along[model::FOLLOWERS], slope[model::FOLLOWERS], end[model::FOLLOWERS];
        for (int k = 0; k < model::READS; ++k) at_q[k] = broadcast<D>(q[k]);
        for (int k = 0; k < model::DRIVERS; ++k) at_v[k] = broadcast<D>(v[k]);
        for (int k = 0; k < model::HELD_FOR_FOLLOWERS; ++k) at_c[k] = broadcast<D>(c[k]);
        model::follower_held_forward<D>(at_q, at_v, dq, dv, dc);
        for (int k = 0; k < model::FOLLOWERS; ++k) end[k] = along[k] = dx[k];
        for (int stage = 0; stage < 3; ++stage) {
            for (int k = 0; k < model::FOLLOWERS; ++k) point[k] = broadcast<D>(y[stage][k]);
            model::follower_slopes_forward<D>(point, at_c, along, dc, slope);
            for (int k = 0; k < model::FOLLOWERS; ++k) {
                end[k] = fma<D>(broadcast<D>(h * FOLLOWER_WEIGHT[stage]), slope[k], end[k]);
                if (stage < 2) along[k] = fma<D>(broadcast<D>(h * FOLLOWER_POINT[stage + 1]), slope[k], dx[k]);
            }
        }
        for (int k = 0; k < model::FOLLOWERS; ++k) dx[k] = end[k];
    }

    // The cotangent xb of the followers at the end becomes that at the start; qb and vb are given.
    void reverse(double* xb, double* qb, double* vb) const {
        double cb[model::HELD_FOR_FOLLOWERS + 1] = {}, part[model::HELD_FOR_FOLLOWERS + 1];
        double seed[model::FOLLOWERS], yb[model::FOLLOWERS] = {}, start[model::FOLLOWERS];
        for (int k = 0; k < model::FOLLOWERS; ++k) start[k] = xb[k];
        for (int stage = 2; stage >= 0; --stage) {
            for (int k = 0; k < model::FOLLOWERS; ++k)
                seed[k] = h * FOLLOWER_WEIGHT[stage] * xb[k] + (stage < 2 ? h * FOLLOWER_POINT[stage + 1] * yb[k] : 0.0);
            model::follower_slopes_reverse<double>(y[stage], c, seed, yb, part);
            for (int k = 0; k < model::FOLLOWERS; ++k) start[k] = start[k] + yb[k];
            for (int k = 0; k < model::HELD_FOR_FOLLOWERS; ++k) cb[k] = cb[k] + part[k];
        }
        for (int k = 0; k < model::FOLLOWERS; ++k) xb[k] = start[k];
        model::follower_held_reverse<double>(q, v, cb, qb, vb);
    }
};

}  // namespace glb
