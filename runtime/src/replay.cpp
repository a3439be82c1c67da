#include "replay.h"

#include <time.h>

#include <chrono>
#include <nlohmann/json.hpp>

#include "pack_file.h"
#include "resample.h"
#include "run_file.h"
#include "session.h"
#include "settings.h"
#include "trace_file.h"

namespace palmar {

namespace {

double thread_cpu_us() {
  timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e6 * double(t.tv_sec) + 1e-3 * double(t.tv_nsec);
}

}  // namespace

std::map<std::string, std::string> build_info() {
  std::string wide = "portable";
#if defined(__x86_64__) && defined(__GNUC__)
  if (__builtin_cpu_supports("avx512f"))
    wide = "avx512f";
  else if (__builtin_cpu_supports("avx2"))
    wide = "avx2";
#endif
  return {{"version", PALMAR_VERSION},
          {"compiler", PALMAR_COMPILER},
          {"build_type", PALMAR_BUILD_TYPE},
          {"search_instructions", wide}};
}

ReplaySummary replay(const std::string& pack_path, const std::string& trace_path, const std::string& out_path,
                     const std::string& object, const Settings& settings, const Header& header,
                     const Progress& progress) {
  AssetPack pack = read_pack(pack_path);
  const Trace trace = read_trace(trace_path);
  const std::string name = find_object(pack, pack_path, object);
  Session session(pack.hand, find_level(pack, pack_path, name, settings.level), settings);
  const Resampler samples(trace, settings.resample, settings.rate_hz);

  Header about = header;
  about["schema"] = "palmar.run/1";
  about["solver"] = settings.solver;
  about["object"] = name;
  about["hand"] = pack.hand_name;
  about["level"] = std::to_string(settings.level);
  about["settings"] = settings_json(settings);
  about["resample"] = settings.resample;
  about["rate_hz"] = nlohmann::json(settings.rate_hz).dump();
  about["trace_header"] = nlohmann::json(trace.header).dump();
  about["build"] = nlohmann::json(build_info()).dump();
  if (const auto phases = trace.header.find("phases"); phases != trace.header.end()) about["phases"] = phases->second;

  ReplaySummary summary;
  summary.loss = trace.loss;
  RunWriter writer(out_path, about);
  const std::size_t total = samples.size();
  for (std::size_t i = 0; i < total; ++i) {
    const Sample sample = samples.at(i);
    const auto wall = std::chrono::steady_clock::now();
    const double cpu = thread_cpu_us();
    const StepResult& result = session.step(sample);
    const double cpu_us = thread_cpu_us() - cpu;
    Timing timing = session.timing();
    timing.cpu_us = cpu_us;
    timing.wall_us = std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - wall).count();
    writer.add(result, timing, session.contacts());
    ++summary.steps;
    ++summary.steps_by_status[result.status];
    if (progress && (i % (total / 100 + 1) == 0) && !progress(i, total)) {
      summary.stopped = true;
      return summary;  // the writer, not closed, takes its file away
    }
  }
  summary.content_fnv1a64 = writer.close();
  if (progress) progress(total, total);
  return summary;
}

}  // namespace palmar
