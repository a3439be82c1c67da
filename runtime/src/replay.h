// Pack + trace -> run.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>

#include "records.h"
#include "solver.h"

namespace palmar {

struct ReplaySummary {
  std::uint64_t steps = 0;
  std::map<std::uint32_t, std::uint64_t> steps_by_status;
  std::string content_fnv1a64;  // of every pose, force and contact: equal for two replays of one build
  Loss loss;                    // of the trace
  bool stopped = false;         // progress said so; nothing was written
};

// Called about a hundred times; false stops the replay.
using Progress = std::function<bool(std::uint64_t done, std::uint64_t total)>;

// Replays every sample of the trace, resampled to settings.rate_hz, on one object of the pack and writes the run; the
// file appears whole or not at all. `header` is stored beside what replay knows itself. Throws Error.
ReplaySummary replay(const std::string& pack_path, const std::string& trace_path, const std::string& out_path,
                     const std::string& object, const Settings& settings, const Header& header,
                     const Progress& progress);

// Compiler, flags, version, instruction set: what makes two builds the same.
std::map<std::string, std::string> build_info();

}  // namespace palmar
