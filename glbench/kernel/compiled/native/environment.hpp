// Whole environment steps: actions in, observations and quantities out, the kernel's step in between.
//
// What a task is made of comes as data, a `Program`. A row's parameters are drawn when the stepper takes the row, and the row is
// looked at when its step is done, in the thread that stepped it; a vector of rows is looked at together, which changes no bit.
// Each row has a scenario of its own: the days of its weather, where its calendar begins, its parameters, keys, traits and memory.
#pragma once
#include "driver.hpp"
#include "philox.hpp"
#include "tape.hpp"

namespace glb {

// Whole rows of a table of float32 that are observed as they are: `count` of them from row `ahead` on, at column `at`.
struct Lookup {
    const float* table;
    int64_t width, count, at;
    int64_t clocked;  // 1: the row is that of the calendar; 0: that of the weather shown
    int64_t numbered; // 1: instead, the number of the row is in column `at`
    int64_t ahead;    // rows after it
    int64_t every;    // rows of the pool that share a row of the table
};

// Bounds of values from outside, one row an environment.
struct ActionBounds {
    int64_t count;
    const double *lowest, *highest;  // what is accepted
    const double *low, *high;        // what is made of it
};

// Parameters that are drawn together, anew every `every` steps.
struct ParameterNoise {
    int64_t count;
    const int32_t* place;
    double half_width;
    int64_t every;
};

struct Program {
    Tape actuation;  // before the step -> controls, memory
    Tape followers;  // drawn parameters -> parameters that follow from them
    Tape update;     // after the step -> memory
    Tape outcome;    // after that, or standing still -> table, observations
    ActionBounds actions, controls;
    int64_t steps;           // of an episode
    const double* weather;   // pool of rows of disturbances
    int64_t day;             // rows a day
    const double* calendar;  // pool of calendar rows
    int64_t calendar_width;
    int64_t lag;             // 1 when the weather shown is the row that has just acted
    int64_t drawn;           // groups of parameters that are drawn in the step
    const ParameterNoise* group;
    int64_t streams;         // of noise
    const int64_t* numbers;  // of each of them in a step
    int64_t traits, memory;  // of a row
    int64_t lookups;
    const Lookup* lookup;
    int64_t columns;         // of an observation
    int64_t width, info_columns;  // columns of the table; those before `info_columns` are no quantities of a step
    int64_t charges;         // what a failed step counts, in columns of the table
    const int32_t* charged;
    const double* charge;
};

// The environments: n rows of everything, C-contiguous.
struct Environments {
    int64_t n;
    double *x, *after;     // states now, and after the step
    double *u, *next;      // controls now, and during the step
    int64_t* k;            // steps taken
    uint8_t* ended;
    const uint64_t* key;   // two words for each group and stream
    const int64_t* days;   // rows of the weather's pool where the row's days begin
    int64_t days_stride;
    const int64_t* first;  // row of the calendar at the start
    const double* p;       // parameters
    int64_t p_stride;      // 0 when all rows share them
    const double* traits;
    double* memory;
    const double *given, *given_controls;  // actions, or controls that are applied as they are
    double* table;
    float* observations;
    int32_t *status, *substeps;
    double* reached;
    int64_t failed, over;  // given back: rows that failed in this step, rows that have ended
    int64_t refused;       // given back: 1 when a value given is out of bounds, and nothing was done
};

enum Source : int32_t {
    OF_GIVEN, OF_CONTROLS, OF_DRAWN, OF_BEFORE, OF_AFTER, OF_CALENDAR, OF_COUNTER, OF_CALENDAR_BEFORE, OF_WEATHER, OF_NOISE, OF_TRAIT, OF_MEMORY,
    OF_CONTROLS_BEFORE, OF_WEATHER_BEFORE
};
enum Target : int32_t { TO_CONTROLS, TO_PARAMETERS, TO_TABLE, TO_OBSERVATION, TO_MEMORY };

inline bool reads_noise(const Tape& tape) {
    for (int64_t i = 0; i < tape.inputs; ++i)
        if (tape.input[i].source == OF_NOISE) return true;
    return false;
}

// The work on single rows, with memory of its own: each thread has one.
template <class V> class EnvironmentWorker final : public RowWork {
  public:
    EnvironmentWorker(const Program& program, Environments& all)
        : program_(program), all_(all), shared_(all.p_stride == 0), noisy_after_(reads_noise(program.update) || reads_noise(program.outcome)) {
        if (program.drawn > 0 && shared_) std::memcpy(p_, all.p, sizeof p_);
    }

    // The inputs of a row; false for one that has ended and stays as it is.
    bool begin(int64_t row, Inputs& in) override {
        if (all_.ended[row]) {
            const int64_t first = row * model::STATES;
            std::memcpy(all_.after + first, all_.x + first, model::STATES * sizeof(double));
            all_.status[row] = 0;
            end(row);
            return false;
        }
        if (program_.drawn > 0) draw_parameters(row);
        in = {all_.x + row * model::STATES, all_.next + row * model::CONTROLS, program_.weather + weather_row(row, all_.k[row]) * model::DISTURBANCES,
              program_.drawn > 0 ? p_ : all_.p + row * all_.p_stride};
        return true;
    }

    void end(int64_t row) override {
        pending_[waiting_++] = row;
        if (waiting_ == W) observe();
    }

    // Observes the rows that wait.
    void observe() {
        if (waiting_ == 0) return;
        for (int lane = waiting_; lane < W; ++lane) pending_[lane] = pending_[0];
        for (int lane = 0; lane < waiting_; ++lane) count(lane);
        for (int lane = waiting_; lane < W; ++lane) taken_[lane] = taken_[0];
        if (noisy_after_) draw_noise();
        if (program_.update.outputs > 0 && !standing_) remember();
        const Tape& tape = program_.outcome;
        gather(tape);
        evaluate(tape, r_);
        for (int lane = 0; lane < waiting_; ++lane) write(tape, pending_[lane], lane);
        waiting_ = 0;
    }

    // Without a step: what there is to observe now.
    void observe_all() {
        standing_ = true;
        for (int64_t row = 0; row < all_.n; ++row) end(row);
        observe();
    }

    // The controls of the next step from what was given; false when a value is out of bounds.
    bool act(bool directly) {
        const ActionBounds& bounds = directly ? program_.controls : program_.actions;
        given_ = directly ? all_.given_controls : all_.given;
        for (int64_t row = 0; row < all_.n; ++row)
            if (!all_.ended[row] && !accepted(bounds, given_ + row * bounds.count)) return false;
        standing_ = true;  // what tapes read is that of now
        const bool noisy = !directly && reads_noise(program_.actuation);
        for (int64_t first = 0; first < all_.n; first += W) {
            const int rows = all_.n - first < W ? static_cast<int>(all_.n - first) : W;
            if (!directly) move(bounds, first, rows, noisy);
            for (int lane = 0; lane < rows; ++lane) settle(bounds, first + lane, lane, directly);
        }
        return true;
    }

  private:
    static constexpr int W = width_of<V>;

    const Program& program_;
    Environments& all_;
    const bool shared_, noisy_after_;
    alignas(64) double p_[model::PARAMETERS];
    alignas(64) V r_[MOST_REGISTERS];
    double noise_[W][DRAW_ROOM];
    const double* given_ = nullptr;
    int64_t pending_[W];
    bool taken_[W];
    int waiting_ = 0;
    bool standing_ = false;

    static bool accepted(const ActionBounds& bounds, const double* given) {
        bool good = true;  // false for not a number
        for (int64_t j = 0; j < bounds.count; ++j) good &= (given[j] >= bounds.lowest[j]) & (given[j] <= bounds.highest[j]);
        return good;
    }
    // Adding zero makes -0 a 0: which of two zeros is the larger must not matter.
    static double read(const ActionBounds& bounds, int64_t j, double given) {
        return minimum_of(maximum_of(given + 0.0, bounds.low[j]), bounds.high[j]);
    }

    void move(const ActionBounds& bounds, int64_t first, int rows, bool noisy) {
        const Tape& tape = program_.actuation;
        if (noisy)
            for (int lane = 0; lane < rows; ++lane) draw_noise(first + lane, noise_[lane]);
        for (int64_t i = 0; i < tape.inputs; ++i) {
            const Slot slot = tape.input[i];
            for (int lane = 0; lane < W; ++lane) {
                const int from = lane < rows ? lane : 0;
                const int64_t row = first + from;
                double value;
                if (slot.source == OF_CONTROLS) value = all_.u[row * model::CONTROLS + slot.index];
                else if (slot.source == OF_GIVEN) value = read(bounds, slot.index, given_[row * bounds.count + slot.index]);
                else if (slot.source == OF_WEATHER) value = program_.weather[weather_row(row, all_.k[row]) * model::DISTURBANCES + slot.index];
                else value = value_of(slot, row, from);
                set_element(r_[tape.constants + i], lane, value);
            }
        }
        evaluate(tape, r_);
    }

    void settle(const ActionBounds& bounds, int64_t row, int lane, bool directly) {
        double* next = all_.next + row * model::CONTROLS;
        if (all_.ended[row]) {
            std::memcpy(next, all_.u + row * model::CONTROLS, model::CONTROLS * sizeof(double));
        } else if (directly) {
            for (int64_t j = 0; j < bounds.count; ++j) next[j] = read(bounds, j, given_[row * bounds.count + j]);
        } else {
            const Tape& tape = program_.actuation;
            double* memory = all_.memory + row * program_.memory;
            for (int64_t i = 0; i < tape.outputs; ++i) {
                const Sink sink = tape.output[i];
                (sink.target == TO_MEMORY ? memory : next)[sink.index] = element(r_[sink.reg], lane);
            }
        }
    }

    const uint64_t* key(int64_t row, int64_t stream) const { return all_.key + 2 * (row * (program_.drawn + program_.streams) + stream); }

    void draw_parameters(int64_t row) {
        double numbers[DRAW_ROOM];
        const double* base = all_.p + row * all_.p_stride;
        if (!shared_) std::memcpy(p_, base, sizeof p_);
        for (int64_t g = 0; g < program_.drawn; ++g) {
            const ParameterNoise a = program_.group[g];
            draw(key(row, g), a.every == 1 ? all_.k[row] : all_.k[row] / a.every, a.count, numbers);
            for (int64_t j = 0; j < a.count; ++j) p_[a.place[j]] = base[a.place[j]] * (1.0 + (2.0 * numbers[j] - 1.0) * a.half_width);
        }
        const Tape& tape = program_.followers;
        if (tape.outputs == 0) return;
        double r[MOST_REGISTERS];
        for (int64_t i = 0; i < tape.inputs; ++i) r[tape.constants + i] = p_[tape.input[i].index];
        evaluate<double>(tape, r);
        for (int64_t i = 0; i < tape.outputs; ++i) p_[tape.output[i].index] = r[tape.output[i].reg];
    }

    // The numbers of all streams in the step of a row, side by side.
    void draw_noise(int64_t row, double* numbers) const {
        for (int64_t s = 0; s < program_.streams; ++s) {
            draw(key(row, program_.drawn + s), all_.k[row], program_.numbers[s], numbers);
            numbers += program_.numbers[s];
        }
    }
    void draw_noise() {
        for (int lane = 0; lane < waiting_; ++lane) draw_noise(pending_[lane], noise_[lane]);
    }

    void count(int lane) {
        const int64_t row = pending_[lane];
        taken_[lane] = !standing_ && !all_.ended[row] && all_.status[row] == 0;
        if (taken_[lane]) ++all_.k[row];
    }
    // The step that was taken, or the next one.
    int64_t begun(int64_t row, int lane) const { return standing_ || !taken_[lane] ? all_.k[row] : all_.k[row] - 1; }
    int64_t shown(int64_t row) const { return all_.k[row] > program_.lag ? all_.k[row] - program_.lag : 0; }

    // Row of the pool that is the weather of a step.
    int64_t weather_row(int64_t row, int64_t step) const {
        return all_.days[row * all_.days_stride + step / program_.day] + step % program_.day;
    }
    const double* calendar(int64_t row, int64_t step) const { return program_.calendar + (all_.first[row] + step) * program_.calendar_width; }

    double value_of(Slot slot, int64_t row, int lane) const {
        switch (slot.source) {
            case OF_BEFORE: return all_.x[row * model::STATES + slot.index];
            case OF_AFTER: return (standing_ ? all_.x : all_.after)[row * model::STATES + slot.index];
            case OF_CONTROLS: return (standing_ ? all_.u : all_.next)[row * model::CONTROLS + slot.index];
            case OF_CALENDAR: return calendar(row, all_.k[row])[slot.index];
            case OF_CALENDAR_BEFORE: return calendar(row, begun(row, lane))[slot.index];
            case OF_WEATHER_BEFORE: return program_.weather[weather_row(row, begun(row, lane)) * model::DISTURBANCES + slot.index];
            case OF_COUNTER: return static_cast<double>(slot.index == 0 ? all_.k[row] : shown(row));
            case OF_WEATHER: return program_.weather[weather_row(row, shown(row)) * model::DISTURBANCES + slot.index];
            case OF_NOISE: return noise_[lane][slot.index];
            case OF_CONTROLS_BEFORE: return all_.u[row * model::CONTROLS + slot.index];
            case OF_TRAIT: return all_.traits[row * program_.traits + slot.index];
            default: return all_.memory[row * program_.memory + slot.index];
        }
    }

    void gather(const Tape& tape) {
        for (int64_t i = 0; i < tape.inputs; ++i) {
            const Slot slot = tape.input[i];
            V& to = r_[tape.constants + i];
            for (int lane = 0; lane < W; ++lane) set_element(to, lane, value_of(slot, pending_[lane], lane < waiting_ ? lane : 0));
        }
    }

    // What rows that took a step keep for the next one.
    void remember() {
        const Tape& tape = program_.update;
        gather(tape);
        evaluate(tape, r_);
        for (int lane = 0; lane < waiting_; ++lane)
            if (taken_[lane])
                for (int64_t i = 0; i < tape.outputs; ++i)
                    all_.memory[pending_[lane] * program_.memory + tape.output[i].index] = element(r_[tape.output[i].reg], lane);
    }

    void write(const Tape& tape, int64_t row, int lane) {
        double* table = all_.table + row * program_.width;
        float* observation = all_.observations + row * program_.columns;
        for (int64_t i = 0; i < tape.outputs; ++i) {
            const Sink sink = tape.output[i];
            const double value = element(r_[sink.reg], lane);
            if (sink.target == TO_TABLE) table[sink.index] = value;
            else observation[sink.index] = static_cast<float>(value);
        }
        for (int64_t i = 0; i < program_.lookups; ++i) look_up(program_.lookup[i], row, observation + program_.lookup[i].at);
        if (!standing_) conclude(row, table);
    }

    void look_up(const Lookup& a, int64_t row, float* to) const {
        const auto copy = [&](int64_t from, int64_t rows) {
            std::memcpy(to, a.table + from / a.every * a.width, static_cast<size_t>(rows * a.width) * sizeof(float));
            to += rows * a.width;
        };
        if (a.numbered) return copy(*to >= 0.0f ? static_cast<int64_t>(*to) : 0, 1);  // not a number: the first row
        if (a.clocked) return copy(all_.first[row] + all_.k[row] + a.ahead, a.count);
        int64_t step = shown(row) + a.ahead;
        for (int64_t left = a.count; left > 0;) {  // day by day: the next one may lie anywhere in the pool
            const int64_t rest = program_.day - step % program_.day, rows = left < rest ? left : rest;
            copy(weather_row(row, step), rows);
            step += rows;
            left -= rows;
        }
    }

    // What a failed step counts instead, nothing for a run that had ended before, and who has ended now.
    void conclude(int64_t row, double* table) {
        if (all_.ended[row]) {
            for (int64_t j = program_.info_columns; j < program_.width; ++j) table[j] = 0.0;
        } else if (all_.status[row] != 0) {
            for (int64_t j = 0; j < program_.charges; ++j) table[program_.charged[j]] = program_.charge[j];
            all_.ended[row] = 1;
        } else {
            all_.ended[row] = all_.k[row] >= program_.steps;
        }
    }
};

template <class V> void run_worker(const Settings& settings, const Program& program, Environments& all, const Rows& rows, std::atomic<int64_t>& next) {
    EnvironmentWorker<V> worker(program, all);
    Stepper<V> stepper(settings, rows, next, &worker);
    stepper.run();
    worker.observe();
}

template <class V> bool act(const Program& program, Environments& all, bool directly) {
    return EnvironmentWorker<V>(program, all).act(directly);
}

}  // namespace glb

static void step_environments(const glb::Settings* settings, const glb::Program* program, glb::Environments* all, bool directly) {
    const bool single = all->n == 1;
    all->refused = !(single ? glb::act<double>(*program, *all, directly) : glb::act<BatchLanes>(*program, *all, directly));
    if (all->refused) return;
    const glb::Rows rows = {all->n, all->x, all->next, nullptr, nullptr, 0, all->after, all->status, all->substeps, all->reached, 0};
    std::atomic<int64_t> next{0};
    if (single) glb::run_worker<double>(*settings, *program, *all, rows, next);
    else in_threads(*settings, all->n, [&] { glb::run_worker<BatchLanes>(*settings, *program, *all, rows, next); });
    std::swap(all->x, all->after);
    std::swap(all->u, all->next);
    all->failed = 0;
    for (int64_t row = 0; row < all->n; ++row) all->failed += all->status[row] != 0;
}

enum Request : int64_t { ACTIONS, CONTROLS, OBSERVE };

// One pointer for a call: the caller sets it once.
struct EnvironmentCall {
    const glb::Settings* settings;
    const glb::Program* program;
    glb::Environments* all;
    int64_t request;
};

extern "C" void glb_environment(const EnvironmentCall* call) {
    glb::Environments* all = call->all;
    if (call->request == OBSERVE) glb::EnvironmentWorker<BatchLanes>(*call->program, *all).observe_all();
    else step_environments(call->settings, call->program, all, call->request == CONTROLS);
    all->over = 0;
    for (int64_t row = 0; row < all->n; ++row) all->over += all->ended[row];
}

// Sizes of what the caller lays out, compared before the first call.
extern "C" void glb_environment_layout(int64_t* sizes) {
    sizes[0] = sizeof(glb::Program);
    sizes[1] = sizeof(glb::Environments);
    sizes[2] = sizeof(EnvironmentCall);
    sizes[3] = sizeof(glb::Lookup);
    sizes[4] = sizeof(glb::ParameterNoise);
    sizes[5] = glb::model::PARAMETERS;
    sizes[6] = glb::MOST_REGISTERS;
    sizes[7] = glb::MOST_DRAWN;
}
