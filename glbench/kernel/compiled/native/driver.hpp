// The library's functions that step rows, and the threads that share them.
#pragma once
#include <system_error>
#include <thread>
#include <vector>

#include "stepper.hpp"

#if defined(GLB_WIDTH)
constexpr int BATCH_WIDTH = GLB_WIDTH;
#else
constexpr int BATCH_WIDTH = glb::NATIVE_WIDTH;
#endif
using BatchLanes = typename glb::VectorOf<BATCH_WIDTH>::type;

// Runs `task` in as many threads as are worth starting: each should have so many rows to itself, usually a vector of them.
template <class Task> void in_threads(const glb::Settings& settings, int64_t rows, const Task& task, int64_t each = BATCH_WIDTH) {
    const int64_t useful = rows / each;
    const int64_t threads = settings.threads < useful ? settings.threads : useful;
    std::vector<std::thread> others;
    try {
        for (int64_t k = 1; k < threads; ++k) others.emplace_back([&] { task(); });
    } catch (const std::system_error&) {  // no more threads to be had: those that run take the rows
    }
    task();
    for (auto& thread : others) thread.join();
}

static void step_rows(const glb::Settings* settings, const glb::Rows* rows) {
    std::atomic<int64_t> next{0};
    if (rows->n == 1) return glb::run_rows<double>(*settings, *rows, next);
    in_threads(*settings, rows->n, [&] { glb::run_rows<BatchLanes>(*settings, *rows, next); });
}

// Gives the number of rows that have a status other than 0.
extern "C" int64_t glb_step_rows(const glb::Settings* settings, glb::Rows* rows) {
    step_rows(settings, rows);
    rows->failed = 0;
    for (int64_t row = 0; row < rows->n; ++row) rows->failed += rows->status[row] != 0;
    return rows->failed;
}

// Sizes of this library, compared with the caller's before the first call.
extern "C" void glb_layout(int64_t* sizes) {
    sizes[0] = sizeof(glb::Settings);
    sizes[1] = sizeof(glb::Rows);
    sizes[2] = glb::model::STATES;
    sizes[3] = glb::model::CONTROLS;
    sizes[4] = glb::model::DISTURBANCES;
    sizes[5] = glb::model::PARAMETERS;
    sizes[6] = BATCH_WIDTH;
}
