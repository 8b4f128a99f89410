// Derivatives of one accepted Rosenbrock substep, forward for many directions and in reverse for one cotangent.
//
// With its length h held, a substep is a linear system a stage, W k_i = f(Y_i) + sum_j c_ij/h k_j, W = I/(gamma h) - J(x), and
// sums of their solutions. Differentiated along (dx, dc), c being what was computed once a step from the inputs:
//
//     W dk_i = J(Y_i) dY_i + F(Y_i) dc + sum_j c_ij/h dk_j + J'(x)[k_i] dx + F'(x)[k_i] dc,    F = df/dc
//
// where J'(x)[k] and F'(x)[k] are the derivatives of J and F along k: second derivatives are symmetric. All these matrices are
// computed for all stages at once, a stage in each lane; what remains is sparse linear algebra.
#pragma once
#include "stepper.hpp"

namespace glb {

constexpr int STAGES = Rodas4P2::STAGES;  // at most

// Coefficient of increment j in the point of stage i: Y_i = x + sum_j a_ij k_j.
template <class M> constexpr double point_coefficient(int i, int j) {
    if constexpr (std::is_same_v<M, Rodas4P2>) return j < i ? M::STAGE[i - 1][j] : 0.0;
    const int own = i < M::STAGES - 1 ? i : M::STAGES - 2;  // the last stage has the point of the one before
    return j < own ? M::STAGE[own - 1][j] : 0.0;
}

// An accepted substep: its length, its start and its increments.
struct Taken {
    double h;
    double x[N], k[STAGES][N];
};

// Factors of W, and matrices of the six stages; entry e of stage i is element e * lanes + i % lanes of group i / lanes.
template <class V> struct alignas(64) Matrices {
    static constexpr int LANES = width_of<V>, GROUPS = (STAGES + LANES - 1) / LANES;
    template <class M> static constexpr int groups() { return (M::STAGES + LANES - 1) / LANES; }
    V state[GROUPS][model::STATE_ENTRIES];  // J(Y_i)
    V input[GROUPS][model::INPUT_ENTRIES];  // F(Y_i) + F'(x)[k_i]
    V bend[GROUPS][model::BEND_ENTRIES];    // J'(x)[k_i]
    double factors[model::OWN_FACTORS];

    static const double* stage(const V* group, int entries, int i) {
        return reinterpret_cast<const double*>(group + (i / LANES) * entries) + i % LANES;
    }
    const double* state_of(int i) const { return stage(state[0], model::STATE_ENTRIES, i); }
    const double* input_of(int i) const { return stage(input[0], model::INPUT_ENTRIES, i); }
    const double* bend_of(int i) const { return stage(bend[0], model::BEND_ENTRIES, i); }
};

template <class V> GLB_INLINE void put(V& a, int lane, double value) { reinterpret_cast<double*>(&a)[lane] = value; }

// Coefficients of increment j in the points of a group's stages; lanes beyond the last stage repeat it.
template <class M, class V> V stage_coefficients(int group, int j) {
    V a = broadcast<V>(0.0);
    for (int lane = 0; lane < width_of<V>; ++lane) {
        const int wanted = group * width_of<V> + lane, i = wanted < M::STAGES ? wanted : M::STAGES - 1;
        put(a, lane, point_coefficient<M>(i, j));
    }
    return a;
}

// `stored` are the values of model::stored_inputs, the same in every lane.
template <class M, class V> void compute_matrices(const Taken& taken, const V* stored, Matrices<V>& matrices) {
    V point[N], start[N], direction[N];
    for (int n = 0; n < N; ++n) start[n] = broadcast<V>(taken.x[n]);
    for (int g = 0; g < Matrices<V>::template groups<M>(); ++g) {
        V a[M::STAGES - 1];
        for (int j = 0; j < M::STAGES - 1; ++j) a[j] = stage_coefficients<M, V>(g, j);
        for (int n = 0; n < N; ++n) {
            point[n] = start[n];
            for (int j = 0; j < M::STAGES - 1; ++j) point[n] = fma<V>(a[j], broadcast<V>(taken.k[j][n]), point[n]);
            for (int lane = 0; lane < width_of<V>; ++lane) {
                const int i = g * width_of<V> + lane;
                put(direction[n], lane, taken.k[i < M::STAGES ? i : M::STAGES - 1][n]);
            }
        }
        model::derivatives<V>(point, stored, matrices.state[g], matrices.input[g]);
        model::curvature<V>(start, direction, stored, matrices.bend[g], matrices.input[g]);
    }
    model::own_factors<width_of<V>>(matrices.state_of(0), 1.0 / (M::GAMMA * taken.h), matrices.factors);
}

// Room for one value of each moving state; single values in whole vectors, so that loops over states use them.
template <class D> constexpr int ROOM = width_of<D> == 1 ? PADDED : N;
template <class D> using States = D[ROOM<D>];

// What dx and dc add to the right-hand sides of the first `Count` stages of a group, directions in lanes.
template <int Count, int W, class D, class V>
GLB_INLINE void add_products(const Matrices<V>& matrices, int group, const D* dc, const D* dx, States<D>* sum) {
    const int first = group * W;
    for (int i = 0; i < Count; ++i)
        for (int n = 0; n < N; ++n) sum[first + i][n] = broadcast<D>(0.0);
    model::add_bend_products<W, Count>(matrices.bend_of(first), dx, sum + first);
    if (dc != nullptr) model::add_input_products<W, Count>(matrices.input_of(first), dc, sum + first);
}

// What dx and dc add to the right-hand sides of all stages.
template <class M, class D, class V>
GLB_INLINE void add_start_and_inputs(const Matrices<V>& matrices, const D* dc, const D* dx, States<D>* sum) {
    constexpr int W = width_of<V>;
    if constexpr (width_of<D> == 1 && W > 1) {  // one direction: the stages in lanes
        for (int g = 0; g < Matrices<V>::template groups<M>(); ++g) {
            V sums[N];
            for (int n = 0; n < N; ++n) sums[n] = broadcast<V>(0.0);
            model::add_bend_product<1>(matrices.bend[g], dx, sums);
            if (dc != nullptr) model::add_input_product<1>(matrices.input[g], dc, sums);
            for (int lane = 0; lane < W && g * W + lane < M::STAGES; ++lane)
                for (int n = 0; n < N; ++n) sum[g * W + lane][n] = element(sums[n], lane);
        }
    } else {
        for (int g = 0; g < M::STAGES / W; ++g) add_products<W, W>(matrices, g, dc, dx, sum);
        if constexpr (M::STAGES % W != 0) add_products<M::STAGES % W, W>(matrices, M::STAGES / W, dc, dx, sum);
    }
}

// Stage S of the directions: dk[S] from those before it. `dy` is kept from stage to stage.
template <class M, int S, class D, class V, int... J>
GLB_INLINE void forward_stage(const Matrices<V>& matrices, double inverse_h, const D* dx, D* sum, D* dy, States<D>* dk,
                              std::integer_sequence<int, J...>) {
    for (int n = 0; n < ROOM<D>; ++n) {
        if constexpr (!has_own_point<M, S>) {
        } else if constexpr (S == STAGES - 1) {
            dy[n] = dy[n] + dk[S - 1][n];
        } else {
            D point = dx[n];
            ((point = fma<D>(broadcast<D>(M::STAGE[S - 1][J]), dk[J][n], point)), ...);
            dy[n] = point;
        }
        D total = sum[n];
        ((total = fma<D>(broadcast<D>(M::COUPLING[S - 1][J] * inverse_h), dk[J][n], total)), ...);
        sum[n] = total;
    }
    model::add_state_product<width_of<V>>(matrices.state_of(S), dy, sum);
    model::solve_directions<D>(matrices.factors, sum, dk[S]);
}

// All stages but the first.
template <class M, class D, class V, int... S>
GLB_INLINE void forward_stages(const Matrices<V>& matrices, double inverse_h, const D* dx, States<D>* sum, D* dy, States<D>* dk,
                               std::integer_sequence<int, S...>) {
    (forward_stage<M, S + 1, D>(matrices, inverse_h, dx, sum[S + 1], dy, dk, std::make_integer_sequence<int, S + 1>{}), ...);
}

// Directions in the lanes of D: dx of the substep's start becomes that of its end. `dc` may be null: inputs held.
template <class M, class D, class V>
void forward_substep(const Taken& taken, const Matrices<V>& matrices, const D* dc, D* dx) {
    const double inverse_h = 1.0 / taken.h;
    alignas(64) States<D> dk[M::STAGES] = {}, sum[M::STAGES] = {}, dy;
    add_start_and_inputs<M, D, V>(matrices, dc, dx, sum);
    model::add_state_product<width_of<V>>(matrices.state_of(0), dx, sum[0]);
    model::solve_directions<D>(matrices.factors, sum[0], dk[0]);
    forward_stages<M, D>(matrices, inverse_h, dx, sum, dy, dk, std::make_integer_sequence<int, M::STAGES - 1>{});
    if constexpr (std::is_same_v<M, Rodas4P2>) {
        for (int n = 0; n < ROOM<D>; ++n) dx[n] = dy[n] + dk[M::STAGES - 1][n];
    } else {
        for (int j = 0; j < M::STAGES; ++j)
            for (int n = 0; n < ROOM<D>; ++n) dx[n] = fma<D>(broadcast<D>(M::RESULT[j]), dk[j][n], dx[n]);
    }
}

// One cotangent: xb of the substep's end becomes that of its start; what the inputs get is added to cb, by stages.
template <class M, class V>
void reverse_substep(const Taken& taken, const Matrices<V>& matrices, double* xb, V (*cb)[model::INPUTS]) {
    constexpr int W = width_of<V>, G = Matrices<V>::template groups<M>(), LAST = M::STAGES - 1;
    constexpr bool STIFFLY_ACCURATE = std::is_same_v<M, Rodas4P2>;  // the result is the last point and the last increment
    const double inverse_h = 1.0 / taken.h;
    alignas(64) double kb[M::STAGES][PADDED] = {}, yb[PADDED], s[PADDED] = {}, start[PADDED] = {};
    V seeds[G][N];
    std::memset(static_cast<void*>(seeds), 0, sizeof seeds);
    if constexpr (STIFFLY_ACCURATE) {
        for (int n = 0; n < N; ++n) kb[LAST][n] = xb[n];
    } else {
        for (int n = 0; n < N; ++n) start[n] = xb[n];
        for (int j = 0; j < M::STAGES; ++j)
            for (int n = 0; n < N; ++n) kb[j][n] = M::RESULT[j] * xb[n];
    }
    for (int i = LAST; i >= 0; --i) {
        model::solve_transposed(matrices.factors, kb[i], s);
        for (int n = 0; n < PADDED; ++n) yb[n] = 0.0;
        for (int n = 0; n < N; ++n) {
            put(seeds[i / W][n], i % W, s[n]);
            if (STIFFLY_ACCURATE && i == LAST) yb[n] = xb[n];
        }
        model::add_state_transposed_product<W>(matrices.state_of(i), s, yb);
        for (int j = 0; j < i; ++j) {
            const double a = point_coefficient<M>(i, j), c = M::COUPLING[i - 1][j] * inverse_h;
            for (int n = 0; n < PADDED; ++n) kb[j][n] = __builtin_fma(a, yb[n], __builtin_fma(c, s[n], kb[j][n]));
        }
        for (int n = 0; n < PADDED; ++n) start[n] = start[n] + yb[n];
    }
    for (int g = 0; g < G; ++g) {
        V bent[N];
        for (int n = 0; n < N; ++n) bent[n] = broadcast<V>(0.0);
        model::add_bend_transposed_product<1>(matrices.bend[g], seeds[g], bent);
        model::add_input_transposed_product<1>(matrices.input[g], seeds[g], cb[g]);
        for (int lane = 0; lane < W && g * W + lane < M::STAGES; ++lane)
            for (int n = 0; n < N; ++n) start[n] = start[n] + element(bent[n], lane);
    }
    for (int n = 0; n < N; ++n) xb[n] = start[n];
}

}  // namespace glb
