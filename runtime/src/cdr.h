// CDR as ROS 2 writes it: four bytes that say "little-endian, plain CDR", then the fields, each aligned to its own size
// counted from behind those four bytes; a sequence is a uint32 count and its elements.
//
// One list of fields serves both ways: `template <class Cdr> void fields(Cdr& cdr, Message& m) { cdr(m.a); cdr(m.b);
// }`.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <span>
#include <type_traits>
#include <vector>

namespace palmar {

static_assert(std::endian::native == std::endian::little, "numbers are copied as they lie in memory");

inline constexpr std::array<std::uint8_t, 4> kCdrLittleEndian{0, 1, 0, 0};

class CdrEncoder {
 public:
  // Forgets what was encoded before; the memory is kept.
  void start() { bytes_.assign(kCdrLittleEndian.begin(), kCdrLittleEndian.end()); }
  std::span<const std::uint8_t> bytes() const { return bytes_; }

  void operator()(bool value) { bytes_.push_back(value ? 1 : 0); }
  template <class T>
    requires(std::is_arithmetic_v<T> && !std::is_same_v<T, bool>)
  void operator()(const T& value) {
    append(&value, sizeof(T), 1);
  }
  template <class T, std::size_t n>
  void operator()(const std::array<T, n>& values) {
    append(values.data(), sizeof(T), n);
  }
  template <class T>
  void operator()(const std::vector<T>& values) {
    (*this)(static_cast<std::uint32_t>(values.size()));
    if (!values.empty()) append(values.data(), sizeof(T), values.size());
  }

 private:
  void append(const void* from, std::size_t size, std::size_t count) {
    const std::size_t body = bytes_.size() - kCdrLittleEndian.size();
    const std::size_t start = kCdrLittleEndian.size() + (body + size - 1) / size * size;
    bytes_.resize(start + size * count, 0);
    std::memcpy(bytes_.data() + start, from, size * count);
  }

  std::vector<std::uint8_t> bytes_{kCdrLittleEndian.begin(), kCdrLittleEndian.end()};
};

// Past the end it leaves the values as they are and whole() stays false; nothing is allocated that the bytes do not
// hold.
class CdrDecoder {
 public:
  explicit CdrDecoder(std::span<const std::uint8_t> bytes) : bytes_(bytes) {
    // The last two bytes of the head are options without meaning for plain CDR.
    ok_ = bytes.size() >= 4 && bytes[0] == kCdrLittleEndian[0] && bytes[1] == kCdrLittleEndian[1];
    at_ = ok_ ? 4 : bytes.size();
  }
  // True if every field was there and nothing follows but the padding to a multiple of four that some encoders add.
  bool whole() const { return ok_ && bytes_.size() - at_ < 4; }

  void operator()(bool& value) {
    std::uint8_t raw = 0;
    (*this)(raw);
    value = raw != 0;
  }
  template <class T>
    requires(std::is_arithmetic_v<T> && !std::is_same_v<T, bool>)
  void operator()(T& value) {
    copy(&value, sizeof(T), 1);
  }
  template <class T, std::size_t n>
  void operator()(std::array<T, n>& values) {
    copy(values.data(), sizeof(T), n);
  }
  template <class T>
  void operator()(std::vector<T>& values) {
    std::uint32_t count = 0;
    (*this)(count);
    ok_ = ok_ && count <= (bytes_.size() - at_) / sizeof(T);
    values.resize(ok_ ? count : 0);
    if (!values.empty()) copy(values.data(), sizeof(T), count);
  }

 private:
  void copy(void* to, std::size_t size, std::size_t count) {
    if (!ok_) return;
    const std::size_t start = 4 + (at_ - 4 + size - 1) / size * size;
    ok_ = start <= bytes_.size() && size * count <= bytes_.size() - start;
    if (!ok_) return;
    std::memcpy(to, bytes_.data() + start, size * count);
    at_ = start + size * count;
  }

  std::span<const std::uint8_t> bytes_;
  std::size_t at_ = 0;
  bool ok_ = false;
};

}  // namespace palmar
