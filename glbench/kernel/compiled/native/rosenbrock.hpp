// One substep of a Rosenbrock method for all lanes at once.
//
// Written for W = I/(gamma h) - J as in Hairer & Wanner, Solving ODEs II, section IV.7 (eq. 7.25), for an autonomous system: the
// inputs are held within a control step.
//
// The model (`rhs`, `rhs_and_jacobian`, `factorise`, `solve`, sizes in namespace glb::model) is generated in front of this file.
#pragma once
#include "many.hpp"

namespace glb {

// G. Steinebach 2020, "Improvement of Rosenbrock-Wanner method RODASP", Progress in Differential-Algebraic Equations II, 165-184: six
// stages, order 4, stiffly accurate and L-stable, embedded order 3. What scores are made with, and derivatives.
struct Rodas4P2 {
    static constexpr double GAMMA = 0.25;
    static constexpr int STAGES = 6;
    static constexpr double STAGE[5][5] = {
        {3.0},
        {0.906377755268814, -0.189707390391685},
        {3.758617027739064, 1.161741776019525, -0.849258085312803},
        {7.089566927282776, 4.573591406461604, -8.423496976860259, -0.959280113459775},
        {7.089566927282776, 4.573591406461604, -8.423496976860259, -0.959280113459775, 1.0},
    };
    static constexpr double COUPLING[5][5] = {
        {-12.0, 0.0, 0.0, 0.0, 0.0},
        {-6.354581592719008, 0.338972550544623, 0.0, 0.0, 0.0},
        {-8.575016317114033, -7.606483992117508, 12.22499765012482, 0.0, 0.0},
        {-5.888975457523102, -8.157396617841821, 24.805546872612922, 12.790401512796979, 0.0},
        {-4.408651676063871, -6.692003137674639, 24.625568527593117, 16.627521966636085, -5.714285714285718},
    };
};

// GRK4T of P. Kaps and P. Rentrop 1979, Numerische Mathematik 33, 55-68, in the form of Hairer & Wanner's program ROS4: four stages, of
// which the last has the point of the third; order 4, A(89.3)-stable, embedded order 3. Smaller errors than Rodas4P2 at equal length, for
// two thirds of the work: what stays of stiff components (0.45 of them a substep, where Rodas4P2 leaves none) is small at these tolerances.
struct Grk4t {
    static constexpr double GAMMA = 0.231;
    static constexpr int STAGES = 4;
    static constexpr double STAGE[2][2] = {{2.0}, {4.524708207373116, 4.163528788597648}};
    static constexpr double COUPLING[3][3] = {
        {-5.071675338776316, 0.0, 0.0},
        {6.020152728650786, 0.1597506846727117, 0.0},
        {-1.856343618686113, -8.505380858179826, -2.084075136023187},
    };
    static constexpr double RESULT[4] = {3.957503746640777, 4.624892388363313, 0.6174772638750108, 1.282612945269037};
    static constexpr double ERROR[4] = {2.302155402932996, 3.073634485392623, -0.8732808018045032, -1.282612945269037};
};

constexpr int N = model::MOVING;
constexpr int PADDED = (N + 7) / 8 * 8;  // one lane works through its states in vectors
// Many lanes have their arrays close together: all of them barely fit into the first-level cache.
template <class V> constexpr int SPAN = width_of<V> == 1 ? PADDED : N;

// What one substep reads and writes; all arrays hold one value in each lane.
template <class V> struct alignas(64) Lanes {
    V x[SPAN<V>];                 // state at the start of the substep
    V weight[SPAN<V>];            // 1/(tolerance of the state)
    V stored[model::STORED];     // everything that depends on the inputs only
    V slope[SPAN<V>], y[SPAN<V>], coupled[SPAN<V>];
    V k[6][SPAN<V>];
    V factors[model::FACTORS];   // first the Jacobian, then its factors in the same places
    // One lane keeps what belongs to the start of the substep: after a rejected one the next begins from the same state.
    static constexpr bool KEEPS = width_of<V> == 1;
    V start_slope[KEEPS ? SPAN<V> : 1], jacobian[KEEPS ? model::FACTORS : 1];
};

// Whether stage S evaluates the right-hand side anew, or uses that of the stage before.
template <class M, int S> constexpr bool has_own_point = std::is_same_v<M, Rodas4P2> || S < Grk4t::STAGES - 1;

// Element-wise work on arrays of states: lanes are used as they are, one lane is read in vectors across the states.
template <class V> using Chunk = std::conditional_t<width_of<V> == 1, typename VectorOf<NATIVE_WIDTH>::type, V>;
template <class V> constexpr int CHUNKS = width_of<V> == 1 ? SPAN<V> / NATIVE_WIDTH : N;
template <class V> GLB_INLINE Chunk<V> load(const V* a, int i) {
    Chunk<V> r;
    std::memcpy(&r, a + i * (width_of<V> == 1 ? NATIVE_WIDTH : 1), sizeof r);
    return r;
}
template <class C, class V> GLB_INLINE C broadcast_lanes(V a) {
    if constexpr (width_of<V> == 1) return broadcast<C>(a);
    else return a;
}
template <class V> GLB_INLINE void store(V* a, int i, Chunk<V> value) {
    std::memcpy(a + i * (width_of<V> == 1 ? NATIVE_WIDTH : 1), &value, sizeof value);
}

// One pass over the increments serves both sums of a stage: the point, and what the earlier increments add to the slope.
template <class M, int S, class V, int... J>
GLB_INLINE void combine(Lanes<V>& w, V inverse_h, std::integer_sequence<int, J...>) {
    using C = Chunk<V>;
    const C coupling[S] = {broadcast_lanes<C>(broadcast<V>(M::COUPLING[S - 1][J]) * inverse_h)...};
    for (int i = 0; i < CHUNKS<V>; ++i) {
        const C k[S] = {load(w.k[J], i)...};
        if constexpr (has_own_point<M, S>) {
            C point;
            if constexpr (S <= 4) {
                point = load(w.x, i);
                ((point = fma<C>(broadcast<C>(M::STAGE[S - 1][J]), k[J], point)), ...);
            } else {
                point = load(w.y, i) + k[4];  // stiffly accurate: the last stage continues from the one before
            }
            store(w.y, i, point);
        }
        C sum = broadcast<C>(0.0);
        ((sum = fma<C>(coupling[J], k[J], sum)), ...);
        store(w.coupled, i, sum);
    }
}

// All stages but the first: the new increment k[S].
template <class M, class V, int S> GLB_INLINE void stage(Lanes<V>& w, V inverse_h) {
    combine<M, S>(w, inverse_h, std::make_integer_sequence<int, S>{});
    if constexpr (has_own_point<M, S>) model::rhs<V>(w.y, w.stored, w.slope);
    model::solve<true, V>(w.factors, w.slope, w.coupled, w.k[S]);
}

// From the increments to the result in w.y, the error estimate in k[5], and that in units of the tolerance in w.slope.
template <class V> GLB_INLINE void conclude(Lanes<V>& w, const Rodas4P2&) {
    for (int i = 0; i < CHUNKS<V>; ++i) {
        const Chunk<V> error = load(w.k[5], i);
        store(w.y, i, load(w.y, i) + error);
        store(w.slope, i, error * load(w.weight, i));
    }
}
template <class V> GLB_INLINE void conclude(Lanes<V>& w, const Grk4t&) {
    using C = Chunk<V>;
    for (int i = 0; i < CHUNKS<V>; ++i) {
        C y = load(w.x, i), error = broadcast<C>(0.0);
        for (int j = 0; j < Grk4t::STAGES; ++j) {
            const C k = load(w.k[j], i);
            y = fma<C>(broadcast<C>(Grk4t::RESULT[j]), k, y);
            error = fma<C>(broadcast<C>(Grk4t::ERROR[j]), k, error);
        }
        store(w.y, i, y);
        store(w.k[5], i, error);
        store(w.slope, i, error * load(w.weight, i));
    }
}

// Sums over the states of (error estimate/tolerance)^2, not a number when anything went wrong on the way. The first
// model::FAST states are summed apart, see `relaxation` in stepper.hpp.
template <class V> struct Error { V fast, slow; };

// Four sums at a time: a single one would be a chain of N dependent operations. `scaled` is error/tolerance.
template <class V, int... I> GLB_INLINE Error<V> squares(const V* scaled, std::integer_sequence<int, I...>) {
    V sum[2][4];
    for (int k = 0; k < 4; ++k) sum[0][k] = sum[1][k] = broadcast<V>(0.0);
    ((sum[I >= model::FAST][I % 4] = fma<V>(scaled[I], scaled[I], sum[I >= model::FAST][I % 4])), ...);
    return {(sum[0][0] + sum[0][1]) + (sum[0][2] + sum[0][3]), (sum[1][0] + sum[1][1]) + (sum[1][2] + sum[1][3])};
}

// Advances by h from w.x: the result is in w.y, k[5] is the error estimate. `again`: the substep before, from the same state,
// was rejected; with many lanes that saves nothing.
template <class M, class V> Error<V> substep(Lanes<V>& w, V h, bool again) {
    const V inverse_h = inv_of(h);
    V *slope = w.slope, *jacobian = w.factors;
    if constexpr (Lanes<V>::KEEPS) slope = w.start_slope, jacobian = w.jacobian;
    if (!Lanes<V>::KEEPS || !again) model::rhs_and_jacobian<V>(w.x, w.stored, slope, jacobian);
    model::factorise<V>(jacobian, broadcast<V>(1.0 / M::GAMMA) * inverse_h, broadcast<V>(M::GAMMA) * h, w.factors);
    model::solve<false, V>(w.factors, slope, slope, w.k[0]);
    stage<M, V, 1>(w, inverse_h);
    stage<M, V, 2>(w, inverse_h);
    stage<M, V, 3>(w, inverse_h);
    if constexpr (M::STAGES == 6) {
        stage<M, V, 4>(w, inverse_h);
        stage<M, V, 5>(w, inverse_h);
    }
    conclude(w, M{});
    return squares(w.slope, std::make_integer_sequence<int, N>{});
}

}  // namespace glb
