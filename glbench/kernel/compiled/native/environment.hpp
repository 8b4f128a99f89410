// Whole environment steps: actions in, observations and quantities out, the kernel's step in between.
//
// What a task is made of comes as data, a `Program`. A row's parameters are drawn when the stepper takes the row, and the row is
// looked at when its step is done, in the thread that stepped it; a vector of rows is looked at together, which changes no bit.
#pragma once
#include "driver.hpp"
#include "philox.hpp"
#include "tape.hpp"

namespace glb {

// Whole rows of a table of float32 that are observed as they are: `count` numbers from row `row` on, at column `at`.
struct Lookup {
    const float* table;
    int64_t width, count, at;
    int64_t clocked;  // 1: the row is that of the clock; 0: that of the weather shown
    int64_t ahead;    // rows after it
};

// Values from outside, one row an environment, and the bounds they must keep.
struct Reader {
    int64_t count;
    const double *lowest, *highest;  // what is accepted
    const double *low, *high;        // what is made of it
};

struct Program {
    Tape actuation;  // actions, controls -> controls
    Tape followers;  // drawn parameters -> parameters that follow from them
    Tape outcome;    // before, after, controls, clock, counter -> table, observations
    Reader actions, controls;
    int64_t steps;           // of an episode
    const double* weather;   // rows of disturbances, row k acts on step k
    const double* clock;     // rows of hour of day and day of year
    int64_t lag;             // 1 when the weather shown is the row that has just acted
    const double* nominal;   // parameters
    int64_t drawn;           // how many of them are drawn
    const int32_t* place;    // which
    double half_width;
    int64_t once;            // 1 when they are drawn once an episode
    int64_t lookups;
    const Lookup* lookup;
    int64_t columns;         // of an observation
    int64_t width, head;     // columns of the table; those before `head` are no quantities of a step
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
    const uint64_t* key;   // of the draws, two words
    const double *given, *given_controls;  // actions, or controls that are applied as they are
    double* table;
    float* observations;
    int32_t *status, *substeps;
    double* reached;
    int64_t failed, over;  // given back: rows that failed in this step, rows that have ended
    int64_t refused;       // given back: 1 when a value given is out of bounds, and nothing was done
};

enum Source : int32_t { OF_GIVEN, OF_CONTROLS, OF_DRAWN, OF_BEFORE, OF_AFTER, OF_CLOCK, OF_COUNTER };
enum Target : int32_t { TO_CONTROLS, TO_PARAMETERS, TO_TABLE, TO_OBSERVATION };

// The work on single rows, with memory of its own: each thread has one.
template <class V> class Attendant final : public RowWork {
  public:
    Attendant(const Program& program, Environments& all) : program_(program), all_(all) {
        if (program.drawn > 0) std::memcpy(p_, program.nominal, sizeof p_);
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
        in = {all_.x + row * model::STATES, all_.next + row * model::CONTROLS,
              program_.weather + all_.k[row] * model::DISTURBANCES, program_.drawn > 0 ? p_ : program_.nominal};
        return true;
    }

    void end(int64_t row) override {
        pending_[waiting_++] = row;
        if (waiting_ == W) look();
    }

    // Looks at the rows that wait.
    void look() {
        if (waiting_ == 0) return;
        for (int lane = waiting_; lane < W; ++lane) pending_[lane] = pending_[0];
        for (int lane = 0; lane < waiting_; ++lane) count(pending_[lane]);
        const Tape& tape = program_.outcome;
        gather(tape);
        evaluate(tape, r_);
        for (int lane = 0; lane < waiting_; ++lane) write(tape, pending_[lane], lane);
        waiting_ = 0;
    }

    // Without a step: what there is to observe now.
    void look_at_all() {
        standing_ = true;
        for (int64_t row = 0; row < all_.n; ++row) end(row);
        look();
    }

    // The controls of the next step from what was given; false when a value is out of bounds.
    bool act(bool directly) {
        const Reader& reader = directly ? program_.controls : program_.actions;
        given_ = directly ? all_.given_controls : all_.given;
        for (int64_t row = 0; row < all_.n; ++row)
            if (!all_.ended[row] && !accepted(reader, given_ + row * reader.count)) return false;
        for (int64_t first = 0; first < all_.n; first += W) {
            const int rows = all_.n - first < W ? static_cast<int>(all_.n - first) : W;
            if (!directly) move(reader, first, rows);
            for (int lane = 0; lane < rows; ++lane) settle(reader, first + lane, lane, directly);
        }
        return true;
    }

  private:
    static constexpr int W = width_of<V>;

    const Program& program_;
    Environments& all_;
    alignas(64) double p_[model::PARAMETERS];
    alignas(64) V r_[MOST_REGISTERS];
    const double* given_ = nullptr;
    int64_t pending_[W];
    int waiting_ = 0;
    bool standing_ = false;

    static bool accepted(const Reader& reader, const double* given) {
        bool good = true;  // false for not a number
        for (int64_t j = 0; j < reader.count; ++j) good &= (given[j] >= reader.lowest[j]) & (given[j] <= reader.highest[j]);
        return good;
    }
    // Adding zero makes -0 a 0: which of two zeros is the larger must not matter.
    static double read(const Reader& reader, int64_t j, double given) {
        return minimum_of(maximum_of(given + 0.0, reader.low[j]), reader.high[j]);
    }

    void move(const Reader& reader, int64_t first, int rows) {
        const Tape& tape = program_.actuation;
        for (int64_t i = 0; i < tape.inputs; ++i) {
            const Slot slot = tape.input[i];
            for (int lane = 0; lane < W; ++lane) {
                const int64_t row = first + (lane < rows ? lane : 0);
                const double value = slot.source == OF_CONTROLS ? all_.u[row * model::CONTROLS + slot.index]
                                                                : read(reader, slot.index, given_[row * reader.count + slot.index]);
                set_element(r_[tape.constants + i], lane, value);
            }
        }
        evaluate(tape, r_);
    }

    void settle(const Reader& reader, int64_t row, int lane, bool directly) {
        double* next = all_.next + row * model::CONTROLS;
        if (all_.ended[row]) {
            std::memcpy(next, all_.u + row * model::CONTROLS, model::CONTROLS * sizeof(double));
        } else if (directly) {
            for (int64_t j = 0; j < reader.count; ++j) next[j] = read(reader, j, given_[row * reader.count + j]);
        } else {
            const Tape& tape = program_.actuation;
            for (int64_t i = 0; i < tape.outputs; ++i) next[tape.output[i].index] = element(r_[tape.output[i].reg], lane);
        }
    }

    void draw_parameters(int64_t row) {
        double numbers[DRAW_ROOM];
        const Program& a = program_;
        draw(all_.key + 2 * row, a.once ? 0 : all_.k[row], a.drawn, numbers);
        for (int64_t j = 0; j < a.drawn; ++j)
            p_[a.place[j]] = a.nominal[a.place[j]] * (1.0 + (2.0 * numbers[j] - 1.0) * a.half_width);
        const Tape& tape = a.followers;
        if (tape.outputs == 0) return;
        double r[MOST_REGISTERS];
        for (int64_t i = 0; i < tape.inputs; ++i) r[tape.constants + i] = p_[tape.input[i].index];
        evaluate<double>(tape, r);
        for (int64_t i = 0; i < tape.outputs; ++i) p_[tape.output[i].index] = r[tape.output[i].reg];
    }

    void count(int64_t row) {
        if (!standing_ && !all_.ended[row] && all_.status[row] == 0) ++all_.k[row];
    }
    int64_t shown(int64_t row) const { return all_.k[row] > program_.lag ? all_.k[row] - program_.lag : 0; }

    double counter(int32_t which, int64_t row) const { return static_cast<double>(which == 0 ? all_.k[row] : shown(row)); }

    const double* source(int32_t kind, int64_t row) const {
        switch (kind) {
            case OF_BEFORE: return all_.x + row * model::STATES;
            case OF_AFTER: return (standing_ ? all_.x : all_.after) + row * model::STATES;
            case OF_CONTROLS: return (standing_ ? all_.u : all_.next) + row * model::CONTROLS;
            default: return program_.clock + 2 * all_.k[row];
        }
    }

    void gather(const Tape& tape) {
        for (int64_t i = 0; i < tape.inputs; ++i) {
            const Slot slot = tape.input[i];
            V& to = r_[tape.constants + i];
            for (int lane = 0; lane < W; ++lane) {
                const int64_t row = pending_[lane];
                set_element(to, lane, slot.source == OF_COUNTER ? counter(slot.index, row) : source(slot.source, row)[slot.index]);
            }
        }
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
        for (int64_t i = 0; i < program_.lookups; ++i) {
            const Lookup a = program_.lookup[i];
            const int64_t from = (a.clocked ? all_.k[row] : shown(row)) + a.ahead;
            std::memcpy(observation + a.at, a.table + from * a.width, static_cast<size_t>(a.count) * sizeof(float));
        }
        if (!standing_) conclude(row, table);
    }

    // What a failed step counts instead, nothing for a run that had ended before, and who has ended now.
    void conclude(int64_t row, double* table) {
        if (all_.ended[row]) {
            for (int64_t j = program_.head; j < program_.width; ++j) table[j] = 0.0;
        } else if (all_.status[row] != 0) {
            for (int64_t j = 0; j < program_.charges; ++j) table[program_.charged[j]] = program_.charge[j];
            all_.ended[row] = 1;
        } else {
            all_.ended[row] = all_.k[row] >= program_.steps;
        }
    }
};

template <class V> void attend(const Settings& settings, const Program& program, Environments& all, const Rows& rows, std::atomic<int64_t>& next) {
    Attendant<V> attendant(program, all);
    Stepper<V> stepper(settings, rows, next, &attendant);
    stepper.run();
    attendant.look();
}

template <class V> bool act(const Program& program, Environments& all, bool directly) {
    return Attendant<V>(program, all).act(directly);
}

}  // namespace glb

static void step_environments(const glb::Settings* settings, const glb::Program* program, glb::Environments* all, bool directly) {
    const bool single = all->n == 1;
    all->refused = !(single ? glb::act<double>(*program, *all, directly) : glb::act<BatchLanes>(*program, *all, directly));
    if (all->refused) return;
    const glb::Rows rows = {all->n, all->x, all->next, nullptr, nullptr, 0, all->after, all->status, all->substeps, all->reached, 0};
    std::atomic<int64_t> next{0};
    if (single) glb::attend<double>(*settings, *program, *all, rows, next);
    else in_threads(*settings, all->n, [&] { glb::attend<BatchLanes>(*settings, *program, *all, rows, next); });
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
    if (call->request == OBSERVE) glb::Attendant<BatchLanes>(*call->program, *all).look_at_all();
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
    sizes[4] = glb::model::PARAMETERS;
    sizes[5] = glb::MOST_REGISTERS;
    sizes[6] = glb::MOST_DRAWN;
}
