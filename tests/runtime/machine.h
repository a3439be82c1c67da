// The clock that figures are taken with, quantiles, and what machine they came from.
#pragma once

#include <time.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

namespace palmar::made {

// CPU time of this thread, microseconds.
inline double thread_us() {
  timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e6 * double(t.tv_sec) + 1e-3 * double(t.tv_nsec);
}

// The smallest value with at least a share `q` of the values at or below it. Reorders them.
inline double quantile(std::vector<double>& values, double q) {
  if (values.empty()) return 0;
  const std::size_t n = values.size(), i = std::min(n - 1, std::size_t(std::max(0.0, std::ceil(q * double(n)) - 1)));
  std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(i), values.end());
  return values[i];
}

inline std::string machine() {
  std::string model = "unknown processor", line;
  std::ifstream info("/proc/cpuinfo");
  while (std::getline(info, line))
    if (line.rfind("model name", 0) == 0) {
      model = line.substr(line.find(':') + 2);
      break;
    }
#if defined(__x86_64__) && defined(__GNUC__)
  __builtin_cpu_init();
  const char* wide = __builtin_cpu_supports("avx512f") ? "AVX-512" : __builtin_cpu_supports("avx2") ? "AVX2" : "SSE2";
#else
  const char* wide = "portable";
#endif
  return model + ", wide loops as " + wide + ", " + PALMAR_COMPILER + ", " + PALMAR_BUILD_TYPE;
}

}  // namespace palmar::made
