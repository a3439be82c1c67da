// How long a trace takes to write and to read back, in the core alone: `bench_trace FILE [SAMPLES]` prints seconds.
// tests/runtime/trace_figures.py sets the official packages beside it.
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "trace_file.h"

using namespace palmar;

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: bench_trace FILE [SAMPLES]\n");
    return 2;
  }
  const long count = argc > 2 ? std::atol(argv[2]) : 1'000'000;
  Trace trace;
  trace.header = {{"device", "bench"}, {"hand", "none"}, {"side", "right"}};
  trace.samples.resize(std::size_t(count));
  for (long i = 0; i < count; ++i) {
    Sample& s = trace.samples[std::size_t(i)];
    s.time_s = 1e-3 * double(i);
    s.pose.palm.position_m = {std::sin(0.001 * double(i)), 0.1, 0.2};
    for (std::size_t k = 0; k < 15; ++k) s.pose.flexion_rad[k] = std::sin(0.01 * double(i) + double(k));
  }
  const auto seconds = [](auto call) {
    const auto start = std::chrono::steady_clock::now();
    call();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  };
  const double write_s = seconds([&] { write_trace(argv[1], trace); });
  std::size_t read = 0;
  const double read_s = seconds([&] { read = read_trace(argv[1]).samples.size(); });
  std::printf("{\"samples\": %zu, \"write_s\": %.6f, \"read_s\": %.6f}\n", read, write_s, read_s);
  return read == std::size_t(count) ? 0 : 1;
}
