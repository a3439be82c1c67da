// The recorder: what is in the file while it runs, at its end and when it is given too much. Built a second time with
// checks for races between threads.
#include <cmath>
#include <filesystem>
#include <functional>
#include <string>
#include <thread>

#include "check.h"
#include "error.h"
#include "recorder.h"
#include "trace_file.h"

using namespace palmar;

namespace {

// Of this process alone: the two builds may run side by side.
const std::filesystem::path kFolder =
    std::filesystem::temp_directory_path() / ("palmar_test_recorder_" + std::to_string(getpid()));
const std::string kPath = (kFolder / "file.mcap").string();
const Header kHeader{{"device", "test"}, {"hand", "a"}, {"side", "left"}};

using Taken = Recorder::Taken;

Sample sample_at(std::uint64_t i) {
  Sample sample;
  sample.time_s = 0.001 * double(i);
  sample.pose.palm.position_m = {std::sin(0.7 * double(i)), std::cos(0.3 * double(i)), 1};
  for (int k = 0; k < 15; ++k) sample.pose.flexion_rad[k] = std::sin(double(i) + k);
  sample.has_object_pose = i % 2 == 1;
  if (sample.has_object_pose) sample.object.position_m = {0, double(i), 0};
  return sample;
}

bool same(const Sample& a, const Sample& b) {
  return a.time_s == b.time_s && a.tracked == b.tracked && a.pose.palm.position_m == b.pose.palm.position_m &&
         a.pose.flexion_rad == b.pose.flexion_rad && a.has_object_pose == b.has_object_pose &&
         a.object.position_m == b.object.position_m;
}

std::string code_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.code;
  }
  return "";
}

void wait_until(const std::function<bool()>& holds) {
  while (!holds()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

// One thread appends as fast as it can, one looks at the counts, a third reads the file under it.
void every_sample_is_in_the_file_or_counted() {
  std::filesystem::remove(kPath);
  Recorder recorder(kPath, kHeader, 256);
  constexpr std::uint64_t kCount = 100000;
  std::vector<std::uint64_t> taken;
  taken.reserve(kCount);
  std::atomic<bool> done = false;
  std::thread device([&] {
    for (std::uint64_t i = 0; i < kCount; ++i)
      if (recorder.append(sample_at(i)) == Taken::kYes) taken.push_back(i);
    done = true;
  });
  bool in_order = true, readable = true;
  std::uint64_t read_back = 0;
  wait_until([&] {
    const Recorder::Counts counts = recorder.counts();
    in_order &= counts.written <= counts.taken && !counts.failed;
    if (counts.written > read_back) {
      const Trace trace = read_trace(kPath);
      readable &= trace.samples.size() >= counts.written;
      read_back = trace.samples.size();
    }
    return done.load();
  });
  device.join();
  const Recorder::Counts end = recorder.close();
  CHECK(in_order);
  CHECK(readable);
  CHECK(end.taken == taken.size() && end.written == end.taken && end.refused == 0);
  CHECK(end.taken + end.dropped == kCount);
  CHECK(end.dropped > 0);  // 100,000 samples at once do not go through a ring of 256
  const Trace trace = read_trace(kPath);
  CHECK(trace.loss.bytes == 0 && trace.loss.chunks == 0 && trace.loss.messages == 0 && !trace.loss.unclosed);
  CHECK(trace.header.at("device") == "test" && trace.header.at("schema") == "palmar.trace/1");
  CHECK(trace.samples.size() == taken.size());
  bool equal = trace.samples.size() == taken.size();
  for (std::size_t i = 0; equal && i < taken.size(); ++i) equal = same(trace.samples[i], sample_at(taken[i]));
  CHECK(equal);
}

void a_ring_that_is_long_enough_drops_nothing() {
  std::filesystem::remove(kPath);
  Recorder recorder(kPath, kHeader, 1000);  // rounded up to 1024
  bool all = true;
  for (std::uint64_t i = 0; i < 1024; ++i) all &= recorder.append(sample_at(i)) == Taken::kYes;
  CHECK(all);
  const Recorder::Counts end = recorder.close();
  CHECK(end.written == 1024 && end.dropped == 0);
  CHECK(read_trace(kPath).samples.size() == 1024);
}

void samples_reach_the_file_without_more_of_them() {
  std::filesystem::remove(kPath);
  Recorder recorder(kPath, kHeader, 64);
  recorder.append(sample_at(0));
  wait_until([&] { return recorder.counts().written == 1; });
  const Trace trace = read_trace(kPath);
  CHECK(trace.samples.size() == 1 && trace.loss.unclosed);
}

void what_a_trace_cannot_hold_is_refused() {
  std::filesystem::remove(kPath);
  Recorder recorder(kPath, kHeader, 64);
  const auto takes = [&](double time_s, const std::function<void(Sample&)>& change) {
    Sample sample = sample_at(0);
    sample.time_s = time_s;
    change(sample);
    return recorder.append(sample);
  };
  const auto nothing = [](Sample&) {};
  CHECK(takes(1, nothing) == Taken::kYes);
  CHECK(takes(1, nothing) == Taken::kUnusable);
  CHECK(takes(0.5, nothing) == Taken::kUnusable);
  CHECK(takes(NAN, nothing) == Taken::kUnusable);
  CHECK(takes(INFINITY, nothing) == Taken::kUnusable);
  CHECK(takes(2, [](Sample& s) { s.pose.flexion_rad[14] = NAN; }) == Taken::kUnusable);
  CHECK(takes(2, [](Sample& s) { s.pose.palm.position_m[0] = -INFINITY; }) == Taken::kUnusable);
  CHECK(takes(2, [](Sample& s) { s.pose.palm.rotation_wxyz = {0, 0, 0, 0}; }) == Taken::kUnusable);
  CHECK(takes(2, [](Sample& s) {
          s.has_object_pose = true;
          s.object.rotation_wxyz = {2, 0, 0, 0};
        }) == Taken::kUnusable);
  // Of a hand that the device had lost the pose may be anything.
  CHECK(takes(2, [](Sample& s) {
          s.tracked = false;
          s.pose.palm.position_m = {NAN, NAN, NAN};
        }) == Taken::kYes);
  CHECK(recorder.close().refused == 8);
  const Trace trace = read_trace(kPath);
  CHECK(trace.samples.size() == 2 && !trace.samples[1].tracked);
  CHECK(trace.samples[1].pose.palm.position_m == HandPose{}.palm.position_m);
}

void wrong_openings_make_no_file() {
  const auto code = [](const std::string& path, const Header& header, std::size_t ring) {
    return code_of([&] { Recorder(path, header, ring); });
  };
  std::filesystem::remove(kPath);
  CHECK(code(kPath, {{"device", "d"}, {"hand", "h"}}, 64) == "E-TRACE-HEADER");
  CHECK(code(kPath, {{"device", "d"}, {"hand", "h"}, {"side", "both"}}, 64) == "E-TRACE-HEADER");
  CHECK(code(kPath, {{"device", "\xff"}, {"hand", "h"}, {"side", "left"}}, 64) == "E-TRACE-HEADER");
  CHECK(code(kPath, kHeader, 1) == "E-CONF-VALUE");
  CHECK(code(kPath, kHeader, 1 << 21) == "E-CONF-VALUE");
  CHECK(!std::filesystem::exists(kPath));
  CHECK(code((kFolder / "none" / "x.mcap").string(), kHeader, 64) == "E-TRACE-WRITE");
  Recorder(kPath, kHeader, 64).close();
  const auto size = std::filesystem::file_size(kPath);
  CHECK(code(kPath, kHeader, 64) == "E-TRACE-EXISTS");
  CHECK(std::filesystem::file_size(kPath) == size);
}

void a_full_disk_is_said_and_stops_nobody() {
  if (!std::filesystem::is_character_file("/dev/full")) return;
  CHECK(code_of([] { Recorder("/dev/full", kHeader, 64); }) == "E-TRACE-WRITE");
  CHECK(std::filesystem::is_character_file(
      "/dev/full"));  // a recording that fails at once takes its file away, never a device
}

}  // namespace

int main() {
  std::filesystem::create_directories(kFolder);
  every_sample_is_in_the_file_or_counted();
  a_ring_that_is_long_enough_drops_nothing();
  samples_reach_the_file_without_more_of_them();
  what_a_trace_cannot_hold_is_refused();
  wrong_openings_make_no_file();
  a_full_disk_is_said_and_stops_nobody();
  std::filesystem::remove_all(kFolder);
  return finish();
}
