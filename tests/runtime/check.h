// The whole test framework: CHECK counts and prints, finish() is what main returns.
#pragma once

#include <cstdio>

inline int checks_failed = 0;
inline int checks_passed = 0;

#define CHECK(condition)                                                    \
  do {                                                                      \
    if (condition) {                                                        \
      ++checks_passed;                                                      \
    } else {                                                                \
      ++checks_failed;                                                      \
      std::printf("%s:%d: not true: %s\n", __FILE__, __LINE__, #condition); \
    }                                                                       \
  } while (0)

// Prints both numbers when |a - b| > tolerance (or either is not a number).
#define CHECK_NEAR(a, b, tolerance)                                                       \
  do {                                                                                    \
    const double a_ = (a), b_ = (b);                                                      \
    if (a_ - b_ <= (tolerance) && b_ - a_ <= (tolerance)) {                               \
      ++checks_passed;                                                                    \
    } else {                                                                              \
      ++checks_failed;                                                                    \
      std::printf("%s:%d: %s = %.17g, %s = %.17g\n", __FILE__, __LINE__, #a, a_, #b, b_); \
    }                                                                                     \
  } while (0)

inline int finish() {
  std::printf("%d passed, %d failed\n", checks_passed, checks_failed);
  return checks_failed == 0 && checks_passed > 0 ? 0 : 1;
}
