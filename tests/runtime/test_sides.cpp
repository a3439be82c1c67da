// A hand stays on the side that it came from: at a plate of one layer, at any speed and input rate and phase between
// the two, and at once. And a finger stays in a ring that just lets it in.
#include "brute_force.h"
#include "check.h"
#include "made_hand.h"
#include "session.h"

using namespace palmar;

namespace {

Configuration flat(double z) {
  Configuration q;
  q.position = Vec3(0, -0.09, z);
  q.flexion[0] = {-0.3, -0.3, -0.2};  // the thumb points down as it is
  return q;
}

}  // namespace

int main() {
  const HandModel hand = made::hand();
  std::mt19937 rng(12);
  std::uniform_real_distribution<double> u(0, 1);

  // 60 phases at each speed and rate, down from 40 mm above and 100 mm beyond, and 30 ms there. Steps of a millisecond,
  // half of one at 2 kHz; a slow tracker's sample is held until its next.
  const std::vector<Sphere> leaves = made::plate(90, 0.003, 0.003);
  const made::BruteForce brute(leaves);
  long runs = 0, wrong_side = 0;
  double deepest = 0;
  for (const double speed : {0.1, 0.5, 1.5, 8.0, 1e3})
    for (const double rate : {60.0, 200.0, 2000.0})
      for (int phase = 0; phase < (speed < 1 ? 2 : 60); ++phase) {
        Session session(hand, leaves, Settings{});
        const double dt = std::min(1e-3, 1 / rate), late = u(rng) / rate, top = 0.06 + 0.02 * u(rng);
        double lowest = 1;
        HandPose last;
        for (int i = 0; i * dt < 0.14 / speed + 0.03; ++i) {
          const double held = std::max(0.0, std::floor((i * dt + late) * rate) / rate - late);
          Sample s;
          s.time_s = i * dt;
          s.pose = to_pose(flat(std::max(top - speed * held, -0.1)));
          last = session.step(s).graphic;
          for (const made::Round& r : made::rounds_of(hand, last)) lowest = std::min({lowest, r.from.z(), r.to.z()});
        }
        ++runs;
        wrong_side += lowest <= 0;
        deepest = std::max(deepest, -brute.deepest(hand, last).gap_m);
      }
  CHECK(runs > 500);
  CHECK(wrong_side == 0);
  CHECK(deepest <= 1e-12);

  // A ring of balls around the thumb, half a millimetre wider than it, while the hand is torn about by up to 20 mm and
  // turned, across the thumb: along it, some 40 mm off, is the way out.
  {
    Configuration in;
    const HandPlacement at = place_hand(hand, in);
    const Capsule& bone = at.phalanx[1];
    const Vec3 along = (bone.c2 - bone.c1).normalized(), x = along.unitOrthogonal(), y = along.cross(x);
    const Vec3 center = 0.5 * (bone.c1 + bone.c2);
    const double inner = std::max(bone.r1, bone.r2) + 0.5e-3, ball = 0.002;
    std::vector<Sphere> ring;
    for (int i = 0; i < 60; ++i) {
      const double turn = 2 * M_PI * i / 60;
      ring.push_back({center + (inner + ball) * (std::cos(turn) * x + std::sin(turn) * y), ball});
    }
    const made::BruteForce judge(ring);
    Session session(hand, ring, Settings{});
    double deep = 0, moved = 0;
    long outside = 0, yielded = 0;
    Sample s;
    s.pose = to_pose(in);
    CHECK(session.step(s).status == kOk);
    for (int target = 0; target < 60; ++target) {
      Configuration q = in;
      q.position += 0.02 * (2 * u(rng) - 1) * x + 0.02 * (2 * u(rng) - 1) * y;
      q.rotation = rotation_exp(0.1 * Vec3(2 * u(rng) - 1, 2 * u(rng) - 1, 2 * u(rng) - 1));
      for (int i = 0; i < 50; ++i) {
        s.time_s += 1e-3;
        s.pose = to_pose(q);
        const StepResult& r = session.step(s);
        deep = std::max(deep, -judge.deepest(hand, r.graphic).gap_m);
        yielded += (r.status & kYielded) != 0;
        // The finger's bones still pass through the ring's plane inside it.
        bool through = false;
        for (const made::Round& b : made::rounds_of(hand, r.graphic)) {
          const double from = (b.from - center).dot(along), to = (b.to - center).dot(along);
          if (b.link < 1 || b.link > 3 || from * to > 0) continue;
          through |= (b.from + from / (from - to) * (b.to - b.from) - center).norm() < inner;
        }
        outside += !through;
        moved = std::max(moved, (to_vec3(r.graphic.palm.position_m)).norm());
      }
    }
    std::printf("ring: %.3g m deep, outside in %ld steps, yielded in %ld, palm up to %.1f mm away\n", deep, outside,
                yielded, 1e3 * moved);
    CHECK(deep <= 1e-12);
    CHECK(outside == 0);
    CHECK(yielded > 100);
  }
  return finish();
}
