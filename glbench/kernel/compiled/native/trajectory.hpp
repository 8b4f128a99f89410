// Whole horizons: the reverse sweep through consecutive steps, and linearised dynamics over stored Jacobians, either way.
//
// A horizon goes through one thread, and sums are taken in an order that the number of states alone decides, so the bits depend
// neither on the batch nor on the lanes nor on the number of threads. Memory is what limits the sweeps over Jacobians: they stream.
#pragma once
#include "sensitivity_driver.hpp"

namespace glb {

// Horizons of linearised steps. A step's directions are those in its inputs, `moves` of them, then one for each state.
struct Sweep {
    int64_t horizons, steps, moves;
    const double* jacobians;  // (horizons, steps, moves + states, states): what each direction does to the states
    double* along;            // (horizons, steps, moves): changes of the inputs, or given back: gradients
    double* states;           // (horizons, steps + 1, states): changes of the states, or cotangents that become costates
};

using Four = Double4;
constexpr int FOURS = model::STATES / 4, REST = model::STATES % 4;

GLB_INLINE Four four(const double* a) {
    Four value;
    std::memcpy(&value, a, sizeof value);
    return value;
}

// `next` becomes the sum of the block's rows times `along`, then `x`.
template <int... I>
GLB_INLINE void push_step(const double* row, int64_t moves, const double* along, const double* x, double* next,
                          std::integer_sequence<int, I...>) {
    Four sum[FOURS + 1] = {};
    double rest[REST + 1] = {};
    const auto add = [&](double change) {
        const Four by = broadcast<Four>(change);
        ((sum[I] = sum[I] + by * four(row + 4 * I)), ...);
        for (int i = 0; i < REST; ++i) rest[i] = rest[i] + change * row[4 * FOURS + i];
        row += model::STATES;
    };
    for (int64_t j = 0; j < moves; ++j) add(along[j]);
    for (int j = 0; j < model::STATES; ++j) add(x[j]);
    std::memcpy(next, sum, 4 * FOURS * sizeof(double));
    std::memcpy(next + 4 * FOURS, rest, REST * sizeof(double));
}

template <int... I> GLB_INLINE double product(const double* row, const double* costate, std::integer_sequence<int, I...>) {
    Four sum = {};
    ((sum = sum + four(row + 4 * I) * four(costate + 4 * I)), ...);
    double total = (sum[0] + sum[1]) + (sum[2] + sum[3]);
    for (int i = 4 * FOURS; i < model::STATES; ++i) total = total + row[i] * costate[i];
    return total;
}

struct Horizon {
    const Sweep& sweep;
    int64_t h;

    const double* block(int64_t step) const {
        return sweep.jacobians + (h * sweep.steps + step) * (sweep.moves + model::STATES) * model::STATES;
    }
    double* along(int64_t step) const { return sweep.along + (h * sweep.steps + step) * sweep.moves; }
    double* states(int64_t step) const { return sweep.states + (h * (sweep.steps + 1) + step) * model::STATES; }

    void push() const {
        for (int64_t step = 0; step < sweep.steps; ++step)
            push_step(block(step), sweep.moves, along(step), states(step), states(step + 1),
                      std::make_integer_sequence<int, FOURS>{});
    }

    void pull() const {
        for (int64_t step = sweep.steps - 1; step >= 0; --step) {
            const double *row = block(step), *costate = states(step + 1);
            double *gradient = along(step), *before = states(step);
            for (int64_t j = 0; j < sweep.moves; ++j, row += model::STATES)
                gradient[j] = product(row, costate, std::make_integer_sequence<int, FOURS>{});
            for (int j = 0; j < model::STATES; ++j, row += model::STATES)
                before[j] = before[j] + product(row, costate, std::make_integer_sequence<int, FOURS>{});
        }
    }
};

// Row h * steps + t is step t of horizon h. Its cotangent is that of its end alone; what comes from later steps is added here.
template <class M>
void reverse_horizons(const Settings& settings, const Rows& rows, const Request& request, int64_t steps, double* cotangents,
                      std::atomic<int64_t>& next) {
    const auto worker = std::make_unique<Differentiator<M, StageLanes<M>, double>>(settings, rows, request);
    for (int64_t h = next.fetch_add(1); h * steps < rows.n; h = next.fetch_add(1)) {
        for (int64_t row = (h + 1) * steps - 1; row >= h * steps; --row) {
            worker->row(row);
            if (rows.status[row] != 0) break;
            if (row == h * steps) continue;
            double* before = cotangents + (row - 1) * model::STATES;
            for (int i = 0; i < model::STATES; ++i) before[i] = before[i] + request.xb[row * model::STATES + i];
        }
    }
}

}  // namespace glb

// As glb_differentiate, in reverse through horizons of `steps` > 0 rows each; request->cotangents are `cotangents`.
extern "C" int32_t glb_reverse_horizons(const glb::Settings* settings, glb::Rows* rows, const glb::Request* request, int64_t steps,
                                        double* cotangents) {
    return differentiate(*settings, *rows, rows->n / steps, [&](std::atomic<int64_t>& next) {
        if (settings->method == glb::GRK4T) glb::reverse_horizons<glb::Grk4t>(*settings, *rows, *request, steps, cotangents, next);
        else glb::reverse_horizons<glb::Rodas4P2>(*settings, *rows, *request, steps, cotangents, next);
    });
}

// Changes of inputs and of the first states forward: all later states' changes.
extern "C" void glb_push(const glb::Settings* settings, const glb::Sweep* sweep) {
    std::atomic<int64_t> next{0};
    in_threads(*settings, sweep->horizons, [&] {
        for (int64_t h = next.fetch_add(1); h < sweep->horizons; h = next.fetch_add(1)) glb::Horizon{*sweep, h}.push();
    }, 1);
}

// Cotangents of all states backward: they become costates, and the gradients of the inputs are given.
extern "C" void glb_pull(const glb::Settings* settings, const glb::Sweep* sweep) {
    std::atomic<int64_t> next{0};
    in_threads(*settings, sweep->horizons, [&] {
        for (int64_t h = next.fetch_add(1); h < sweep->horizons; h = next.fetch_add(1)) glb::Horizon{*sweep, h}.pull();
    }, 1);
}

// Sizes of this library, compared with the caller's before the first call.
extern "C" void glb_sensitivity_layout(int64_t* sizes) {
    sizes[0] = sizeof(glb::Settings);
    sizes[1] = sizeof(glb::Rows);
    sizes[2] = sizeof(glb::Request);
    sizes[3] = sizeof(glb::Sweep);
    sizes[4] = glb::model::STATES;
}
