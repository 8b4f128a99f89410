// The compiled environments as XLA custom calls: states in, states out, nothing remembered from call to call.
//
// A door is one task with its scenarios, opened by name from Python (glbench/jax/door.py). A call works on as many rows as its operands
// have. What a row's scenario fixes is copied beside the row, and kept there for the next call that finds the same scenario in that place.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

namespace {

// As in glbench/kernel/compiled/native/environment.hpp; sizes are compared when a door is opened.
struct Environments {
    int64_t n;
    double *x, *after;
    double *u, *next;
    int64_t* k;
    uint8_t* ended;
    const uint64_t* key;
    const int64_t* days;
    int64_t days_stride;
    const int64_t* first;
    const double* p;
    int64_t p_stride;
    const double* traits;
    double* memory;
    const double *given, *given_controls;
    double* table;
    float* observations;
    int32_t *status, *substeps;
    double* reached;
    int64_t failed, over, refused;
};
enum Request : int64_t { ACTIONS, CONTROLS, OBSERVE };
struct EnvironmentCall {
    const void *settings, *program;
    Environments* all;
    int64_t request;
};

// What Python hands in; its arrays live as long as the process.
struct Door {
    void (*run)(const EnvironmentCall*);
    const void *settings, *program;
    int64_t states, controls, actions, memory, keys, days, traits, parameters, columns, width;
    int64_t shared_parameters;  // 1 when all rows have the first row of `parameter`
    int64_t scenarios, places;
    const double *low, *high;       // of actions
    const double* start;            // states at the places where an episode may begin (scenarios, places, states)
    const int64_t* at;              // steps taken there (scenarios, places)
    const int64_t *sequence, *first;
    const uint64_t* key;
    const double *parameter, *trait;
    const double *in_force, *remembered;  // controls before the first step, memory at the start
    int64_t reward;                 // column of the table
    int64_t shown;                  // numbers told besides: columns of the table, and after the table's width those of the state
    const int64_t* show;
};

// Arrays for so many rows, and the scenarios that lie in them.
class Workspace {
  public:
    Workspace(const Door& door, int64_t n)
        : n(n), x(n * door.states), u(n * door.controls), memory(n * door.memory), k(n), ended(n), given(n * door.actions), table(n * door.width),
          status(n), door_(door), after_(x.size()), next_(u.size()), key_(n * door.keys * 2), days_(n * door.days), first_(n),
          parameter_(door.shared_parameters ? 0 : n * door.parameters), trait_(n * door.traits), substeps_(n), reached_(n), scenario_(n, -1) {}

    const int64_t n;
    std::vector<double> x, u, memory;
    std::vector<int64_t> k;
    std::vector<uint8_t> ended;
    std::vector<double> given, table;
    std::vector<int32_t> status;

    void set_scenario(int64_t row, int64_t scenario) {
        if (scenario_[row] == scenario) return;
        scenario_[row] = scenario;
        copy(key_, door_.key, row, scenario, door_.keys * 2);
        copy(days_, door_.sequence, row, scenario, door_.days);
        first_[row] = door_.first[scenario];
        if (!door_.shared_parameters) copy(parameter_, door_.parameter, row, scenario, door_.parameters);
        copy(trait_, door_.trait, row, scenario, door_.traits);
    }

    // An episode begins in a row.
    void begin(int64_t row, int64_t scenario, int64_t place) {
        set_scenario(row, scenario);
        const int64_t from = scenario * door_.places + place;
        copy(x, door_.start, row, from, door_.states);
        copy(u, door_.in_force, row, 0, door_.controls);
        copy(memory, door_.remembered, row, 0, door_.memory);
        k[row] = door_.at[from];
        ended[row] = 0;
    }

    // False when an action was refused. Afterwards `state` and `controls` say where the rows stand.
    bool run(Request request, float* observations) {
        Environments all{n, x.data(), after_.data(), u.data(), next_.data(), k.data(), ended.data(), key_.data(), days_.data(), door_.days, first_.data(),
                         door_.shared_parameters ? door_.parameter : parameter_.data(), door_.shared_parameters ? 0 : door_.parameters, trait_.data(),
                         memory.data(), given.data(), nullptr, table.data(), observations, status.data(), substeps_.data(), reached_.data(), 0, 0, 0};
        const EnvironmentCall call{door_.settings, door_.program, &all, request};
        door_.run(&call);
        state = all.x;
        controls = all.u;
        return !all.refused;
    }

    const double *state = nullptr, *controls = nullptr;

  private:
    const Door& door_;
    std::vector<double> after_, next_;
    std::vector<uint64_t> key_;
    std::vector<int64_t> days_, first_;
    std::vector<double> parameter_, trait_;
    std::vector<int32_t> substeps_;
    std::vector<double> reached_;
    std::vector<int64_t> scenario_;

    template <class T> static void copy(std::vector<T>& to, const T* from, int64_t row, int64_t source, int64_t count) {
        std::copy_n(from + source * count, count, to.begin() + row * count);
    }
};

// An open door, with workspaces that wait for the next call. Calls may come from several threads.
struct Opened {
    explicit Opened(const Door& door) : door(door) {}
    const Door door;

    std::unique_ptr<Workspace> take(int64_t n) {
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            const auto found = std::find_if(idle_.begin(), idle_.end(), [n](const auto& one) { return one->n == n; });
            if (found != idle_.end()) {
                auto taken = std::move(*found);
                idle_.erase(found);
                return taken;
            }
        }
        return std::make_unique<Workspace>(door, n);
    }
    void give_back(std::unique_ptr<Workspace> workspace) {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (idle_.size() == MOST_IDLE) idle_.erase(idle_.begin());
        idle_.push_back(std::move(workspace));
    }

  private:
    static constexpr size_t MOST_IDLE = 16;
    std::mutex mutex_;
    std::vector<std::unique_ptr<Workspace>> idle_;
};

std::mutex opened_mutex;
std::unordered_map<std::string, std::unique_ptr<Opened>> opened;

Opened* find(std::string_view name) {
    const std::lock_guard<std::mutex> lock(opened_mutex);
    const auto found = opened.find(std::string(name));
    return found == opened.end() ? nullptr : found->second.get();
}

ffi::Error unknown(std::string_view name) {
    return ffi::Error(ffi::ErrorCode::kNotFound, "glbench: there is no environment " + std::string(name) + " in this process. Make it with glbench.jax.Environment first.");
}

// Numbers in the precision that JAX works with: float64 where 64 bits are switched on, else float32.
double read(const ffi::AnyBuffer& buffer, int64_t at) {
    return buffer.element_type() == ffi::DataType::F64 ? buffer.typed_data<double>()[at] : static_cast<double>(buffer.typed_data<float>()[at]);
}
void write(ffi::Result<ffi::AnyBuffer>& buffer, int64_t at, double value) {
    if (buffer->element_type() == ffi::DataType::F64) buffer->typed_data<double>()[at] = value;
    else buffer->typed_data<float>()[at] = static_cast<float>(value);
}

using Steps = ffi::Buffer<ffi::S32>;
using Flags = ffi::Buffer<ffi::PRED>;
using Words = ffi::Buffer<ffi::U32>;
using Observed = ffi::Buffer<ffi::F32>;

// The state of environments as JAX keeps it: steps taken, scenario, whether it has ended; states, controls and memory as words.
struct State {
    int32_t *step, *scenario;
    bool* ended;
    uint32_t* words;
};

int64_t words_of(const Door& door) { return 2 * (door.states + door.controls + door.memory); }

void load(Workspace& work, const Door& door, int64_t row, const uint32_t* words) {
    words += row * words_of(door);
    std::memcpy(&work.x[row * door.states], words, door.states * sizeof(double));
    words += 2 * door.states;
    std::memcpy(&work.u[row * door.controls], words, door.controls * sizeof(double));
    words += 2 * door.controls;
    if (door.memory) std::memcpy(&work.memory[row * door.memory], words, door.memory * sizeof(double));
}

void store(const Workspace& work, const Door& door, int64_t row, const State& to, int64_t at) {
    to.step[at] = static_cast<int32_t>(work.k[row]);
    to.ended[at] = work.ended[row] != 0;
    uint32_t* words = to.words + at * words_of(door);
    std::memcpy(words, work.state + row * door.states, door.states * sizeof(double));
    words += 2 * door.states;
    std::memcpy(words, work.controls + row * door.controls, door.controls * sizeof(double));
    words += 2 * door.controls;
    if (door.memory) std::memcpy(words, &work.memory[row * door.memory], door.memory * sizeof(double));
}

bool exists(const Door& door, int64_t scenario, int64_t place) { return scenario >= 0 && scenario < door.scenarios && place >= 0 && place < door.places; }

ffi::Error no_scenario(const Door& door, int64_t scenario) {
    return ffi::Error::InvalidArgument("glbench: there is no scenario " + std::to_string(scenario) + ": the environment has " + std::to_string(door.scenarios) +
                                       ". Keep first + count of its parameters within them.");
}

ffi::Error Reset(std::string_view name, Steps scenario, Steps place, ffi::Result<Steps> step, ffi::Result<Flags> ended, ffi::Result<Words> words,
                 ffi::Result<Observed> observation) {
    Opened* open = find(name);
    if (!open) return unknown(name);
    const Door& door = open->door;
    const int64_t n = scenario.element_count();
    for (int64_t row = 0; row < n; ++row)
        if (!exists(door, scenario.typed_data()[row], place.typed_data()[row])) return no_scenario(door, scenario.typed_data()[row]);
    auto work = open->take(n);
    for (int64_t row = 0; row < n; ++row) work->begin(row, scenario.typed_data()[row], place.typed_data()[row]);
    work->run(OBSERVE, observation->typed_data());
    const State to{step->typed_data(), nullptr, ended->typed_data(), words->typed_data()};
    for (int64_t row = 0; row < n; ++row) store(*work, door, row, to, row);
    open->give_back(std::move(work));
    return ffi::Error::Success();
}

// One step of every row. With `autoreset`, rows whose episode has ended begin the scenario `fresh` at its start: their state and observation are those of the new
// episode, all else tells of the step.
ffi::Error Step(std::string_view name, bool autoreset, Steps step, Steps scenario, Flags ended, Words words, ffi::AnyBuffer action, Steps fresh,
                ffi::Result<Steps> next_step, ffi::Result<Steps> next_scenario, ffi::Result<Flags> next_ended, ffi::Result<Words> next_words,
                ffi::Result<Observed> observation, ffi::Result<ffi::AnyBuffer> reward, ffi::Result<Flags> done, ffi::Result<Flags> failed,
                ffi::Result<ffi::AnyBuffer> shown) {
    Opened* open = find(name);
    if (!open) return unknown(name);
    const Door& door = open->door;
    const int64_t n = step.element_count();
    auto work = open->take(n);
    for (int64_t row = 0; row < n; ++row) {
        const int64_t of = scenario.typed_data()[row];
        if (!exists(door, of, 0)) return no_scenario(door, of);
        work->set_scenario(row, of);
        load(*work, door, row, words.typed_data());
        work->k[row] = step.typed_data()[row];
        work->ended[row] = ended.typed_data()[row];
        for (int64_t j = 0; j < door.actions; ++j) {
            const double given = read(action, row * door.actions + j);
            if (!std::isfinite(given) && !work->ended[row])
                return ffi::Error::InvalidArgument("glbench: action " + std::to_string(j) + " of row " + std::to_string(row) + " is " + std::to_string(given) +
                                                   ". Actions are finite numbers.");
            work->given[row * door.actions + j] = std::isfinite(given) ? std::min(std::max(given, door.low[j]), door.high[j]) : door.low[j];
        }
    }
    if (!work->run(ACTIONS, observation->typed_data())) return ffi::Error::Internal("glbench: the compiled step refused actions within their bounds.");
    const State to{next_step->typed_data(), next_scenario->typed_data(), next_ended->typed_data(), next_words->typed_data()};
    std::vector<int64_t> over;
    for (int64_t row = 0; row < n; ++row) {
        store(*work, door, row, to, row);
        to.scenario[row] = scenario.typed_data()[row];
        done->typed_data()[row] = to.ended[row];
        failed->typed_data()[row] = work->status[row] != 0;
        const double* table = &work->table[row * door.width];
        write(reward, row, table[door.reward]);
        for (int64_t j = 0; j < door.shown; ++j) {
            const int64_t column = door.show[j];
            write(shown, row * door.shown + j, column < door.width ? table[column] : work->state[row * door.states + column - door.width]);
        }
        if (autoreset && to.ended[row]) over.push_back(row);
    }
    open->give_back(std::move(work));
    if (over.empty()) return ffi::Error::Success();
    auto anew = open->take(static_cast<int64_t>(over.size()));
    std::vector<float> observed(over.size() * door.columns);
    for (size_t i = 0; i < over.size(); ++i) {
        const int64_t of = fresh.typed_data()[over[i]];
        if (!exists(door, of, 0)) return no_scenario(door, of);
        anew->begin(static_cast<int64_t>(i), of, 0);
        to.scenario[over[i]] = static_cast<int32_t>(of);
    }
    anew->run(OBSERVE, observed.data());
    for (size_t i = 0; i < over.size(); ++i) {
        store(*anew, door, static_cast<int64_t>(i), to, over[i]);
        std::copy_n(observed.begin() + i * door.columns, door.columns, observation->typed_data() + over[i] * door.columns);
    }
    open->give_back(std::move(anew));
    return ffi::Error::Success();
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(glb_door_reset, Reset,
                              ffi::Ffi::Bind().Attr<std::string_view>("name").Arg<Steps>().Arg<Steps>().Ret<Steps>().Ret<Flags>().Ret<Words>().Ret<Observed>());

XLA_FFI_DEFINE_HANDLER_SYMBOL(glb_door_step, Step,
                              ffi::Ffi::Bind()
                                  .Attr<std::string_view>("name")
                                  .Attr<bool>("autoreset")
                                  .Arg<Steps>()
                                  .Arg<Steps>()
                                  .Arg<Flags>()
                                  .Arg<Words>()
                                  .Arg<ffi::AnyBuffer>()
                                  .Arg<Steps>()
                                  .Ret<Steps>()
                                  .Ret<Steps>()
                                  .Ret<Flags>()
                                  .Ret<Words>()
                                  .Ret<Observed>()
                                  .Ret<ffi::AnyBuffer>()
                                  .Ret<Flags>()
                                  .Ret<Flags>()
                                  .Ret<ffi::AnyBuffer>());

// Opens a door under a name, which stays open; a name that is open already is left as it is.
extern "C" void glb_door_open(const char* name, const Door* door) {
    const std::lock_guard<std::mutex> lock(opened_mutex);
    auto& place = opened[name];
    if (!place) place = std::make_unique<Opened>(*door);
}

// Sizes of what Python lays out.
extern "C" void glb_door_layout(int64_t* sizes) {
    sizes[0] = sizeof(Door);
    sizes[1] = sizeof(Environments);
    sizes[2] = sizeof(EnvironmentCall);
}
