// What reader and writer share of the MCAP format (mcap.dev/spec): opcodes, the magic, a cursor that cannot leave its
// bytes.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <map>
#include <span>
#include <string>
#include <string_view>

namespace palmar::mcap {

static_assert(std::endian::native == std::endian::little, "numbers are copied as they lie in memory");

inline constexpr std::array<std::uint8_t, 8> kMagic{0x89, 'M', 'C', 'A', 'P', 0x30, '\r', '\n'};

enum Opcode : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kStatistics = 0x0B,
  kMetadata = 0x0C,
  kMetadataIndex = 0x0D,
  kSummaryOffset = 0x0E,
  kDataEnd = 0x0F,
};

inline constexpr std::size_t kRecordHead = 1 + 8;  // opcode, length
inline constexpr std::size_t kMessageHead = 2 + 4 + 8 + 8;
inline constexpr std::size_t kChunkHead = 8 + 8 + 8 + 4 + 4 + 8;  // of an uncompressed chunk
inline constexpr std::size_t kDataEndSize = kRecordHead + 4;
inline constexpr std::size_t kFooterSize = kRecordHead + 8 + 8 + 4;

// A Metadata record is outside of every chunk, so the format gives it no CRC of its own. We add one as a value under
// this key: eight hex digits over name, keys and values in the order of the keys, this key left out.
inline constexpr const char* kOwnCrcKey = "crc32";
inline constexpr std::size_t kMetadataLimit = 1 << 20;

std::string metadata_crc(const std::string& name, const std::map<std::string, std::string>& values);

using Bytes = std::span<const std::uint8_t>;

// Reads forward in `bytes`. Past the end it gives zeros and empty spans and `ok` stays false.
class Cursor {
 public:
  explicit Cursor(Bytes bytes) : bytes_(bytes) {}

  template <class T>
  T number() {
    T value{};
    const Bytes raw = take(sizeof(T));
    if (raw.size() == sizeof(T)) std::memcpy(&value, raw.data(), sizeof(T));
    return value;
  }
  Bytes take(std::uint64_t count) {
    if (count > bytes_.size() - at_) {
      ok_ = false;
      at_ = bytes_.size();
      return {};
    }
    const Bytes found = bytes_.subspan(at_, count);
    at_ += count;
    return found;
  }
  std::string_view text() {
    const Bytes raw = take(number<std::uint32_t>());
    return {reinterpret_cast<const char*>(raw.data()), raw.size()};
  }
  std::size_t left() const { return bytes_.size() - at_; }
  std::size_t at() const { return at_; }
  bool ok() const { return ok_; }

 private:
  Bytes bytes_;
  std::size_t at_ = 0;
  bool ok_ = true;
};

}  // namespace palmar::mcap
