// Steps rows from a file with the generated kernel, for processors on which no Python runs: arm_driver IN OUT.
//
// IN:  rows, steps, parameters, rows a call (int64); glb::Settings; parameters; states; then for each step controls and weather.
// OUT: for each step the states, statuses and substeps of all rows.
#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include "kernel.cpp"

template <class T> static std::vector<T> read(std::FILE* file, int64_t n) {
    std::vector<T> values(n);
    if (std::fread(values.data(), sizeof(T), n, file) != static_cast<size_t>(n)) std::exit(3);
    return values;
}
template <class T> static void write(std::FILE* file, const std::vector<T>& values) {
    if (std::fwrite(values.data(), sizeof(T), values.size(), file) != values.size()) std::exit(4);
}

int main(int, char** names) {
    std::FILE *in = std::fopen(names[1], "rb"), *out = std::fopen(names[2], "wb");
    if (in == nullptr || out == nullptr) return 2;
    const auto head = read<int64_t>(in, 4);
    const int64_t n = head[0], a_call = head[3];
    const auto settings = read<glb::Settings>(in, 1);
    const auto p = read<double>(in, head[2]);
    auto x = read<double>(in, n * glb::model::STATES);
    std::vector<int32_t> status(n), substeps(n);
    std::vector<double> reached(n);
    for (int64_t step = 0; step < head[1]; ++step) {
        const auto u = read<double>(in, n * glb::model::CONTROLS), d = read<double>(in, n * glb::model::DISTURBANCES);
        for (int64_t first = 0; first < n; first += a_call) {
            glb::Rows rows{};
            rows.n = std::min(a_call, n - first);
            rows.out = x.data() + first * glb::model::STATES;
            rows.x = rows.out;
            rows.u = u.data() + first * glb::model::CONTROLS;
            rows.d = d.data() + first * glb::model::DISTURBANCES;
            rows.p = p.data();
            rows.status = status.data() + first;
            rows.substeps = substeps.data() + first;
            rows.reached = reached.data() + first;
            glb_step_rows(settings.data(), &rows);
        }
        write(out, x);
        write(out, status);
        write(out, substeps);
    }
    return std::fclose(out);
}
