// Control steps of rows with their derivatives: the primal step is that of stepper.hpp, one row in one lane, and every accepted
// substep is differentiated (forward) or kept (reverse).
//
// A row's derivatives depend on that row alone, so their bits depend neither on the batch nor on the number of threads.
#pragma once
#include <memory>
#include <new>

#include "driver.hpp"
#include "sensitivity.hpp"
#ifdef GLB_FOLLOWERS
#include "follower_sensitivity.hpp"
#endif

namespace glb {

#ifndef GLB_FOLLOWERS
constexpr int HELD = model::DISTURBANCES;
#endif

// What to differentiate; the rows come beside it. Pointers may be null where noted; all arrays are C-contiguous.
struct Request {
    int64_t directions;                 // a row, 0 for none
    int64_t stride;                     // 1: each row has its directions, 0: all rows share them
    const double *dx, *du, *dd, *dp;    // (rows or 1, directions, size of the input), or null for zeros
    double* tangents;                   // (rows, directions, states)
    const double* cotangents;           // (rows, states), or null for no reverse sweep
    double *xb, *ub, *db, *pb;          // (rows, size of the input); pb may be null
};

// Steps one row with the stepper of the kernel and shows every accepted substep.
struct Recorder {
    template <class Visit> static bool run(const Settings& settings, const Rows& one, Visit&& visit) {
        std::atomic<int64_t> next{0};
        Stepper<double> stepper(settings, one, next);
        if (!stepper.refill(0)) return false;
        Taken taken;
        for (;;) {
            for (int n = 0; n < N; ++n) taken.x[n] = stepper.work_.x[n];
            taken.h = stepper.h_;
            const double left = stepper.remaining_;
            const bool ended = stepper.round() != 0;
            if (ended && *one.status != 0) return false;
            if (ended || stepper.remaining_ != left) {
                for (int i = 0; i < STAGES; ++i)
                    for (int n = 0; n < N; ++n) taken.k[i][n] = stepper.work_.k[i][n];
                visit(taken);
            }
            if (ended) return true;
        }
    }
};

// Directions of one row, in chunks of the lanes of D. Those that move nothing but clocks are idle: their result is known beforehand.
template <class D> class Tangents {
  public:
    Tangents(const Settings& settings, const Request& request)
        : settings_(settings), request_(request), chunks_((request.directions + W - 1) / W), dx_(chunks_ * ROOM<D>),
          dc_(chunks_ * model::INPUTS), drate_(chunks_ * RATES), inputs_move_(chunks_) {
        busy_.reserve(request.directions);
        idle_.reserve(request.directions);
        if (request.stride == 0) sort_out();
    }

    void start(int64_t row, const double* p, const double* u, const double* d) {
        row_ = row;
        if (request_.stride != 0) sort_out();
        for (int64_t chunk = 0; chunk < chunks_; ++chunk) {
            for (int n = 0; n < N; ++n)
                dx_[chunk * ROOM<D> + n] = direction(request_.dx, chunk, model::STATES, model::MOVING_STATE[n]);
            start_inputs(chunk, p, u, d);
        }
    }

    template <class M, class V> void substep(const Taken& taken, const Matrices<V>& matrices) {
        for (int64_t chunk = 0; chunk < chunks_; ++chunk)
            forward_substep<M, D, V>(taken, matrices, inputs_move_[chunk] ? &dc_[chunk * model::INPUTS] : nullptr,
                                  &dx_[chunk * ROOM<D>]);
    }

#ifdef GLB_FOLLOWERS
    // After `finish`: directions of the followers.
    void follow(const FollowerPath& path) const {
        D dq[model::READS + 1], dv[model::DRIVERS + 1], slow[model::FOLLOWERS];
        for (int64_t chunk = 0; chunk < chunks_; ++chunk) {
            D* to = dq;
            const auto read = [&](const double* seeds, int size, const int* indices) {
                for (; *indices >= 0; ++indices) *to++ = direction(seeds, chunk, size, *indices);
            };
            read(request_.dd, model::DISTURBANCES, model::READ_D);
            read(request_.dp, model::PARAMETERS, model::READ_P);
            read(request_.du, model::CONTROLS, model::READ_U);
            for (int k = 0; k < model::DRIVERS; ++k) {
                const int n = model::DRIVER[k];
                dv[k] = (dx_[chunk * ROOM<D> + n] - direction(request_.dx, chunk, model::STATES, model::MOVING_STATE[n])) /
                        broadcast<D>(path.h);
            }
            for (int k = 0; k < model::FOLLOWERS; ++k) slow[k] = direction(request_.dx, chunk, model::STATES, model::FOLLOWER_STATE[k]);
            path.forward<D>(dq, dv, slow);
            for (int k = 0; k < model::FOLLOWERS; ++k) give(chunk, model::FOLLOWER_STATE[k], slow[k]);
        }
        for (const int64_t k : idle_)
            for (int i = 0; i < model::FOLLOWERS; ++i)
                request_.tangents[(row_ * request_.directions + k) * model::STATES + model::FOLLOWER_STATE[i]] = 0.0;
    }

#endif
    void finish() const {
        for (int64_t chunk = 0; chunk < chunks_; ++chunk) {
            for (int n = 0; n < N; ++n) give(chunk, model::MOVING_STATE[n], dx_[chunk * ROOM<D> + n]);
            for (int i = 0; i < model::CLOCKS; ++i) {
                const int state = model::CLOCK_STATE[i];
                const D before = direction(request_.dx, chunk, model::STATES, state);
                give(chunk, state, fma<D>(broadcast<D>(settings_.step), drate_[chunk * RATES + i], before));
            }
        }
        for (const int64_t k : idle_) {
            double* given = request_.tangents + (row_ * request_.directions + k) * model::STATES;
            for (int n = 0; n < N; ++n) given[model::MOVING_STATE[n]] = 0.0;
            for (int i = 0; i < model::CLOCKS; ++i) {
                const int state = model::CLOCK_STATE[i];
                given[state] = request_.dx == nullptr ? 0.0 : 0.0 + seeds_of(request_.dx, k, model::STATES)[state];
            }
        }
    }

  private:
    static constexpr int W = width_of<D>, RATES = model::CLOCKS + 1;

    const Settings& settings_;
    const Request& request_;
    int64_t row_ = 0, chunks_;
    std::vector<D> dx_, dc_, drate_;
    std::vector<char> inputs_move_;
    std::vector<int64_t> busy_, idle_;

    const double* seeds_of(const double* seeds, int64_t k, int size) const {
        return seeds + (row_ * request_.stride * request_.directions + k) * size;
    }

    bool moves(const double* seeds, int64_t k, int size) const {
        if (seeds == nullptr) return false;
        const double* own = seeds_of(seeds, k, size);
        for (int i = 0; i < size; ++i)
            if (own[i] != 0.0) return true;
        return false;
    }

    bool moves_states(int64_t k) const {
        if (request_.dx == nullptr) return false;
        const double* own = seeds_of(request_.dx, k, model::STATES);
        for (int n = 0; n < N; ++n)
            if (own[model::MOVING_STATE[n]] != 0.0) return true;
#ifdef GLB_FOLLOWERS
        for (int k = 0; k < model::FOLLOWERS; ++k)
            if (own[model::FOLLOWER_STATE[k]] != 0.0) return true;
#endif
        return false;
    }

    void sort_out() {
        busy_.clear();
        idle_.clear();
        for (int64_t k = 0; k < request_.directions; ++k) {
            const bool busy = moves_states(k) || moves(request_.du, k, model::CONTROLS) ||
                              moves(request_.dd, k, model::DISTURBANCES) || moves(request_.dp, k, model::PARAMETERS);
            (busy ? busy_ : idle_).push_back(k);
        }
        chunks_ = (static_cast<int64_t>(busy_.size()) + W - 1) / W;
    }

    int lanes(int64_t chunk) const {
        const int64_t left = static_cast<int64_t>(busy_.size()) - chunk * W;
        return left < W ? static_cast<int>(left) : W;
    }

    // Element `index` of the chunk's directions in one input; lanes without a direction are zero.
    D direction(const double* seeds, int64_t chunk, int size, int index) const {
        D value = broadcast<D>(0.0);
        if (seeds == nullptr) return value;
        for (int lane = 0; lane < lanes(chunk); ++lane) put(value, lane, seeds_of(seeds, busy_[chunk * W + lane], size)[index]);
        return value;
    }

    // All directions of the chunk in one input; says whether any is not zero.
    bool read(const double* seeds, int64_t chunk, int size, D* values) const {
        bool moves = false;
        for (int i = 0; i < size; ++i) {
            values[i] = direction(seeds, chunk, size, i);
            for (int lane = 0; lane < W; ++lane) moves |= element(values[i], lane) != 0.0;
        }
        return moves;
    }

    void start_inputs(int64_t chunk, const double* p, const double* u, const double* d) {
        D dp[model::PARAMETERS], du[model::CONTROLS], dd[HELD];
        bool moves = read(request_.dp, chunk, model::PARAMETERS, dp);
        moves |= read(request_.du, chunk, model::CONTROLS, du);
        moves |= read(request_.dd, chunk, model::DISTURBANCES, dd);
#ifdef GLB_FOLLOWERS
        for (int k = 0; k < model::FOLLOWERS; ++k) {
            D& value = dd[model::DISTURBANCES + k] = direction(request_.dx, chunk, model::STATES, model::FOLLOWER_STATE[k]);
            for (int lane = 0; lane < W; ++lane) moves |= element(value, lane) != 0.0;
        }
#endif
        inputs_move_[chunk] = moves;
        for (int i = 0; i < model::CLOCKS; ++i) drate_[chunk * RATES + i] = broadcast<D>(0.0);
        if (!moves) return;
        D at_p[model::PARAMETERS], at_u[model::CONTROLS], at_d[HELD];
        for (int i = 0; i < model::PARAMETERS; ++i) at_p[i] = broadcast<D>(p[i]);
        for (int i = 0; i < model::CONTROLS; ++i) at_u[i] = broadcast<D>(u[i]);
        for (int i = 0; i < HELD; ++i) at_d[i] = broadcast<D>(d[i]);
        model::inputs_forward<D>(at_p, at_u, at_d, dp, du, dd, &dc_[chunk * model::INPUTS], &drate_[chunk * RATES]);
    }

    void give(int64_t chunk, int state, D value) const {
        double* first = request_.tangents + row_ * request_.directions * model::STATES + state;
        for (int lane = 0; lane < lanes(chunk); ++lane) first[busy_[chunk * W + lane] * model::STATES] = element(value, lane);
    }
};

// `M`: method; `V`: lanes of the stages; `D`: lanes of the directions.
template <class M, class V, class D> class Differentiator {
  public:
    Differentiator(const Settings& settings, const Rows& rows, const Request& request)
        : settings_(settings), rows_(rows), request_(request), tangents_(settings, request) {}

    void row(int64_t row) {
        const double *p = rows_.p + row * rows_.p_stride, *u = rows_.u + row * model::CONTROLS;
        const double* d = rows_.d + row * model::DISTURBANCES;
#ifdef GLB_FOLLOWERS
        double held[HELD];
        hold(d, rows_.x + row * model::STATES, held);
        d = held;
#endif
        double c[model::INPUTS], s[model::STORED_INPUTS];
        model::inputs<double>(p, u, d, c);
        model::stored_inputs<double>(c, s);
        for (int i = 0; i < model::STORED_INPUTS; ++i) stored_[i] = broadcast<V>(s[i]);
        tangents_.start(row, p, u, d);
        taken_.clear();
        const Rows one = {1, rows_.x + row * model::STATES, u, d, p, 0, rows_.out + row * model::STATES, rows_.status + row,
                          rows_.substeps + row, rows_.reached + row, 0};
        const bool stepped = Recorder::run(settings_, one, [&](const Taken& taken) {
            if (request_.cotangents != nullptr) taken_.push_back(taken);
            if (request_.directions > 0) {
                compute_matrices<M, V>(taken, stored_, matrices_);
                tangents_.template substep<M>(taken, matrices_);
            }
        });
        if (!stepped) return;
        tangents_.finish();
#ifdef GLB_FOLLOWERS
        path_.retrace(p, u, d, rows_.x + row * model::STATES, rows_.out + row * model::STATES, settings_.step);
        tangents_.follow(path_);
#endif
        if (request_.cotangents != nullptr) reverse(row, p, u, d);
    }

  private:
    static constexpr int W = width_of<V>;

    const Settings& settings_;
    const Rows& rows_;
    const Request& request_;
    V stored_[model::STORED_INPUTS];
    Matrices<V> matrices_;
    Tangents<D> tangents_;
    std::vector<Taken> taken_;
#ifdef GLB_FOLLOWERS
    FollowerPath path_;
#endif

    void reverse(int64_t row, const double* p, const double* u, const double* d) {
        const double* cotangent = request_.cotangents + row * model::STATES;
        double* given = request_.xb + row * model::STATES;
        double xb[N], cb[model::INPUTS], rateb[model::CLOCKS + 1];
        V by_stage[Matrices<V>::GROUPS][model::INPUTS];
        std::memset(static_cast<void*>(by_stage), 0, sizeof by_stage);
        for (int n = 0; n < N; ++n) xb[n] = cotangent[model::MOVING_STATE[n]];
#ifdef GLB_FOLLOWERS
        double slow[model::FOLLOWERS], qb[model::READS + 1], vb[model::DRIVERS + 1], held[HELD];
        for (int k = 0; k < model::FOLLOWERS; ++k) slow[k] = cotangent[model::FOLLOWER_STATE[k]];
        path_.reverse(slow, qb, vb);
        for (int k = 0; k < model::DRIVERS; ++k) xb[model::DRIVER[k]] = xb[model::DRIVER[k]] + vb[k] / path_.h;
#endif
        for (auto taken = taken_.rbegin(); taken != taken_.rend(); ++taken) {
            compute_matrices<M, V>(*taken, stored_, matrices_);
            reverse_substep<M, V>(*taken, matrices_, xb, by_stage);
        }
        for (int j = 0; j < model::INPUTS; ++j) {
            cb[j] = 0.0;
            for (int i = 0; i < M::STAGES; ++i) cb[j] = cb[j] + element(by_stage[i / W][j], i % W);
        }
        for (int n = 0; n < N; ++n) given[model::MOVING_STATE[n]] = xb[n];
        for (int i = 0; i < model::CLOCKS; ++i) {
            given[model::CLOCK_STATE[i]] = cotangent[model::CLOCK_STATE[i]];
            rateb[i] = settings_.step * cotangent[model::CLOCK_STATE[i]];
        }
        double unasked[model::PARAMETERS + 1];
#ifdef GLB_FOLLOWERS
        double *pb = request_.pb == nullptr ? unasked : request_.pb + row * model::PARAMETERS, *ub = request_.ub + row * model::CONTROLS;
        model::inputs_reverse<double>(p, u, d, cb, rateb, pb, ub, held);
        for (int k = 0; k < model::DRIVERS; ++k) given[model::MOVING_STATE[model::DRIVER[k]]] -= vb[k] / path_.h;
        for (int k = 0; k < model::FOLLOWERS; ++k) given[model::FOLLOWER_STATE[k]] = slow[k] + held[model::DISTURBANCES + k];
        const double* from = qb;
        const auto add = [&](double* to, const int* indices) {
            for (; *indices >= 0; ++indices) to[*indices] = to[*indices] + *from++;
        };
        add(held, model::READ_D);
        add(pb, model::READ_P);
        add(ub, model::READ_U);
        std::memcpy(request_.db + row * model::DISTURBANCES, held, model::DISTURBANCES * sizeof(double));
#else
        model::inputs_reverse<double>(p, u, d, cb, rateb, request_.pb == nullptr ? unasked : request_.pb + row * model::PARAMETERS,
                                      request_.ub + row * model::CONTROLS, request_.db + row * model::DISTURBANCES);
#endif
    }
};

// Lanes for the stages of a method: four stages would leave half of eight lanes idle.
template <class M> using StageLanes = std::conditional_t<(M::STAGES <= 4 && BATCH_WIDTH == 8), Double4, BatchLanes>;

// Takes rows from `next` until none is left.
template <class M, class D>
void differentiate_rows(const Settings& settings, const Rows& rows, const Request& request, std::atomic<int64_t>& next) {
    const auto worker = std::make_unique<Differentiator<M, StageLanes<M>, D>>(settings, rows, request);
    for (int64_t row = next.fetch_add(1); row < rows.n; row = next.fetch_add(1)) worker->row(row);
}

template <class M>
void differentiate_rows_of(const Settings& settings, const Rows& rows, const Request& request, std::atomic<int64_t>& next) {
    if (request.directions > 1) differentiate_rows<M, BatchLanes>(settings, rows, request, next);
    else differentiate_rows<M, double>(settings, rows, request, next);
}

}  // namespace glb

// Lets threads take from `next` what they differentiate, `count` in all. Gives 0, or 1 when there was not enough memory; then nothing
// of the result is to be used.
template <class Take> int32_t differentiate(const glb::Settings& settings, glb::Rows& rows, int64_t count, const Take& take) {
    std::atomic<int64_t> next{0};
    std::atomic<bool> short_of_memory{false};
    const auto work = [&] {
        try {
            take(next);
        } catch (const std::bad_alloc&) {
            short_of_memory = true;
        }
    };
    in_threads(settings, count, work, 1);
    rows.failed = 0;
    for (int64_t row = 0; row < rows.n; ++row) rows.failed += rows.status[row] != 0;
    return short_of_memory ? 1 : 0;
}

extern "C" int32_t glb_differentiate(const glb::Settings* settings, glb::Rows* rows, const glb::Request* request) {
    return differentiate(*settings, *rows, rows->n, [&](std::atomic<int64_t>& next) {
        if (settings->method == glb::GRK4T) glb::differentiate_rows_of<glb::Grk4t>(*settings, *rows, *request, next);
        else glb::differentiate_rows_of<glb::Rodas4P2>(*settings, *rows, *request, next);
    });
}
