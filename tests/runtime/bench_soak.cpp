// A frame loop of 1 kHz for a long time: is memory flat, is every answer a number, and how late is a frame, as an
// ordinary thread and with SCHED_FIFO and locked memory where the system allows that? bench_soak [SECONDS]
//
// Random motion over three objects in turn, ordinary and real-time frames in mixed order. Exit code 1 where memory grew
// by more than a MiB after the first tenth, a number is none, or a step took more than its budget of operations by
// half. Lateness is measured, never judged.
#include <pthread.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "machine.h"
#include "made_hand.h"
#include "made_objects.h"
#include "session.h"

using namespace palmar;

namespace {

constexpr long kPeriodNs = 1'000'000;
constexpr long kLeg = 500;     // frames of one motion
constexpr long kBlock = 2000;  // frames of one kind of scheduling

struct Frames {
  std::vector<float> woken_us, step_us;
  long missed = 0;  // answers later than the next frame's beginning
};

double ns_between(const timespec& a, const timespec& b) {
  return 1e9 * double(b.tv_sec - a.tv_sec) + double(b.tv_nsec - a.tv_nsec);
}

long resident_kib() {
  long size = 0, resident = 0;
  if (std::FILE* file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%ld %ld", &size, &resident) != 2) resident = 0;
    std::fclose(file);
  }
  return resident * (sysconf(_SC_PAGESIZE) / 1024);
}

bool schedule(bool real_time) {
  sched_param parameter{};
  parameter.sched_priority = real_time ? 80 : 0;
  return pthread_setschedparam(pthread_self(), real_time ? SCHED_FIFO : SCHED_OTHER, &parameter) == 0;
}

bool is_finite(const StepResult& r) {
  double sum = 0;
  for (const double x : r.graphic.palm.position_m) sum += x;
  for (const double x : r.graphic.flexion_rad) sum += x;
  for (const double x : r.palm_force_n) sum += x;
  for (const double x : r.fingertip_force_n) sum += x;
  return std::isfinite(sum);
}

void print(const char* what, Frames& frames) {
  const auto at = [](std::vector<float>& values, double share) {
    const auto place = values.begin() + std::ptrdiff_t(share * double(values.size() - 1));
    std::nth_element(values.begin(), place, values.end());
    return double(*place);
  };
  if (frames.step_us.empty()) return;
  std::printf("| %s | %zu | %.0f | %.0f | %.0f | %.1f | %.1f | %.0f | %ld |\n", what, frames.step_us.size(),
              at(frames.woken_us, 0.5), at(frames.woken_us, 0.99), at(frames.woken_us, 1), at(frames.step_us, 0.5),
              at(frames.step_us, 0.99), at(frames.step_us, 1), frames.missed);
}

}  // namespace

int main(int argc, char** argv) {
  const long frames = 1000 * std::max(1L, argc > 1 ? std::atol(argv[1]) : 600);
  const HandModel hand = made::hand();
  std::vector<Session> sessions;
  for (const char* name : {"ball", "ears", "cup"}) sessions.emplace_back(hand, made::object(name, 10000), Settings{});
  const bool allowed = schedule(true) && mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
  schedule(false);
  Frames kinds[2];
  for (Frames& kind : kinds) {
    kind.woken_us.reserve(std::size_t(frames));
    kind.step_us.reserve(std::size_t(frames));
  }

  std::mt19937 random(5);
  Configuration from;
  from.position = Vec3(0, -0.05, 0.2);
  Change way{};
  timespec next;
  clock_gettime(CLOCK_MONOTONIC, &next);
  long wrong = 0, settled_kib = 0, most_kib = 0;
  std::uint32_t most_operations = 0;
  for (long i = 0; i < frames; ++i) {
    const bool real_time = allowed && i / kBlock % 2 == 1;
    if (i % kBlock == 0) schedule(real_time);
    if (i % kLeg == 0) {
      from = advance(from, way, i ? 1.0 : 0.0);
      way = difference(made::random_configuration(random, 0.06), from);
    }
    Session& session = sessions[std::size_t(i / (10 * kLeg) % std::ssize(sessions))];
    Sample sample;
    sample.time_s = 1e-3 * double(i);
    sample.pose = to_pose(advance(from, way, double(i % kLeg) / kLeg));

    next.tv_nsec += kPeriodNs;
    if (next.tv_nsec >= 1'000'000'000) next.tv_nsec -= 1'000'000'000, ++next.tv_sec;
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, nullptr);
    timespec woken, done;
    clock_gettime(CLOCK_MONOTONIC, &woken);
    const StepResult& result = session.step(sample);
    clock_gettime(CLOCK_MONOTONIC, &done);
    Frames& kind = kinds[real_time];
    kind.woken_us.push_back(float(1e-3 * ns_between(next, woken)));
    kind.step_us.push_back(float(1e-3 * ns_between(woken, done)));
    const double late_ns = ns_between(next, done);
    kind.missed += late_ns > kPeriodNs;
    if (late_ns > 100 * kPeriodNs) next = done;  // a machine that stood still is not caught up with
    wrong += !is_finite(result);
    most_operations = std::max(most_operations, result.operations);
    if (i % 1000 == 999) {
      most_kib = std::max(most_kib, resident_kib());
      if (i < frames / 10) settled_kib = most_kib;
    }
  }
  schedule(false);
  const long grown_kib = settled_kib ? most_kib - settled_kib : 0;
  std::printf("%s, %ld s, SCHED_FIFO and mlockall %s\n\n", made::machine().c_str(), frames / 1000,
              allowed ? "allowed" : "not allowed");
  std::printf("| thread | frames | woken late p50 (us) | p99 | max | step p50 (us) | p99 | max | missed |\n");
  std::printf("| --- | --- | --- | --- | --- | --- | --- | --- | --- |\n");
  print("ordinary", kinds[0]);
  print("SCHED_FIFO, locked", kinds[1]);
  std::printf(
      "\nmemory %ld KiB, grown by %ld KiB after the first tenth; %ld answers are no numbers; at most %u operations of "
      "%d\n",
      most_kib, grown_kib, wrong, most_operations, Settings{}.operations);
  return wrong > 0 || grown_kib > 1024 || double(most_operations) > 1.5 * Settings{}.operations;
}
