// Numbers that look random and are the same on every machine.
#pragma once

#include <cstdint>

#include "algebra.h"

namespace palmar {

// splitmix64 (Steele, Lea, Flood 2014).
struct Random {
  std::uint64_t state;

  std::uint64_t next() {
    std::uint64_t z = (state += 0x9e3779b97f4a7c15ull);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
  }
  double uniform() { return double(next() >> 11) * 0x1p-53; }
  std::size_t below(std::size_t n) { return std::size_t(uniform() * double(n)); }
  // In the ball of radius 1.
  Vec3 in_ball() {
    for (;;) {
      const double x = 2 * uniform() - 1, y = 2 * uniform() - 1, z = 2 * uniform() - 1;
      if (x * x + y * y + z * z <= 1) return {x, y, z};
    }
  }
};

}  // namespace palmar
