// Random hands against six objects at four resolutions, judged from outside after the step: nothing sinks in, freezes,
// breaks a joint limit or is not a number. A fresh seed each run; the printed command repeats it.
//
//   fuzz_step [--steps N | --seconds S] [--seed N] [--object NAME] [--spheres N] [--set name=value]...
//
// The hand is cruel: targets near the surface every 30 to 200 ms, a twentieth of them 120 mm jumps, turns of 0.6 rad at
// once, any flexion within limits, input held at 60 to 2000 Hz, an object that swings in a quarter of the episodes.
#include <chrono>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "brute_force.h"
#include "error.h"
#include "machine.h"
#include "made_hand.h"
#include "made_objects.h"
#include "session.h"
#include "settings.h"

using namespace palmar;

namespace {

constexpr double kDeepest = 1e-6;      // metres that pass as rounding
constexpr double kLongestFreeze = 20;  // milliseconds
constexpr int kBruteEveryStep = 3000;  // spheres; above, every tenth step is judged, and every unusual one
constexpr std::uint32_t kUnusual = kRecovering | kKeptPrevious | kBadSample;
constexpr double kLimitRounding = 1e-7;  // rad; a programme meets bounds to 1e-9 m at 50 mm
constexpr double kStill = 1e-8;          // metres in a step
constexpr double kTargetMoves = 1e-4;    // metres in a step
constexpr double kDegrees = 180 / M_PI;

struct Options {
  std::uint64_t seed = 0;
  long steps = 0;
  double seconds = 0;
  std::vector<std::string> objects = made::object_names();
  std::vector<int> spheres = {500, 3000, 30000, 100000};
  nlohmann::json settings = nlohmann::json::object();
  std::string given;  // the --set arguments, to repeat them
};

struct Figures {
  long steps = 0, judged = 0, deep = 0, not_finite = 0, frozen = 0, over_limit = 0, differs = 0, in_contact = 0,
       late = 0, stuck = 0;
  double deepest_m = 0, longest_freeze_ms = 0, longest_stuck_ms = 0, joint_excess_deg = 0, worst_us = 0, start_us = 0;
  long deepest_step = -1, worst_step = -1, most_operations_step = -1, freeze_step = -1, stuck_step = -1;
  std::uint32_t most_operations = 0;
  std::vector<double> us;
};

using Random = std::mt19937_64;
using Clock = std::chrono::steady_clock;

double uniform(Random& rng, double low, double high) { return std::uniform_real_distribution<double>(low, high)(rng); }

Vec3 in_ball(Random& rng, double radius) {
  Vec3 v;
  do v = Vec3(uniform(rng, -1, 1), uniform(rng, -1, 1), uniform(rng, -1, 1));
  while (v.squaredNorm() > 1);
  return radius * v;
}

// Any posture within the limits; some part of the hand (palm, a fingertip) within 20 mm of some leaf.
Configuration target(Random& rng, const HandModel& hand, const std::vector<Sphere>& leaves, const Configuration& from) {
  Configuration q;
  q.rotation = (rotation_exp(in_ball(rng, 0.8)) * from.rotation).normalized();
  if (uniform(rng, 0, 1) < 0.1) q.rotation = rotation_exp(in_ball(rng, M_PI));
  const double curl = uniform(rng, -0.2, 1.2);
  const bool loose = uniform(rng, 0, 1) < 0.5;
  for (int f = 0; f < kFingers; ++f) {
    const Finger& finger = hand.finger[f];
    q.abduction[f] = uniform(rng, finger.abduction_limit[0], finger.abduction_limit[1]);
    for (int j = 0; j < kPhalanges; ++j) {
      const auto& limit = finger.flexion_limit[j];
      const double wanted = loose ? uniform(rng, limit[0], limit[1]) : curl + uniform(rng, -0.3, 0.3);
      q.flexion[f][j] = std::clamp(wanted, limit[0], limit[1]);
    }
  }
  q.position = Vec3::Zero();
  const HandPlacement at = place_hand(hand, q);
  const int part = int(uniform(rng, 0, 7));
  const Vec3 point = part < kFingers ? at.phalanx[3 * part + 2].c2 : Vec3(q.rotation * Vec3(0, 0.045, -0.01));
  const Sphere& leaf = leaves[std::size_t(uniform(rng, 0, double(leaves.size())))];
  q.position = leaf.center - point + in_ball(rng, 0.02);
  return q;
}

Placement swinging_object(double time, const Vec3& way, const Vec3& turn, double pulse) {
  Placement p;
  p.position_m = to_array(Vec3(way * std::sin(pulse * time)));
  p.rotation_wxyz = to_array(rotation_exp(Vec3(turn * std::sin(0.7 * pulse * time))));
  return p;
}

std::vector<Sample> episode(Random& rng, const HandModel& hand, const std::vector<Sphere>& leaves) {
  const double rates[] = {60, 90, 100, 200, 500, 1000, 2000};
  const double rate = rates[std::size_t(uniform(rng, 0, 7))], dt = rate > 1000 ? 1 / rate : 1e-3;
  const bool swings = uniform(rng, 0, 1) < 0.25, trembles = uniform(rng, 0, 1) < 0.25;
  const Vec3 way = in_ball(rng, 0.06), turn = in_ball(rng, 0.5);
  const double pulse = uniform(rng, 2, 20);

  const int length = int(uniform(rng, 500, 2000));

  std::vector<Sample> fine;
  Configuration from;
  from.position = Vec3(0, 0, 0.25);
  from = uniform(rng, 0, 1) < 0.8 ? from : target(rng, hand, leaves, from);
  while (int(fine.size()) < length) {
    Configuration to = target(rng, hand, leaves, from);
    const double chance = uniform(rng, 0, 1);
    if (chance < 0.05) from.position += in_ball(rng, 0.12);
    if (chance > 0.90) from.rotation = (rotation_exp(0.6 * in_ball(rng, 1).normalized()) * from.rotation).normalized();
    const int n = std::max(1, int(uniform(rng, 0.03, 0.2) / dt));
    const Change change = difference(to, from);
    for (int i = 1; i <= n && int(fine.size()) < length; ++i) {
      Sample s;
      s.time_s = dt * double(fine.size());
      Configuration q = advance(from, change, double(i) / n);
      if (trembles) q.position += in_ball(rng, 1e-4);
      if (swings) {
        s.has_object_pose = true;
        s.object = swinging_object(s.time_s, way, turn, pulse);
        const Quat r = to_quat(s.object.rotation_wxyz);
        q.position = r * q.position + to_vec3(s.object.position_m);
        q.rotation = (r * q.rotation).normalized();
      }
      s.pose = to_pose(q);
      fine.push_back(s);
    }
    from = to;
  }
  // A slower tracker's sample stays until its next.
  std::vector<Sample> held = fine;
  const int hold = std::max(1, int(std::lround(1 / (rate * dt))));
  for (std::size_t i = 0; i < held.size(); ++i) {
    held[i] = fine[i - i % std::size_t(hold)];
    held[i].time_s = fine[i].time_s;
  }
  return held;
}

bool finite(const StepResult& r) {
  double sum = 0;
  for (double v : r.graphic.palm.position_m) sum += v;
  for (double v : r.graphic.palm.rotation_wxyz) sum += v;
  for (double v : r.graphic.flexion_rad) sum += v;
  for (double v : r.graphic.abduction_rad) sum += v;
  for (double v : r.palm_force_n) sum += v;
  for (double v : r.palm_torque_n_m) sum += v;
  for (double v : r.joint_torque_n_m) sum += v;
  for (double v : r.fingertip_force_n) sum += v;
  return std::isfinite(sum);
}

// How far an angle lies outside its limits, rad; 0 for none.
double beyond_limits(const HandModel& hand, const HandPose& pose) {
  double most = 0;
  const auto look = [&](double angle, const std::array<double, 2>& limit) {
    most = std::max({most, limit[0] - angle, angle - limit[1]});
  };
  for (int f = 0; f < kFingers; ++f) {
    look(pose.abduction_rad[f], hand.finger[f].abduction_limit);
    for (int j = 0; j < kPhalanges; ++j) look(pose.flexion_rad[3 * f + j], hand.finger[f].flexion_limit[j]);
  }
  return most;
}

double moved(const HandModel& hand, const HandPose& a, const HandPose& b) {
  return largest_motion(hand, place_hand(hand, to_configuration(a)), place_hand(hand, to_configuration(b)));
}

// How much more than the haptic joint, and than one degree, a joint moved in the step.
double joint_excess_deg(const StepResult& before, const StepResult& now) {
  double most = 0;
  for (int k = 0; k < 15; ++k) {
    const double graphic = std::abs(now.graphic.flexion_rad[k] - before.graphic.flexion_rad[k]);
    const double haptic = std::abs(now.haptic.flexion_rad[k] - before.haptic.flexion_rad[k]);
    most = std::max(most, kDegrees * graphic - std::max(kDegrees * haptic, 1.0));
  }
  return most;
}

void run_episode(const HandModel& hand, const std::vector<Sphere>& leaves, const made::BruteForce& brute,
                 const Settings& settings, std::vector<Sample> samples, Clock::time_point deadline, Figures& all) {
  const std::size_t first = all.us.size();
  std::vector<std::uint64_t> hashes;
  double frozen_since = -1, stuck_since = -1;
  {
    Session session(hand, leaves, settings);
    StepResult before;
    HandPose graphic_before, haptic_before;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      if (i > 0 && Clock::now() > deadline) samples.resize(i);
      if (i == samples.size()) break;
      const double start = made::thread_us();
      const StepResult& r = session.step(samples[i]);
      all.us.push_back(made::thread_us() - start);
      const long step = all.steps++;
      hashes.push_back(r.state_hash);
      all.in_contact += r.contacts > 0;
      if (i > 0 && r.operations > all.most_operations)
        all.most_operations = r.operations, all.most_operations_step = step;

      if (!finite(r)) ++all.not_finite;
      const double beyond = beyond_limits(hand, r.graphic);
      if (beyond > kLimitRounding && all.over_limit++ < 3)
        std::printf("  step %ld: %.3g rad over a joint limit, status %u\n", step, beyond, r.status);
      if (i > 0) all.joint_excess_deg = std::max(all.joint_excess_deg, joint_excess_deg(before, r));
      // Status apart: does it stand still, seen from the object, while its target moves? Rightly so where contacts hold
      // it on all sides; a long time of it is a freeze that does not say so.
      all.late += (r.status & kIterationLimit) != 0;
      const HandPose graphic = made::seen_from(samples[i].object, r.graphic);
      const HandPose haptic = made::seen_from(samples[i].object, r.haptic);
      if (i > 0 && moved(hand, graphic_before, graphic) > kStill) stuck_since = -1;
      if (i > 0 && stuck_since < 0 && moved(hand, graphic_before, graphic) <= kStill) stuck_since = samples[i].time_s;
      if (i > 0 && stuck_since >= 0 && moved(hand, haptic_before, haptic) > kTargetMoves) {
        ++all.stuck;
        const double length = 1e3 * (samples[i].time_s - stuck_since);
        if (length > all.longest_stuck_ms) all.longest_stuck_ms = length, all.stuck_step = step;
      }
      graphic_before = graphic, haptic_before = haptic;
      before = r;

      if (r.status & kKeptPrevious) {
        ++all.frozen;
        if (frozen_since < 0) frozen_since = samples[i].time_s;
        const double dt = i > 0 ? samples[i].time_s - samples[i - 1].time_s : 1e-3;
        const double length = 1e3 * (samples[i].time_s - frozen_since + dt);
        if (length > all.longest_freeze_ms) all.longest_freeze_ms = length, all.freeze_step = step;
      } else {
        frozen_since = -1;
      }

      if (int(leaves.size()) > kBruteEveryStep && i % 10 != 0 && !(r.status & kUnusual)) continue;
      ++all.judged;
      const made::Deepest deepest = brute.deepest(hand, made::seen_from(samples[i].object, r.graphic));
      if (!(deepest.gap_m >= -kDeepest)) {
        if (all.deep++ < 3)
          std::printf("  step %ld: %.6f mm deep, link %d, sphere %u, status %u\n", step, -1e3 * deepest.gap_m,
                      deepest.link, deepest.sphere, r.status);
      }
      if (-deepest.gap_m > all.deepest_m) all.deepest_m = -deepest.gap_m, all.deepest_step = step;
    }
  }
  // The same again without the judge, whose reading drives the object out of the cache: the lesser time of each step,
  // and the same state to the bit.
  Session session(hand, leaves, settings);
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const double start = made::thread_us();
    const StepResult& r = session.step(samples[i]);
    double& us = all.us[first + i];
    us = std::min(us, made::thread_us() - start);
    all.differs += r.state_hash != hashes[i];
    if (i == 0) {
      all.start_us = std::max(all.start_us, us);
      us = 0;  // the search for a free place to begin is shown by itself
      continue;
    }
    if (us > all.worst_us) all.worst_us = us, all.worst_step = all.steps - long(samples.size()) + long(i);
  }
}

bool run(const Options& options, const HandModel& hand, const Settings& settings, const std::string& name, int spheres,
         long steps, double seconds, Figures& all) {
  // Its own numbers for each object and size, so that each repeats alone.
  std::seed_seq seed{options.seed & 0xffffffff, options.seed >> 32, std::uint64_t(name[0] * 256 + name[2]),
                     std::uint64_t(spheres)};
  Random rng(seed);
  const std::vector<Sphere> leaves = made::object(name, spheres, uniform(rng, 0.012, 0.016));
  const made::BruteForce brute(leaves);
  // Of the time allowed, two thirds for the first run of an episode and one for the second.
  const auto begin = Clock::now();
  const auto end_after = [&](double share) {
    return steps > 0
               ? Clock::time_point::max()
               : begin + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(share * seconds));
  };
  Figures f;
  do {
    std::vector<Sample> samples = episode(rng, hand, leaves);
    if (steps > 0) samples.resize(std::min(samples.size(), std::size_t(steps - f.steps)));
    run_episode(hand, leaves, brute, settings, std::move(samples), end_after(0.67), f);
  } while (steps > 0 ? f.steps < steps : Clock::now() < end_after(0.67));

  std::printf(
      "%-5s %6d %8ld %8ld %5.1f %9.6f %5ld %4ld %4ld %5ld %6.1f %5ld %6.0f %5.1f %6.2f %7.1f %7.1f %7.1f %8.1f %8u "
      "%8.1f\n",
      name.c_str(), spheres, f.steps, f.judged, 100.0 * double(f.in_contact) / double(f.steps), 1e3 * f.deepest_m,
      f.deep, f.not_finite, f.over_limit, f.frozen, f.longest_freeze_ms, f.stuck, f.longest_stuck_ms,
      100.0 * double(f.late) / double(f.steps), f.joint_excess_deg, made::quantile(f.us, 0.5),
      made::quantile(f.us, 0.99), made::quantile(f.us, 0.999), f.worst_us, f.most_operations, f.start_us);
  const bool frozen = f.frozen > 1 || std::max(f.longest_freeze_ms, f.longest_stuck_ms) > kLongestFreeze;
  const bool bad = f.deep > 0 || f.not_finite > 0 || f.over_limit > 0 || f.differs > 0 || frozen;
  if (bad || f.worst_us > 1000) {
    std::printf("  slowest step %ld, most operations at step %ld", f.worst_step, f.most_operations_step);
    if (f.deep > 0) std::printf(", deepest at step %ld", f.deepest_step);
    if (f.frozen > 0) std::printf(", longest freeze up to step %ld", f.freeze_step);
    if (f.stuck > 0) std::printf(", longest still up to step %ld", f.stuck_step);
    if (f.differs > 0) std::printf(", %ld steps differ when repeated", f.differs);
    std::printf("\n  again: fuzz_step --seed %llu --object %s --spheres %d --steps %ld%s\n",
                (unsigned long long)options.seed, name.c_str(), spheres, f.steps, options.given.c_str());
  }
  std::fflush(stdout);
  all.steps += f.steps, all.judged += f.judged, all.deep += f.deep, all.not_finite += f.not_finite;
  all.frozen += f.frozen, all.over_limit += f.over_limit, all.differs += f.differs;
  all.deepest_m = std::max(all.deepest_m, f.deepest_m);
  all.longest_freeze_ms = std::max({all.longest_freeze_ms, f.longest_freeze_ms, f.longest_stuck_ms});
  all.stuck += f.stuck, all.late += f.late;
  all.joint_excess_deg = std::max(all.joint_excess_deg, f.joint_excess_deg);
  all.worst_us = std::max(all.worst_us, f.worst_us), all.start_us = std::max(all.start_us, f.start_us);
  all.most_operations = std::max(all.most_operations, f.most_operations);
  return !bad;
}

Options parse(int argc, char** argv) {
  Options o;
  o.seed = std::uint64_t(std::chrono::system_clock::now().time_since_epoch().count()) / 1000;
  for (int i = 1; i < argc; i += 2) {
    const std::string name = argv[i];
    if (i + 1 == argc) throw Error("E-ARG", name, "wants a value");
    const std::string value = argv[i + 1];
    if (name == "--seed") {
      o.seed = std::strtoull(value.c_str(), nullptr, 10);
    } else if (name == "--steps") {
      o.steps = std::atol(value.c_str());
    } else if (name == "--seconds") {
      o.seconds = std::atof(value.c_str());
    } else if (name == "--object") {
      o.objects = {value};
    } else if (name == "--spheres") {
      o.spheres = {std::atoi(value.c_str())};
    } else if (name == "--set" && value.find('=') != std::string::npos) {
      const std::size_t is = value.find('=');
      const nlohmann::json number = nlohmann::json::parse(value.substr(is + 1), nullptr, false);
      o.settings[value.substr(0, is)] = number.is_discarded() ? nlohmann::json(value.substr(is + 1)) : number;
      o.given += " --set " + value;
    } else {
      throw Error("E-ARG", name, "is not an argument, or wants name=value");
    }
  }
  for (const std::string& name : o.objects)
    if (made::object(name, 100).empty()) throw Error("E-ARG", name, "is not an object");
  if (o.steps <= 0 && o.seconds <= 0) o.seconds = 60;
  return o;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const Options options = parse(argc, argv);
    const Settings settings = parse_settings(options.settings.dump());
    const HandModel hand = made::hand();
    std::printf("%s\nseed %llu; microseconds are thread CPU time, the lesser of two runs\n", made::machine().c_str(),
                (unsigned long long)options.seed);
    std::printf("%-5s %6s %8s %8s %5s %9s %5s %4s %4s %5s %6s %5s %6s %5s %6s %7s %7s %7s %8s %8s %8s\n", "", "leaves",
                "steps", "judged", "touch", "deepest", "deep", "nan", "lim", "kept", "longst", "still", "longst",
                "late", "joint", "p50", "p99", "p99.9", "max", "most", "start");
    std::printf("%-5s %6s %8s %8s %5s %9s %5s %4s %4s %5s %6s %5s %6s %5s %6s %7s %7s %7s %8s %8s %8s\n", "", "", "",
                "", "%", "mm", "", "", "", "", "ms", "", "ms", "%", "deg", "us", "us", "us", "us", "ops", "us");
    const double runs = double(options.objects.size() * options.spheres.size());
    Figures all;
    bool good = true;
    for (const std::string& name : options.objects)
      for (int spheres : options.spheres)
        good &= run(options, hand, settings, name, spheres, long(std::ceil(double(options.steps) / runs)),
                    options.seconds / runs, all);
    // One step in 100,000 may keep its pose, and one alone says nothing of the share.
    const bool frozen = all.frozen > std::max(1l, all.steps / 100000) || all.longest_freeze_ms > kLongestFreeze;
    good = all.deep == 0 && all.not_finite == 0 && all.over_limit == 0 && all.differs == 0 && !frozen;
    std::printf(
        "%ld steps, %ld judged: deepest %.6f mm, %ld deeper than 0.001 mm, %ld not finite, %ld over a limit, %ld kept "
        "and %ld still (longest %.1f ms), %.1f %% at the iteration limit, %ld differ when repeated, joints up to %.2f "
        "deg beyond the haptic step, worst %.1f us, "
        "%u operations; a start at most %.1f us\n%s\n",
        all.steps, all.judged, 1e3 * all.deepest_m, all.deep, all.not_finite, all.over_limit, all.frozen, all.stuck,
        all.longest_freeze_ms, 100.0 * double(all.late) / double(all.steps), all.differs, all.joint_excess_deg,
        all.worst_us, all.most_operations, all.start_us, good ? "passed" : "FAILED");
    return good ? 0 : 1;
  } catch (const Error& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return 2;
  }
}
