// Derivatives of one accepted Rosenbrock substep, forward for many directions and in reverse for one cotangent.
//
// With its length h held, a substep is six linear systems W k_i = f(Y_i) + sum_j c_ij/h k_j, W = I/(gamma h) - J(x), and sums of
// their solutions. Differentiated along (dx, dc), c being what was computed once a step from the inputs:
//
//     W dk_i = J(Y_i) dY_i + F(Y_i) dc + sum_j c_ij/h dk_j + J'(x)[k_i] dx + F'(x)[k_i] dc,    F = df/dc
//
// where J'(x)[k] and F'(x)[k] are the derivatives of J and F along k: second derivatives are symmetric. All these matrices are
// computed for the six stages at once, a stage in each lane; what remains is sparse linear algebra with the factors at hand.
#pragma once
#include "driver.hpp"

namespace glb {

constexpr int STAGES = 6;

// An accepted substep: its length, its start, its increments and the factors of W.
struct Taken {
    double h;
    alignas(64) double x[PADDED], k[STAGES][PADDED];
    double factors[model::FACTORS];
};

// Matrices of the six stages; entry e of stage i is element e * lanes + i % lanes of group i / lanes.
template <class V> struct alignas(64) Matrices {
    static constexpr int LANES = width_of<V>, GROUPS = (STAGES + LANES - 1) / LANES;
    V state[GROUPS][model::STATE_ENTRIES];  // J(Y_i)
    V input[GROUPS][model::INPUT_ENTRIES];  // F(Y_i) + F'(x)[k_i]
    V bend[GROUPS][model::BEND_ENTRIES];    // J'(x)[k_i]

    static const double* stage(const V* group, int entries, int i) {
        return reinterpret_cast<const double*>(group + (i / LANES) * entries) + i % LANES;
    }
    const double* state_of(int i) const { return stage(state[0], model::STATE_ENTRIES, i); }
    const double* input_of(int i) const { return stage(input[0], model::INPUT_ENTRIES, i); }
    const double* bend_of(int i) const { return stage(bend[0], model::BEND_ENTRIES, i); }
};

template <class V> GLB_INLINE void put(V& a, int lane, double value) { reinterpret_cast<double*>(&a)[lane] = value; }

// Points of the stages: Y_0 = x, Y_i = x + sum_j a_ij k_j, Y_5 = Y_4 + k_4.
inline void stage_points(const Taken& taken, double (&y)[STAGES][PADDED]) {
    for (int n = 0; n < PADDED; ++n) y[0][n] = taken.x[n];
    for (int i = 1; i < STAGES - 1; ++i)
        for (int n = 0; n < PADDED; ++n) {
            double point = taken.x[n];
            for (int j = 0; j < i; ++j) point = __builtin_fma(STAGE[i - 1][j], taken.k[j][n], point);
            y[i][n] = point;
        }
    for (int n = 0; n < PADDED; ++n) y[STAGES - 1][n] = y[STAGES - 2][n] + taken.k[STAGES - 2][n];
}

// `stored` are the values of model::stored_inputs, the same in every lane.
template <class V> void compute_matrices(const Taken& taken, const V* stored, Matrices<V>& matrices) {
    alignas(64) double y[STAGES][PADDED];
    stage_points(taken, y);
    V point[N], start[N], direction[N], bent[model::INPUT_ENTRIES];
    for (int n = 0; n < N; ++n) start[n] = broadcast<V>(taken.x[n]);
    for (int g = 0; g < Matrices<V>::GROUPS; ++g) {
        for (int lane = 0; lane < width_of<V>; ++lane) {
            const int wanted = g * width_of<V> + lane, i = wanted < STAGES ? wanted : STAGES - 1;
            for (int n = 0; n < N; ++n) put(point[n], lane, y[i][n]), put(direction[n], lane, taken.k[i][n]);
        }
        model::derivatives<V>(point, stored, matrices.state[g], matrices.input[g]);
        model::curvature<V>(start, direction, stored, matrices.bend[g], bent);
        for (int e = 0; e < model::INPUT_ENTRIES; ++e) matrices.input[g][e] = matrices.input[g][e] + bent[e];
    }
}

// Directions in the lanes of D: dx of the substep's start becomes that of its end. `dc` may be null: inputs held.
template <class D, class V> void forward_substep(const Taken& taken, const Matrices<V>& matrices, const D* dc, D* dx) {
    constexpr int W = width_of<V>;
    const double inverse_h = 1.0 / taken.h;
    D dk[STAGES][N], dy[N], sum[N];
    for (int i = 0; i < STAGES; ++i) {
        for (int n = 0; n < N; ++n) sum[n] = broadcast<D>(0.0);
        model::add_bend_product<W>(matrices.bend_of(i), dx, sum);
        if (dc != nullptr) model::add_input_product<W>(matrices.input_of(i), dc, sum);
        for (int n = 0; n < N; ++n) {
            D point = i == STAGES - 1 ? dy[n] + dk[STAGES - 2][n] : dx[n];
            for (int j = 0; j < i; ++j) {
                if (i < STAGES - 1) point = fma<D>(broadcast<D>(STAGE[i - 1][j]), dk[j][n], point);
                sum[n] = fma<D>(broadcast<D>(COUPLING[i - 1][j] * inverse_h), dk[j][n], sum[n]);
            }
            dy[n] = point;
        }
        model::add_state_product<W>(matrices.state_of(i), dy, sum);
        model::solve_directions<D>(taken.factors, sum, dk[i]);
    }
    for (int n = 0; n < N; ++n) dx[n] = dy[n] + dk[STAGES - 1][n];
}

// One cotangent: xb of the substep's end becomes that of its start; what the inputs get is added to cb, by stages.
template <class V>
void reverse_substep(const Taken& taken, const Matrices<V>& matrices, double* xb, V (*cb)[model::INPUTS]) {
    constexpr int W = width_of<V>, G = Matrices<V>::GROUPS;
    const double inverse_h = 1.0 / taken.h;
    double kb[STAGES][N], yb[N], s[N], start[N];
    V seeds[G][N];
    std::memset(static_cast<void*>(seeds), 0, sizeof seeds);
    std::memset(kb, 0, sizeof kb);
    for (int n = 0; n < N; ++n) kb[STAGES - 1][n] = xb[n], start[n] = 0.0;
    for (int i = STAGES - 1; i >= 0; --i) {
        model::solve_transposed<double>(taken.factors, kb[i], s);
        for (int n = 0; n < N; ++n) {
            put(seeds[i / W][n], i % W, s[n]);
            yb[n] = i == STAGES - 1 ? xb[n] : 0.0;
        }
        model::add_state_transposed_product<W>(matrices.state_of(i), s, yb);
        for (int j = 0; j < i; ++j) {
            const double a = STAGE[i - 1][j], c = COUPLING[i - 1][j] * inverse_h;
            for (int n = 0; n < N; ++n) kb[j][n] = __builtin_fma(a, yb[n], __builtin_fma(c, s[n], kb[j][n]));
        }
        for (int n = 0; n < N; ++n) start[n] = start[n] + yb[n];
    }
    for (int g = 0; g < G; ++g) {
        V bent[N];
        for (int n = 0; n < N; ++n) bent[n] = broadcast<V>(0.0);
        model::add_bend_transposed_product<1>(matrices.bend[g], seeds[g], bent);
        model::add_input_transposed_product<1>(matrices.input[g], seeds[g], cb[g]);
        for (int lane = 0; lane < W && g * W + lane < STAGES; ++lane)
            for (int n = 0; n < N; ++n) start[n] = start[n] + element(bent[n], lane);
    }
    for (int n = 0; n < N; ++n) xb[n] = start[n];
}

}  // namespace glb
