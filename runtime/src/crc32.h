// The CRC of MCAP: the one of zlib and Ethernet, polynomial 0xEDB88320 reflected.
#pragma once

#include <cstdint>
#include <span>

namespace palmar {

// CRC of some bytes that follow those which gave `before` (0 for none). Never fails.
std::uint32_t crc32(std::span<const std::uint8_t> bytes, std::uint32_t before = 0);

}  // namespace palmar
