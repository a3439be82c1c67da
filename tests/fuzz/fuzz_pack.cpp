// The reader of packs, and a session with what it accepts.
#include <cmath>
#include <vector>

#include "pack_file.h"
#include "session.h"
#include "target.h"

using namespace palmar;

namespace {

bool sound(const Sphere& sphere) { return sphere.center.allFinite() && sphere.radius > 0 && sphere.radius <= 1e6; }

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  AssetPack pack;
  if (!reads("E-PACK-", [&] { pack = pack_of({data, data + size}, "input"); })) return 0;
  for (const Finger& finger : pack.hand.finger) {
    MUST(std::abs(finger.abduction_axis.norm() - 1) < 1e-9);
    for (const Vec3& axis : finger.flexion_axis) MUST(std::abs(axis.norm() - 1) < 1e-9);
    for (const auto& limit : finger.flexion_limit) MUST(limit[0] <= limit[1]);
  }
  for (const auto& [name, object] : pack.objects) {
    MUST(!object.levels.empty());
    for (const auto& level : object.levels)
      for (const Sphere& sphere : level) MUST(sound(sphere));
  }
  if (pack.objects.empty() || size % 16 != 0) return 0;  // a session costs more than reading
  Session session(pack.hand, pack.objects.begin()->second.levels.back(), Settings{});
  for (int i = 0; i < 3; ++i) {
    Sample sample;
    sample.time_s = 0.001 * i;
    sample.pose.palm.position_m = {0, 0, 0.1 - 0.05 * i};
    const StepResult& step = session.step(sample);
    for (const double x : step.graphic.palm.position_m) MUST(std::isfinite(x));
    for (const double x : step.graphic.flexion_rad) MUST(std::isfinite(x));
    for (const double x : step.palm_force_n) MUST(std::isfinite(x));
  }
  return 0;
}
