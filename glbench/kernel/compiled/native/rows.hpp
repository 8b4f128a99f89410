// What a caller hands over: settings of the step-size control, rows to step, and who attends to them.
#pragma once
#include <cstdint>

#include "model.hpp"

namespace glb {

enum Method : int32_t { RODAS4P2 = 0, GRK4T = 1 };

struct Settings {
    double step;                     // length of the control step [s]
    double first;                    // first substep [s]
    double fast_error_floor;         // the least factor on the squared errors of fast states
    double singular_error_factor;    // factor on the squared errors of a substep near the singular difference
    double fast_time_constant;       // time in which an error of a fast state fades to 1/e [s]
    double last;                     // no substep goes on from before these last seconds of the step into them [s]
    double smallest;                 // a substep below this fails the step [s]
    double most;                     // more substeps than this fail the step
    double absolute[model::STATES];  // tolerance of a state is absolute + relative |x| [unit of the state]
    double relative[model::STATES];
    int32_t threads;
    int32_t method;                  // a Method
};

// Rows of the caller, all C-contiguous; stride 0 shares one parameter vector among the rows.
struct Rows {
    int64_t n;
    const double *x, *u, *d, *p;
    int64_t p_stride;
    double* out;        // may be x itself
    int32_t* status;    // 0, or failure*STATUS_STATES + state
    int32_t* substeps;  // taken, rejected ones included
    double* reached;    // time within the step that was reached [s]
    int64_t failed;     // given back: how many rows have a status other than 0
};

// Inputs of one row.
struct Inputs { const double *x, *u, *d, *p; };

// Somebody who gets a row's inputs ready when its turn comes, and is told when the row is done.
class RowWork {
  public:
    virtual bool begin(int64_t row, Inputs& in) = 0;  // false: the row is not stepped
    virtual void end(int64_t row) = 0;

  protected:
    ~RowWork() = default;
};

enum Failure : int32_t { INPUT_NOT_FINITE = 1, TOO_MANY_SUBSTEPS = 2, SUBSTEP_TOO_SMALL = 3, EQUIPMENT_PRESENT = 4, FOLLOWER_NOT_FINITE = 5 };
constexpr int STATUS_STATES = 1 << 16, NO_STATE = STATUS_STATES - 1;

}  // namespace glb
