// Own sines and arc tangents against the C library's in longer numbers, and that they are the same everywhere.
#include <cstdint>
#include <cstring>
#include <limits>

#include "check.h"
#include "random.h"
#include "trig.h"

using namespace palmar;

namespace {

// How far `found` is from the truth, in units in the last place of the truth.
double units(double found, long double truth) {
  const double near = std::abs(double(truth));
  const double unit = std::nextafter(near, std::numeric_limits<double>::infinity()) - near;
  return std::abs(double((static_cast<long double>(found) - truth) / unit));
}

}  // namespace

int main() {
  Random random{3};
  std::uint64_t hash = 14695981039346656037ull;  // FNV-1a
  const auto mix = [&](double value) {
    std::uint64_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    for (int i = 0; i < 8; ++i) hash = (hash ^ (bits >> 8 * i & 255)) * 1099511628211ull;
  };
  double sine_off = 0, cosine_off = 0, arc_off = 0, far_off = 0;
  for (int i = 0; i < 200000; ++i) {
    // Every size of angle from 1e-12 to a few turns.
    const double x = 20 * (2 * random.uniform() - 1) * (i % 2 ? 1.0 : std::ldexp(1.0, -int(random.below(44))));
    const auto [sine, cosine] = sine_cosine(x);
    sine_off = std::max(sine_off, units(sine, std::sin(static_cast<long double>(x))));
    cosine_off = std::max(cosine_off, units(cosine, std::cos(static_cast<long double>(x))));
    const double far = 1e5 * (2 * random.uniform() - 1);
    far_off = std::max(far_off, units(sine_cosine(far).sine, std::sin(static_cast<long double>(far))));
    const double across = 2 * random.uniform() - 1, up = random.uniform() * std::ldexp(1.0, -int(random.below(44)));
    const double arc = arc_tangent(up, across);
    arc_off = std::max(arc_off, units(arc, std::atan2(static_cast<long double>(up), static_cast<long double>(across))));
    for (const double value : {sine, cosine, arc}) mix(value);
  }
  std::printf("off by at most %.2f, %.2f, %.2f units in the last place; %.2f at 1e5 rad; hash %016llx\n", sine_off,
              cosine_off, arc_off, far_off, static_cast<unsigned long long>(hash));
  // Three roundings count: of what is left of x, of the series and of the last sum; with many turns the first is
  // larger.
  CHECK(sine_off < 2 && cosine_off < 2 && arc_off < 2 && far_off < 3);
  // By any compiler on any machine with IEEE numbers.
  CHECK(hash == 0x503c176a3d1eed0eull);

  CHECK(sine_cosine(0).sine == 0 && sine_cosine(0).cosine == 1);
  CHECK(arc_tangent(0, 1) == 0 && arc_tangent(0, -1) == std::numbers::pi && arc_tangent(1, 0) == std::numbers::pi / 2);
  for (const double x : {1e-300, 0.3, 2.0, 50.0, 99999.0, 1e6, 1e300}) {
    const auto [sine, cosine] = sine_cosine(x);
    CHECK(sine_cosine(-x).sine == -sine && sine_cosine(-x).cosine == cosine);
    CHECK_NEAR(sine * sine + cosine * cosine, 1, 4e-16);  // a turn stays a turn, however large
  }
  for (const double x : {double(NAN), double(INFINITY), -double(INFINITY)})
    CHECK(std::isnan(sine_cosine(x).sine) && std::isnan(sine_cosine(x).cosine));
  CHECK(std::isnan(arc_tangent(NAN, 1)) && std::isnan(arc_tangent(1, NAN)));
  return finish();
}
