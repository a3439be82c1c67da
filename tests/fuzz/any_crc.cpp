// In place of crc32.cpp in fuzz targets: nobody guesses CRCs, so every one is 1. 0 stays "none", anything else a
// damage.
#include "crc32.h"

namespace palmar {

std::uint32_t crc32(std::span<const std::uint8_t>, std::uint32_t) { return 1; }

}  // namespace palmar
