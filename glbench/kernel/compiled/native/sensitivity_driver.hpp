// Control steps of rows with their derivatives: the primal step is that of driver.hpp, one row in one lane, and every accepted
// substep is differentiated (forward) or kept (reverse).
//
// A row's derivatives depend on that row alone, so their bits depend neither on the batch nor on the number of threads.
#pragma once
#include <memory>
#include <new>

#include "driver.hpp"
#include "sensitivity.hpp"

namespace glb {

// What to differentiate; the rows come beside it. Pointers may be null where noted; all arrays are C-contiguous.
struct Request {
    int64_t directions;                 // a row, 0 for none
    int64_t stride;                     // 1: each row has its directions, 0: all rows share them
    const double *dx, *du, *dd, *dp;    // (rows or 1, directions, size of the input), or null for zeros
    double* tangents;                   // (rows, directions, states)
    const double* cotangents;           // (rows, states), or null for no reverse sweep
    double *xb, *ub, *db, *pb;          // (rows, size of the input)
};

// Steps one row with the stepper of the kernel and shows every accepted substep.
struct Recorder {
    template <class Visit> static bool run(const Settings& settings, const Rows& one, Visit&& visit) {
        std::atomic<int64_t> next{0};
        Stepper<double> stepper(settings, one, next);
        if (!stepper.refill(0)) return false;
        Taken taken;
        for (;;) {
            std::memcpy(taken.x, stepper.work_.x, sizeof taken.x);
            taken.h = stepper.h_;
            const double left = stepper.remaining_;
            const bool ended = stepper.round() != 0;
            if (ended && *one.status != 0) return false;
            if (ended || stepper.remaining_ != left) {
                std::memcpy(taken.k, stepper.work_.k, sizeof taken.k);
                std::memcpy(taken.factors, stepper.work_.factors, sizeof taken.factors);
                visit(taken);
            }
            if (ended) return true;
        }
    }
};

template <class V> class Differentiator {
  public:
    Differentiator(const Settings& settings, const Rows& rows, const Request& request)
        : settings_(settings), rows_(rows), request_(request), dx_(chunks() * N), dc_(chunks() * model::INPUTS),
          drate_(chunks() * (model::CLOCKS + 1)) {}

    void row(int64_t row) {
        const double *p = rows_.p + row * rows_.p_stride, *u = rows_.u + row * model::CONTROLS;
        const double* d = rows_.d + row * model::DISTURBANCES;
        alignas(64) double c[model::INPUTS], s[model::STORED_INPUTS];
        model::inputs<double>(p, u, d, c);
        model::stored_inputs<double>(c, s);
        for (int i = 0; i < model::STORED_INPUTS; ++i) stored_[i] = broadcast<V>(s[i]);
        for (int64_t chunk = 0; chunk < chunks(); ++chunk) seed(row, chunk, p, u, d);
        taken_.clear();
        const Rows one = {1, rows_.x + row * model::STATES, u, d, p, 0, rows_.out + row * model::STATES, rows_.status + row,
                          rows_.substeps + row, rows_.reached + row, 0};
        const bool stepped = Recorder::run(settings_, one, [&](const Taken& taken) {
            if (request_.cotangents != nullptr) taken_.push_back(taken);
            if (request_.directions > 0) {
                compute_matrices<V>(taken, stored_, matrices_);
                for (int64_t chunk = 0; chunk < chunks(); ++chunk)
                    forward_substep<V, V>(taken, matrices_, of_inputs(chunk), dx_.data() + chunk * N);
            }
        });
        if (!stepped) return;
        for (int64_t chunk = 0; chunk < chunks(); ++chunk) give_tangents(row, chunk);
        if (request_.cotangents != nullptr) reverse(row, p, u, d);
    }

  private:
    static constexpr int W = width_of<V>;

    const Settings& settings_;
    const Rows& rows_;
    const Request& request_;
    V stored_[model::STORED_INPUTS];
    Matrices<V> matrices_;
    std::vector<V> dx_, dc_, drate_;  // of each chunk of W directions
    std::vector<Taken> taken_;

    int64_t chunks() const { return (request_.directions + W - 1) / W; }
    bool inputs_move() const { return request_.du != nullptr || request_.dd != nullptr || request_.dp != nullptr; }
    const V* of_inputs(int64_t chunk) const { return inputs_move() ? dc_.data() + chunk * model::INPUTS : nullptr; }

    // Element `index` of the chunk's directions; lanes without a direction are zero.
    V direction(const double* seeds, int64_t row, int64_t chunk, int size, int index) const {
        V value = broadcast<V>(0.0);
        if (seeds == nullptr) return value;
        for (int lane = 0; lane < W && chunk * W + lane < request_.directions; ++lane) {
            const int64_t which = row * request_.stride * request_.directions + chunk * W + lane;
            put(value, lane, seeds[which * size + index]);
        }
        return value;
    }

    void seed(int64_t row, int64_t chunk, const double* p, const double* u, const double* d) {
        for (int n = 0; n < N; ++n)
            dx_[chunk * N + n] = direction(request_.dx, row, chunk, model::STATES, model::MOVING_STATE[n]);
        for (int i = 0; i < model::CLOCKS; ++i) drate_[chunk * (model::CLOCKS + 1) + i] = broadcast<V>(0.0);
        if (!inputs_move()) return;
        V point_p[model::PARAMETERS], point_u[model::CONTROLS], point_d[model::DISTURBANCES];
        V dp[model::PARAMETERS], du[model::CONTROLS], dd[model::DISTURBANCES];
        for (int i = 0; i < model::PARAMETERS; ++i)
            point_p[i] = broadcast<V>(p[i]), dp[i] = direction(request_.dp, row, chunk, model::PARAMETERS, i);
        for (int i = 0; i < model::CONTROLS; ++i)
            point_u[i] = broadcast<V>(u[i]), du[i] = direction(request_.du, row, chunk, model::CONTROLS, i);
        for (int i = 0; i < model::DISTURBANCES; ++i)
            point_d[i] = broadcast<V>(d[i]), dd[i] = direction(request_.dd, row, chunk, model::DISTURBANCES, i);
        model::inputs_forward<V>(point_p, point_u, point_d, dp, du, dd, dc_.data() + chunk * model::INPUTS,
                                 drate_.data() + chunk * (model::CLOCKS + 1));
    }

    void give_tangents(int64_t row, int64_t chunk) {
        for (int lane = 0; lane < W && chunk * W + lane < request_.directions; ++lane) {
            double* out = request_.tangents + (row * request_.directions + chunk * W + lane) * model::STATES;
            for (int n = 0; n < N; ++n) out[model::MOVING_STATE[n]] = element(dx_[chunk * N + n], lane);
        }
        for (int i = 0; i < model::CLOCKS; ++i) {
            const int state = model::CLOCK_STATE[i];
            const V rate = drate_[chunk * (model::CLOCKS + 1) + i];
            const V end = fma<V>(broadcast<V>(settings_.step), rate, direction(request_.dx, row, chunk, model::STATES, state));
            for (int lane = 0; lane < W && chunk * W + lane < request_.directions; ++lane)
                request_.tangents[(row * request_.directions + chunk * W + lane) * model::STATES + state] = element(end, lane);
        }
    }

    void reverse(int64_t row, const double* p, const double* u, const double* d) {
        const double* cotangent = request_.cotangents + row * model::STATES;
        double* given = request_.xb + row * model::STATES;
        double xb[N], cb[model::INPUTS], rateb[model::CLOCKS + 1];
        V by_stage[Matrices<V>::GROUPS][model::INPUTS];
        std::memset(static_cast<void*>(by_stage), 0, sizeof by_stage);
        for (int n = 0; n < N; ++n) xb[n] = cotangent[model::MOVING_STATE[n]];
        for (auto taken = taken_.rbegin(); taken != taken_.rend(); ++taken) {
            compute_matrices<V>(*taken, stored_, matrices_);
            reverse_substep<V>(*taken, matrices_, xb, by_stage);
        }
        for (int j = 0; j < model::INPUTS; ++j) {
            cb[j] = 0.0;
            for (int i = 0; i < STAGES; ++i) cb[j] = cb[j] + element(by_stage[i / W][j], i % W);
        }
        for (int n = 0; n < N; ++n) given[model::MOVING_STATE[n]] = xb[n];
        for (int i = 0; i < model::CLOCKS; ++i) {
            given[model::CLOCK_STATE[i]] = cotangent[model::CLOCK_STATE[i]];
            rateb[i] = settings_.step * cotangent[model::CLOCK_STATE[i]];
        }
        model::inputs_reverse<double>(p, u, d, cb, rateb, request_.pb + row * model::PARAMETERS,
                                      request_.ub + row * model::CONTROLS, request_.db + row * model::DISTURBANCES);
    }
};

}  // namespace glb

// Takes rows from `next` until none is left; what a thread that runs out of memory did not do is marked in `short_of_memory`.
static void differentiate_rows(const glb::Settings& settings, const glb::Rows& rows, const glb::Request& request,
                               std::atomic<int64_t>& next, std::atomic<bool>& short_of_memory) {
    try {
        const auto worker = std::make_unique<glb::Differentiator<BatchLanes>>(settings, rows, request);
        for (int64_t row = next.fetch_add(1); row < rows.n; row = next.fetch_add(1)) worker->row(row);
    } catch (const std::bad_alloc&) {
        short_of_memory = true;
    }
}

// Returns 0, or 1 when there was not enough memory; then nothing of the result is to be used.
extern "C" int32_t glb_differentiate(const glb::Settings* settings, glb::Rows* rows, const glb::Request* request) {
    std::atomic<int64_t> next{0};
    std::atomic<bool> short_of_memory{false};
    const int64_t threads = settings->threads < rows->n ? settings->threads : rows->n;
    std::vector<std::thread> others;
    const auto work = [&] { differentiate_rows(*settings, *rows, *request, next, short_of_memory); };
    try {
        for (int64_t k = 1; k < threads; ++k) others.emplace_back(work);
    } catch (const std::system_error&) {  // no more threads to be had: those that run take the rows
    }
    work();
    for (auto& thread : others) thread.join();
    rows->failed = 0;
    for (int64_t row = 0; row < rows->n; ++row) rows->failed += rows->status[row] != 0;
    return short_of_memory ? 1 : 0;
}

// Sizes of this library, compared with the caller's before the first call.
extern "C" void glb_sensitivity_layout(int64_t* sizes) {
    sizes[0] = sizeof(glb::Settings);
    sizes[1] = sizeof(glb::Rows);
    sizes[2] = sizeof(glb::Request);
    sizes[3] = glb::model::STATES;
}
