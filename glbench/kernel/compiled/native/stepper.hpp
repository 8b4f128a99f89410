// Control steps for rows of environments: step-size control in each lane, refill of finished lanes.
//
// The first substep of every control step has the same length, and a row's substeps depend on that row alone, so a step
// is a function of its inputs: its bits depend neither on the batch, nor on the lane, nor on the number of threads.
#pragma once
#include <atomic>

#include "rosenbrock.hpp"
#include "rows.hpp"
#ifdef GLB_FOLLOWERS
#include "followers.hpp"
#endif

namespace glb {

// Near error^(-1/8), from the bits of the number: within 3 %, and a step-size rule asks for no more.
template <class V> GLB_INLINE V inverse_eighth_root(V error) {
    return from_bits<V>(INT64_C(0x47ed24dd00000000) - (bits_of(error) >> 3));
}

// The end is met exactly, and so is the start of the last stretch of `last` seconds; two equal substeps are taken rather than a long one
// and a splinter.
template <class V> GLB_INLINE V next_length(V proposed, V remaining, double last) {
    const V before = remaining - broadcast<V>(last);
    const V stretch = select<V>(before > broadcast<V>(0.0), before, remaining);
    const V shared = min_of(proposed, broadcast<V>(0.5) * stretch);
    return select<V>(stretch <= proposed, stretch, shared);
}

template <class V> class Stepper {
  public:
    Stepper(const Settings& settings, const Rows& rows, std::atomic<int64_t>& next, RowWork* work = nullptr)
        : settings_(settings), rows_(rows), next_(next), row_work_(work) {
        std::memset(static_cast<void*>(&work_), 0, sizeof work_);
        for (int i = 0; i < N; ++i) {
            absolute_[i] = settings.absolute[model::MOVING_STATE[i]];
            relative_[i] = settings.relative[model::MOVING_STATE[i]];
        }
    }

    void run() {
        int active = 0;
        for (int lane = 0; lane < W; ++lane) active += refill(lane);
        if (active == 0) return;
        advance(active);
#ifdef GLB_FOLLOWERS
        if (finished_.count > 0) finish_waiting();
#endif
    }

    // Takes over the rows in progress of another stepper, which has no more to begin, and finishes them.
    template <class Other> void take_over(const Stepper<Other>& other) {
        int active = 0;
        for (int lane = 0; lane < W; ++lane) row_[lane] = -1;
        for (int lane = 0; lane < width_of<Other>; ++lane)
            if (element(other.busy_, lane) > 0.0) adopt(other, lane, active++);
        exhausted_ = true;
        advance(active);
#ifdef GLB_FOLLOWERS
        if (finished_.count > 0) finish_waiting();
#endif
    }

    // One substep in every lane; returns how many lanes have run out of rows.
    int round() {
        const V h = h_, one = broadcast<V>(1.0);
        const Error<V> part = settings_.method == GRK4T ? substep<Grk4t>(work_, h, again_) : substep<Rodas4P2>(work_, h, again_);
        const V error = fma<V>(part.fast, relaxation(remaining_ - h), part.slow) * near_singularity();
        const MaskOf<V> busy = busy_ > broadcast<V>(0.0);
        const MaskOf<V> accepted = (error <= one) & busy;
        if constexpr (W == 1) {
            if (accepted) std::memcpy(work_.x, work_.y, sizeof work_.x);
            again_ = !accepted;
        } else {
            for (int i = 0; i < N; ++i) work_.x[i] = select<V>(accepted, work_.y[i], work_.x[i]);
        }
        const MaskOf<V> finished = accepted & (h >= remaining_);
        remaining_ = select<V>(accepted, remaining_ - h, remaining_);
        taken_ = taken_ + one;
        // Not a number shortens to 0.8, below. Its own bits decide nothing: processors disagree about its sign.
        const V root = select<V>(error == error, inverse_eighth_root(error), one);
        const V right = h * root;  // with this length the error would have been one
        V factor = max_of(broadcast<V>(0.9) * root * select<V>(accepted, trend(right), one), broadcast<V>(0.15));
        right_ = select<V>(accepted, right, right_);
        factor = min_of(factor, select<V>(accepted, broadcast<V>(6.0), broadcast<V>(0.8)));
        const V proposed = h * factor;
        h_ = next_length(proposed, remaining_, settings_.last);
        const MaskOf<V> failed = busy & not_of<V>(finished) &
                                 ((proposed < broadcast<V>(settings_.smallest)) | (taken_ >= broadcast<V>(settings_.most)));
        int ended = 0;
        if (any(finished | failed)) {
            for (int lane = 0; lane < W; ++lane) {
                if (lane_of<V>(finished, lane)) finish(lane);
                else if (lane_of<V>(failed, lane)) fail(lane, element(proposed, lane));
                else continue;
                ended += !refill(lane);
            }
        }
        return ended;
    }

  private:
    template <class Other> friend class Stepper;
    friend struct Recorder;  // of the sensitivities: reads the accepted substeps
    static constexpr int W = width_of<V>;
    static constexpr int STORED_ROOM = (model::STORED + 7) / 8 * 8;

    // When no row is left to begin and so few are in progress, half as many lanes, or one, take half the time, for the same bits.
    static constexpr int FEW = W == 8 ? 4 : 1;
    using Narrower = std::conditional_t<W == 8, Double4, double>;

    // What is done for a single row works through its values in vectors.
    using Pack = typename VectorOf<NATIVE_WIDTH>::type;
    static GLB_INLINE Pack* pack(double* a) { return reinterpret_cast<Pack*>(a); }
    static GLB_INLINE const Pack* pack(const double* a) { return reinterpret_cast<const Pack*>(a); }

    const Settings& settings_;
    const Rows& rows_;
    std::atomic<int64_t>& next_;
    RowWork* row_work_;
    Lanes<V> work_;
    V h_{}, remaining_{}, taken_{}, busy_{};  // next substep [s], time to go [s], substeps so far, 1 where a row is at work
    V right_{};  // the length that would have been right for the last accepted substep [s], 0 before the first
    alignas(64) double absolute_[PADDED] = {}, relative_[PADDED] = {};  // tolerances of the moving states
    int64_t row_[W];
    double clock_[W][model::CLOCKS + 1];  // clocks at the end of the step
#ifdef GLB_FOLLOWERS
    double reads_[W][model::READS + 1];  // what the followers read of p, u and d
    Finished<V> finished_;
#endif
    bool exhausted_ = false;
    bool again_ = false;  // of one lane: the last substep was rejected, the next one starts from the same state

    // Fast states (lamps, covers, screens, the top air) settle within a minute or two: what is wrong with them long before the end of the
    // step is forgotten at the end, so their errors count less the more time is left.
    GLB_INLINE V relaxation(V left) const {
        const V fading = exp16_of_limited(left * broadcast<V>(-2.0 * SIXTEEN_LOG2_E / settings_.fast_time_constant));
        return max_of(broadcast<V>(settings_.fast_error_floor), fading);
    }

    // After a change of the inputs the solution becomes smoother from substep to substep, so the right length grows: half of
    // the growth seen last is expected to go on.
    GLB_INLINE V trend(V right) const {
        const V half = sqrt_of(right / right_);
        const V limited = min_of(broadcast<V>(1.5), max_of(broadcast<V>(0.7), half));
        return select<V>(right_ > broadcast<V>(0.0), limited, broadcast<V>(1.0));
    }

    // Air passes the screens like a root of the temperature difference, whose derivative has no bound. Error estimates know
    // nothing of that, so a substep that changes the difference by more than half of its size has to be more accurate.
    GLB_INLINE V near_singularity() const {
        constexpr int a = model::SINGULAR[0], b = model::SINGULAR[1];
        const V before = work_.x[a] - work_.x[b], after = work_.y[a] - work_.y[b];
        const V size = max_of(abs_of(before), abs_of(after));
        const MaskOf<V> near = abs_of(after - before) > broadcast<V>(0.5) * size;
        return select<V>(near, broadcast<V>(settings_.singular_error_factor), broadcast<V>(1.0));
    }

    static GLB_INLINE bool any(MaskOf<V> mask) {
        if constexpr (W == 1) return mask;
        else {
            int64_t sum = 0;
            for (int lane = 0; lane < W; ++lane) sum |= mask[lane];
            return sum != 0;
        }
    }

    // Substeps until the rows in `active` lanes, and all that follow them there, are done.
    void advance(int active) {
        for (int lane = 0; lane < W; ++lane)
            if (row_[lane] < 0) copy_lane(0, lane);  // compute something usual there
        while (active > 0) {
            if constexpr (W > 1) {
                if (exhausted_ && active <= FEW) return Stepper<Narrower>(settings_, rows_, next_, row_work_).take_over(*this);
            }
            active -= round();
        }
    }

    template <class Other> void adopt(const Stepper<Other>& other, int from, int to) {
        for (int i = 0; i < N; ++i) {
            set_element(work_.x[i], to, element(other.work_.x[i], from));
            set_element(work_.weight[i], to, element(other.work_.weight[i], from));
        }
        for (int i = 0; i < model::STORED; ++i) set_element(work_.stored[i], to, element(other.work_.stored[i], from));
        set_element(h_, to, element(other.h_, from));
        set_element(remaining_, to, element(other.remaining_, from));
        set_element(taken_, to, element(other.taken_, from));
        set_element(right_, to, element(other.right_, from));
        set_element(busy_, to, 1.0);
        for (int i = 0; i < model::CLOCKS; ++i) clock_[to][i] = other.clock_[from][i];
#ifdef GLB_FOLLOWERS
        std::memcpy(reads_[to], other.reads_[from], sizeof reads_[to]);
#endif
        row_[to] = other.row_[from];
    }

    // Loads the next row into a lane; rows that cannot be stepped are reported on the way. False when none is left.
    bool refill(int lane) {
        for (;;) {
            const int64_t row = next_.fetch_add(1, std::memory_order_relaxed);
            if (row >= rows_.n) {
                exhausted_ = true;
                row_[lane] = -1;
                set_element(busy_, lane, 0.0);
                return false;
            }
            row_[lane] = row;
            Inputs in;
            if (row_work_ == nullptr)
                in = {rows_.x + row * model::STATES, rows_.u + row * model::CONTROLS, rows_.d + row * model::DISTURBANCES,
                      rows_.p + row * rows_.p_stride};
            else if (!row_work_->begin(row, in)) continue;
            const double *x = in.x, *p = in.p;
            alignas(64) double stored[STORED_ROOM] = {}, moving[PADDED] = {}, weight[PADDED];
            double rate[model::CLOCKS + 1];
#ifdef GLB_FOLLOWERS
            double held[HELD];
            hold(in.d, x, held);
            in.d = held;
            read_inputs(p, in.u, in.d, reads_[lane]);
#endif
            model::prepare<double>(p, in.u, in.d, stored, rate);
            const int32_t unusable = first_problem(x, p, stored);
            if (unusable != 0) {
                report(row, unusable, 0, 0.0);
                continue;
            }
            for (int i = 0; i < model::STORED; ++i) set_element(work_.stored[i], lane, stored[i]);
            for (int i = 0; i < N; ++i) moving[i] = x[model::MOVING_STATE[i]];
            for (int i = 0; i < PADDED; i += NATIVE_WIDTH) {
                const Pack a = *pack(absolute_ + i), r = *pack(relative_ + i), size = abs_of(*pack(moving + i));
                *pack(weight + i) = inv_of(a + r * size);
            }
            for (int i = 0; i < N; ++i) {
                set_element(work_.x[i], lane, moving[i]);
                set_element(work_.weight[i], lane, weight[i]);
            }
            for (int i = 0; i < model::CLOCKS; ++i)
                clock_[lane][i] = __builtin_fma(settings_.step, rate[i], x[model::CLOCK_STATE[i]]);
            set_element(h_, lane, settings_.first < settings_.step ? settings_.first : settings_.step);
            set_element(remaining_, lane, settings_.step);
            set_element(taken_, lane, 0.0);
            set_element(right_, lane, 0.0);
            set_element(busy_, lane, 1.0);
            again_ = false;
            return true;
        }
    }

    // 0 when a row can be stepped, else the status to report.
    static int32_t first_problem(const double* x, const double* p, const double* stored) {
#ifdef GLB_FOLLOWERS
        if (!all_finite(x, model::STATES))
#endif
        for (int i = 0; i < model::STATES; ++i)
            if (!finite(x[i])) return INPUT_NOT_FINITE * STATUS_STATES + i;
        Pack rest = broadcast<Pack>(0.0);
        for (int i = 0; i < STORED_ROOM; i += NATIVE_WIDTH) rest = rest + (*pack(stored + i) - *pack(stored + i));
        for (int i = 0; i < NATIVE_WIDTH; ++i)
            if (rest[i] != 0.0) return INPUT_NOT_FINITE * STATUS_STATES + NO_STATE;
        for (int i = 0; i < model::ABSENT; ++i)
            if (p[model::ABSENT_PARAMETER[i]] != 0.0) return EQUIPMENT_PRESENT * STATUS_STATES + NO_STATE;
        return 0;
    }

    void copy_lane(int from, int to) {
        for (int i = 0; i < model::STORED; ++i) set_element(work_.stored[i], to, element(work_.stored[i], from));
        for (int i = 0; i < N; ++i) {
            set_element(work_.x[i], to, element(work_.x[i], from));
            set_element(work_.weight[i], to, element(work_.weight[i], from));
        }
        set_element(h_, to, element(h_, from));
        set_element(remaining_, to, element(remaining_, from));
    }

    void report(int64_t row, int32_t status, int32_t substeps, double reached) {
        rows_.status[row] = status;
        rows_.substeps[row] = substeps;
        rows_.reached[row] = reached;
        if (status != 0 && rows_.out != rows_.x) {
            const int64_t first = row * model::STATES;
            std::memcpy(rows_.out + first, rows_.x + first, model::STATES * sizeof(double));
        }
        if (row_work_ != nullptr) row_work_->end(row);
    }

#ifdef GLB_FOLLOWERS
    // The followers of finished rows wait until there is one in each lane.
    void finish(int lane) {
        Finished<V>& done = finished_;
        const int64_t row = row_[lane];
        double* after = done.after[done.count];
        for (int i = 0; i < N; ++i) after[model::MOVING_STATE[i]] = element(work_.x[i], lane);
        for (int i = 0; i < model::CLOCKS; ++i) after[model::CLOCK_STATE[i]] = clock_[lane][i];
        done.row[done.count] = row;
        done.taken[done.count] = static_cast<int32_t>(element(taken_, lane));
        done.add(rows_.x + row * model::STATES, reads_[lane], settings_.step);
        if (done.count == W) finish_waiting();
    }

    void finish_waiting() {
        Finished<V>& done = finished_;
        done.follow(settings_.step);
        for (int lane = 0; lane < done.count; ++lane) {
            const int state = done.problem(lane);
            if (state == NO_STATE) std::memcpy(rows_.out + done.row[lane] * model::STATES, done.after[lane], sizeof done.after[lane]);
            report(done.row[lane], state == NO_STATE ? 0 : FOLLOWER_NOT_FINITE * STATUS_STATES + state, done.taken[lane], settings_.step);
        }
        done.count = 0;
    }
#else
    void finish(int lane) {
        double* out = rows_.out + row_[lane] * model::STATES;
        for (int i = 0; i < N; ++i) out[model::MOVING_STATE[i]] = element(work_.x[i], lane);
        for (int i = 0; i < model::CLOCKS; ++i) out[model::CLOCK_STATE[i]] = clock_[lane][i];
        report(row_[lane], 0, static_cast<int32_t>(element(taken_, lane)), settings_.step);
    }
#endif

    void fail(int lane, double proposed) {
        int worst = 0;
        double largest = -1.0;
        for (int i = 0; i < N; ++i) {
            const double scaled = __builtin_fabs(element(work_.k[5][i], lane) * element(work_.weight[i], lane));
            if (!finite(scaled)) {
                worst = i;
                break;
            }
            if (scaled > largest) largest = scaled, worst = i;
        }
        const int32_t failure = proposed < settings_.smallest ? SUBSTEP_TOO_SMALL : TOO_MANY_SUBSTEPS;
        report(row_[lane], failure * STATUS_STATES + model::MOVING_STATE[worst], static_cast<int32_t>(element(taken_, lane)),
               settings_.step - element(remaining_, lane));
    }
};

template <class V> void run_rows(const Settings& settings, const Rows& rows, std::atomic<int64_t>& next) {
    Stepper<V> stepper(settings, rows, next);
    stepper.run();
}

}  // namespace glb
