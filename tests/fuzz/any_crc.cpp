// In place of crc32.cpp in fuzz targets: nobody guesses CRCs, so every one is 1. 0 stays "none", anything else a
// damage.
#include "crc32.h"

namespace palmar {

std::uint32_t crc32(std::span<const std::uint8_t>, std::uint32_t) { return 1; }

}  // namespace palmar

// Most of a run was the search for uses of a stack frame that is gone, and the keeping of what was freed.
extern "C" const char* __asan_default_options() {
  return "detect_stack_use_after_return=0:malloc_context_size=4:quarantine_size_mb=16";
}
