// The readers of traces and runs.
#include <unistd.h>

#include <filesystem>
#include <string>
#include <vector>

#include "run_file.h"
#include "target.h"
#include "trace_file.h"

using namespace palmar;

namespace {

bool same(const Sample& a, const Sample& b) {
  return a.time_s == b.time_s && a.tracked == b.tracked && a.pose.palm.position_m == b.pose.palm.position_m &&
         a.pose.palm.rotation_wxyz == b.pose.palm.rotation_wxyz && a.pose.flexion_rad == b.pose.flexion_rad &&
         a.pose.abduction_rad == b.pose.abduction_rad && a.has_object_pose == b.has_object_pose &&
         a.object.position_m == b.object.position_m && a.object.rotation_wxyz == b.object.rotation_wxyz;
}

// In memory where the system has such a folder: a disk would be most of a run's time.
std::string folder() {
  const std::filesystem::path memory = "/dev/shm";
  std::error_code problem;
  return (std::filesystem::is_directory(memory, problem) ? memory : std::filesystem::temp_directory_path()).string();
}

// What was accepted can be written, and comes back equal and sound.
void goes_round(const Trace& trace) {
  static const std::string path = folder() + "/palmar_fuzz_" + std::to_string(getpid()) + ".mcap";
  write_trace(path, trace);
  const Trace back = read_trace(path);
  MUST(back.loss.bytes == 0 && back.loss.chunks == 0 && back.loss.messages == 0 && !back.loss.unclosed);
  MUST(back.header == trace.header && back.samples.size() == trace.samples.size());
  for (std::size_t i = 0; i < trace.samples.size(); ++i) MUST(same(back.samples[i], trace.samples[i]));
  MUST(same_content(back, trace));
  std::remove(path.c_str());
}

void check(const Trace& trace) {
  MUST(!trace.samples.empty());
  MUST(trace.header.count("side") && trace.header.count("hand") && trace.header.count("device"));
  for (std::size_t i = 0; i < trace.samples.size(); ++i) {
    MUST(is_storable(trace.samples[i]));
    MUST(i == 0 || trace.samples[i].time_s > trace.samples[i - 1].time_s);
  }
}

void check(const Run& run) {
  MUST(!run.steps.empty());
  MUST(run.timing.size() == run.steps.size() && run.contact_start.size() == run.steps.size() + 1);
  MUST(run.contact_start.front() == 0 && run.contact_start.back() == run.contacts.size());
  for (std::size_t i = 0; i < run.steps.size(); ++i) {
    MUST(run.contact_start[i] <= run.contact_start[i + 1]);
    MUST(i == 0 || run.steps[i].time_s > run.steps[i - 1].time_s);
  }
}

// What `palmar recover` takes: all of a trace that is sound, and of another what is. `trace` is empty for the latter.
void check_salvage(const McapFile& file, const Trace& trace) {
  static const Header spare = {{"device", "d"}, {"hand", "h"}, {"side", "right"}};
  Trace rest;
  if (!reads("E-TRACE-", [&] { rest = salvage_of(file, "input", spare); })) {
    MUST(trace.samples.empty());
    return;
  }
  check(rest);
  if (!trace.samples.empty()) MUST(same_content(rest, trace) && rest.loss.messages == trace.loss.messages);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  McapFile file;
  if (!reads("E-TRACE-", [&] { file = mcap_of({data, data + size}, "input"); })) return 0;
  Trace trace;
  if (reads("E-TRACE-", [&] { trace = trace_of(file, "input"); })) {
    check(trace);
    if (size % 64 == 0) goes_round(trace);  // writing costs more than reading
  }
  if (size % 4 == 0) check_salvage(file, trace);
  reads("E-TRACE-", [&] { check(run_of(file, "input")); });
  return 0;
}
