// The readers of traces and runs.
#include <unistd.h>

#include <filesystem>
#include <span>
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

const std::string& scratch_path() {
  static const std::string path = folder() + "/palmar_fuzz_" + std::to_string(getpid()) + ".mcap";
  return path;
}

bool is_none(const Loss& loss) { return loss.bytes == 0 && loss.chunks == 0 && loss.messages == 0 && !loss.unclosed; }

// What was accepted can be written, and comes back equal and sound.
void goes_round(const Trace& trace) {
  const std::string& path = scratch_path();
  write_trace(path, trace);
  const Trace back = read_trace(path);
  MUST(is_none(back.loss));
  MUST(back.header == trace.header && back.samples.size() == trace.samples.size());
  for (std::size_t i = 0; i < trace.samples.size(); ++i) MUST(same(back.samples[i], trace.samples[i]));
  MUST(same_content(back, trace));
  std::remove(path.c_str());
}

// Gives the hash of its steps and contacts.
std::string write_run(const std::string& path, const Run& run) {
  RunWriter writer(path, run.header);
  const std::span<const Contact> contacts(run.contacts);
  for (std::size_t i = 0; i < run.steps.size(); ++i) {
    const std::size_t start = run.contact_start[i];
    writer.add(run.steps[i], run.timing[i], contacts.subspan(start, run.contact_start[i + 1] - start));
  }
  return writer.close();
}

void goes_round(const Run& run) {
  const std::string& path = scratch_path();
  const std::string hash = write_run(path, run);
  const Run back = read_run(path);
  MUST(is_none(back.loss));
  MUST(back.contact_start == run.contact_start && back.timing.size() == run.timing.size());
  MUST(std::memcmp(back.timing.data(), run.timing.data(), run.timing.size() * sizeof(Timing)) == 0);  // NaN too
  MUST(back.header.at("content_fnv1a64") == hash && write_run(path, back) == hash);
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
  Run run;
  if (reads("E-TRACE-", [&] { run = run_of(file, "input"); })) {
    check(run);
    if (size % 64 == 0) goes_round(run);
  }
  return 0;
}
