// What must not matter: left or right, where the world's origin lies, what came before, how many threads. And sizes
// that must: from grains to balls, points, and balls on one place.
#include <thread>

#include "brute_force.h"
#include "check.h"
#include "made_hand.h"
#include "made_objects.h"
#include "session.h"

using namespace palmar;

namespace {

// Targets near the object, 100 to 200 ms apart; of its own, so that nothing here depends on another test.
std::vector<Sample> motion(unsigned seed, int steps, double spread = 0.07) {
  std::mt19937 rng(seed);
  std::vector<Sample> samples;
  Configuration from;
  from.position = Vec3(0, -0.05, 0.25);
  while (int(samples.size()) < steps) {
    const Configuration to = made::random_configuration(rng, spread);
    const int n = 100 + int(rng() % 100);
    const Change way = difference(to, from);
    for (int i = 1; i <= n && int(samples.size()) < steps; ++i) {
      Sample s;
      s.time_s = 1e-3 * double(samples.size());
      s.pose = to_pose(advance(from, way, double(i) / n));
      samples.push_back(s);
    }
    from = to;
  }
  return samples;
}

// In the mirror x -> -x a place loses its sign in x, a turn (a pseudovector) in y and z.
Vec3 mirror(const Vec3& p) { return {-p.x(), p.y(), p.z()}; }
Vec3 mirror_axis(const Vec3& a) { return {a.x(), -a.y(), -a.z()}; }

HandModel mirror(HandModel hand) {
  for (PalmSphere& s : hand.palm) s.center = mirror(s.center);
  for (Finger& f : hand.finger) {
    f.abduction_axis = mirror_axis(f.abduction_axis);
    for (int j = 0; j < kPhalanges; ++j) {
      f.joint[j] = mirror(f.joint[j]);
      f.flexion_axis[j] = mirror_axis(f.flexion_axis[j]);
      f.phalanx[j].c1 = mirror(f.phalanx[j].c1);
      f.phalanx[j].c2 = mirror(f.phalanx[j].c2);
    }
  }
  hand.finish();
  return hand;
}

HandPose mirror(HandPose pose) {
  pose.palm.position_m[0] *= -1;
  pose.palm.rotation_wxyz[2] *= -1;
  pose.palm.rotation_wxyz[3] *= -1;
  return pose;
}

double apart(const HandModel& hand, const HandPose& a, const HandPose& b) {
  return largest_motion(hand, place_hand(hand, to_configuration(a)), place_hand(hand, to_configuration(b)));
}

double deepest(const HandModel& hand, const std::vector<Sphere>& leaves, const std::vector<Sample>& samples) {
  const made::BruteForce brute(leaves);
  Session session(hand, leaves, Settings{});
  double most = 0;
  long contacts = 0;
  for (const Sample& s : samples) {
    const StepResult& r = session.step(s);
    contacts += r.contacts;
    most = std::max(most, -brute.deepest(hand, r.graphic).gap_m);
    for (double f : r.fingertip_force_n) CHECK(std::isfinite(f));
    for (const Contact& c : session.contacts()) CHECK_NEAR(to_vec3(c.normal).norm(), 1, 1e-12);
  }
  CHECK(contacts > 100);
  return most;
}

}  // namespace

int main() {
  const HandModel hand = made::hand();
  const std::vector<Sphere> ears = made::object("ears", 1500);
  const std::vector<Sample> wild = motion(1, 3000);

  {
    const HandModel other = mirror(hand);
    std::vector<Sphere> reflected = ears;
    for (Sphere& s : reflected) s.center = mirror(s.center);
    Session right(hand, ears, Settings{}), left(other, reflected, Settings{});
    double most = 0;
    int touching = 0;
    for (const Sample& s : wild) {
      Sample m = s;
      m.pose = mirror(s.pose);
      const StepResult &r = right.step(s), &l = left.step(m);
      touching += r.contacts > 0;
      most = std::max(most, apart(hand, r.graphic, mirror(l.graphic)));
    }
    CHECK(touching > 1500);
    CHECK(most < 1e-9);
  }

  for (const double far : {1.0, 10.0, 100.0, 900.0}) {
    Session near(hand, ears, Settings{}), away(hand, ears, Settings{});
    const Vec3 shift(far, -0.7 * far, 0.3 * far);
    double most = 0;
    for (const Sample& s : wild) {
      Sample m = s;
      m.has_object_pose = true;
      m.object.position_m = to_array(shift);
      m.pose.palm.position_m = to_array(Vec3(to_vec3(s.pose.palm.position_m) + shift));
      HandPose back = away.step(m).graphic;
      back.palm.position_m = to_array(Vec3(to_vec3(back.palm.position_m) - shift));
      most = std::max(most, apart(hand, near.step(s).graphic, back));
    }
    CHECK(most < 1e-9);  // metres; a kilometre rounds to 1e-13
  }

  // A session copied at any step goes on as the one that it was copied from, to the bit: nothing hides outside it.
  {
    Session session(hand, ears, Settings{});
    for (std::size_t stop : {1u, 700u, 1501u}) {
      for (std::size_t i = 0; i < stop; ++i) session.step(wild[i]);
      Session restored = session;
      bool same = true;
      for (std::size_t i = stop; i < stop + 800; ++i) {
        const StepResult &a = session.step(wild[i]), &b = restored.step(wild[i]);
        same &= a.state_hash == b.state_hash && a.fingertip_force_n == b.fingertip_force_n && a.status == b.status &&
                a.operations == b.operations && a.contacts == b.contacts;
      }
      CHECK(same);
    }
  }

  // No active set is carried from step to step, so none can be poisoned: a session that has been through contacts and
  // one that begins where it stands agree on where a held hand ends.
  for (unsigned seed = 30; seed < 36; ++seed) {
    const std::vector<Sample> before = motion(seed, 1200, 0.05);
    Session old(hand, ears, Settings{});
    for (const Sample& s : before) old.step(s);
    Sample begin = before.back();
    const Sample held = before.back();
    HandPose rested;
    for (int i = 0; i < 400; ++i) rested = old.step(held).graphic;
    begin.pose = rested;
    Session fresh(hand, ears, Settings{});
    CHECK(fresh.step(begin).status == kOk);
    HandPose ended;
    for (int i = 0; i < 400; ++i) ended = fresh.step(held).graphic;
    CHECK(apart(hand, rested, ended) < 1e-9);
  }

  // Eight sessions on eight threads, and one after the other.
  {
    const auto hashes_of = [&](unsigned seed) {
      std::vector<std::uint64_t> hashes;
      Session session(hand, ears, Settings{});
      for (const Sample& s : motion(seed, 600)) hashes.push_back(session.step(s).state_hash);
      return hashes;
    };
    std::vector<std::vector<std::uint64_t>> alone(8), together(8);
    std::vector<std::thread> threads;
    for (unsigned i = 0; i < 8; ++i) threads.emplace_back([&, i] { together[i] = hashes_of(60 + i); });
    for (std::thread& t : threads) t.join();
    for (unsigned i = 0; i < 8; ++i) alone[i] = hashes_of(60 + i);
    CHECK(alone == together);
    CHECK(alone[0] != alone[1]);
  }

  // Leaves from 0.05 mm to 100 mm in one object.
  {
    std::mt19937 rng(2);
    std::uniform_real_distribution<double> u(-1, 1), size(0, 1);
    std::vector<Sphere> leaves = {{Vec3(0, 0, -0.1), 0.1}};
    for (int i = 0; i < 3000; ++i) {
      const Vec3 out = Vec3(u(rng), u(rng), u(rng)).normalized();
      leaves.push_back({leaves[0].center + 0.1 * out, 5e-5 * std::pow(300.0, size(rng))});
    }
    CHECK(deepest(hand, leaves, motion(3, 1500)) <= 1e-12);
  }

  // Points, nearly points, and forty balls on one place.
  for (const double radius : {0.0, 1e-12}) {
    std::vector<Sphere> leaves = made::plate(25, 0.004, radius);
    for (int i = 0; i < 40; ++i) leaves.push_back({Vec3(0, 0, 0.01), i % 2 ? 0.004 : radius});
    CHECK(deepest(hand, leaves, motion(4, 1500)) <= 1e-12);
  }
  return finish();
}
