#include "recorder.h"

#include <pthread.h>
#include <signal.h>

#include <bit>
#include <filesystem>

#include "error.h"

namespace palmar {

namespace {

using Clock = std::chrono::steady_clock;

// Promised is a quarter of a second; the rest is for a system that lets this thread wait.
constexpr auto kFlushAfter = std::chrono::milliseconds(100);
// It looks by itself: waking it would be a call to the system from the thread that appends.
constexpr auto kLookEvery = std::chrono::milliseconds(10);
constexpr std::size_t kRingLeast = 16, kRingMost = 1 << 20;

std::size_t checked_size(std::size_t ring_samples) {
  if (ring_samples < kRingLeast || ring_samples > kRingMost)
    throw Error("E-CONF-VALUE", "ring_samples",
                std::to_string(ring_samples) + "; " + std::to_string(kRingLeast) + " to " + std::to_string(kRingMost) +
                    " are allowed");
  return std::bit_ceil(ring_samples);
}

const std::string& checked_path(const std::string& path) {
  std::error_code problem;
  if (std::filesystem::is_regular_file(path, problem))
    throw Error("E-TRACE-EXISTS", path, "a recording is never written over; another name is needed");
  return path;
}

// The pose of a hand that the device had lost may be anything; it is not kept.
bool is_usable(const Sample& sample) {
  if (sample.tracked) return is_storable(sample);
  Sample lost = sample;
  lost.pose = {};
  return is_storable(lost);
}

// A thread that records must not disturb those of its host: it takes no signals, and none of a host's real-time
// priority.
void step_back() {
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);
  const sched_param ordinary{};
  pthread_setschedparam(pthread_self(), SCHED_OTHER, &ordinary);
}

}  // namespace

Recorder::Recorder(const std::string& path, const Header& header, std::size_t ring_samples)
    : ring_(checked_size(ring_samples)), writer_(checked_path(path), header, McapWriter::Place::kNamedOnFlush, {}) {
  writer_.flush();
  thread_ = std::thread([this] {
    step_back();
    write_all();
  });
}

Recorder::~Recorder() {
  closing_.store(true, std::memory_order_release);
  if (thread_.joinable()) thread_.join();
}

Recorder::Taken Recorder::append(const Sample& sample) {
  if (!is_usable(sample) || sample.time_s <= last_time_s_) {
    refused_.fetch_add(1, std::memory_order_relaxed);
    return Taken::kUnusable;
  }
  const std::uint64_t head = head_.load(std::memory_order_relaxed);
  if (failed_.load(std::memory_order_relaxed) || head - tail_.load(std::memory_order_acquire) == ring_.size()) {
    dropped_.fetch_add(1, std::memory_order_relaxed);
    return Taken::kNoRoom;
  }
  Sample& place = ring_[head & (ring_.size() - 1)];
  place = sample;
  if (!sample.tracked) place.pose = {};
  head_.store(head + 1, std::memory_order_release);
  last_time_s_ = sample.time_s;
  return Taken::kYes;
}

Recorder::Counts Recorder::counts() const {
  Counts counts;
  counts.written = written_.load(std::memory_order_acquire);  // before `taken`, so that it is never more
  counts.failed = failed_.load(std::memory_order_acquire);
  counts.taken = head_.load(std::memory_order_acquire);
  counts.dropped = dropped_.load(std::memory_order_relaxed);
  counts.refused = refused_.load(std::memory_order_relaxed);
  return counts;
}

Recorder::Counts Recorder::close() {
  closing_.store(true, std::memory_order_release);
  if (thread_.joinable()) thread_.join();
  if (failure_) std::rethrow_exception(failure_);
  return counts();
}

void Recorder::write_all() {
  try {
    for (bool last = false; !last;) {
      last = closing_.load(std::memory_order_acquire);
      drain();
      const std::uint64_t tail = tail_.load(std::memory_order_relaxed);
      if (tail > written_.load(std::memory_order_relaxed) && (last || Clock::now() - oldest_ >= kFlushAfter)) {
        writer_.flush();
        written_.store(tail, std::memory_order_release);
      }
      if (!last) std::this_thread::sleep_for(kLookEvery);
    }
    writer_.close();
  } catch (...) {
    failure_ = std::current_exception();
    failed_.store(true, std::memory_order_release);
  }
}

void Recorder::drain() {
  const std::uint64_t head = head_.load(std::memory_order_acquire);
  std::uint64_t tail = tail_.load(std::memory_order_relaxed);
  if (head > tail && tail == written_.load(std::memory_order_relaxed)) oldest_ = Clock::now();
  for (; tail < head; ++tail) {
    writer_.add(ring_[tail & (ring_.size() - 1)]);
    tail_.store(tail + 1, std::memory_order_release);
  }
}

}  // namespace palmar
