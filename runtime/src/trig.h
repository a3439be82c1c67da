// Sine, cosine and arc tangent from sums, products and quotients alone. A C library has several of each and takes one
// by the machine that it runs on; they differ in the last bit, and with it every step.
#pragma once

#include <cmath>
#include <numbers>

namespace palmar {

struct SineCosine {
  double sine, cosine;
};

// Both to within two units in the last place for |x| below 20, three below 1e5. Beyond, some angle's: a turn all the
// same.
inline SineCosine sine_cosine(double x) {
  if (!(std::abs(x) < 1e5)) {
    x = std::remainder(x, 2 * std::numbers::pi);  // exact, of any two doubles
    if (x != x) return {x, x};
  }
  // x = k pi/2 + r. The first two pieces of pi/2 have 33 bits and fewer: k times each is exact.
  constexpr double first = 0x1.921fb544p+0, second = 0x1.0b4611a6p-34, third = 0x1.3198a2e037073p-69;
  constexpr double round = 0x1.8p+52;  // a sum with it keeps no digit behind the point
  const double k = (x * (2 / std::numbers::pi) + round) - round;
  const double r = ((x - k * first) - k * second) - k * third;
  // Taylor's series: what is left out is below 1e-17 at pi/4. In pairs, since each product waits for the one before.
  const double z = r * r, z2 = z * z, z4 = z2 * z2;
  const double s =
      (-1.0 / 6 + (1.0 / 120) * z) + z2 * (-1.0 / 5040 + (1.0 / 362880) * z) +
      z4 * ((-1.0 / 39916800 + (1.0 / 6227020800) * z) + z2 * (-1.0 / 1307674368000 + (1.0 / 355687428096000) * z));
  const double c = (1.0 / 24 - (1.0 / 720) * z) + z2 * (1.0 / 40320 - (1.0 / 3628800) * z) +
                   z4 * ((1.0 / 479001600 - (1.0 / 87178291200) * z) + (1.0 / 20922789888000) * z2);
  const double sine = r + r * z * s, cosine = 1 - (0.5 * z - z2 * c);
  switch (static_cast<int>(k) & 3) {
    case 0:
      return {sine, cosine};
    case 1:
      return {cosine, -sine};
    case 2:
      return {-sine, -cosine};
    default:
      return {-cosine, sine};
  }
}

// The angle of the point (x, y), y not below 0 and not both 0: 0 to pi, to within two units in the last place.
inline double arc_tangent(double y, double x) {
  constexpr double of_eighths[] = {0.0,
                                   0.12435499454676144,
                                   0.24497866312686414,
                                   0.35877067027057225,
                                   0.4636476090008061,
                                   0.5585993153435624,
                                   0.6435011087932844,
                                   0.7188299996216245,
                                   0.7853981633974483};
  const double across = std::abs(x);
  const bool steep = y > across;
  const double t = steep ? across / y : y / across;
  if (t != t) return t;
  // atan t = atan a + atan u, with a the nearest eighth and |u| at most 1/16.
  const int k = static_cast<int>(8 * t + 0.5);
  const double a = 0.125 * k, u = (t - a) / (1 + t * a), w = u * u, w2 = w * w;
  const double series =
      (-1.0 / 3 + (1.0 / 5) * w) + w2 * ((-1.0 / 7 + (1.0 / 9) * w) + w2 * (-1.0 / 11 + (1.0 / 13) * w));
  const double flat = of_eighths[k] + (u + u * w * series);
  const double acute = steep ? std::numbers::pi / 2 - flat : flat;
  return x < 0 ? std::numbers::pi - acute : acute;
}

}  // namespace palmar
