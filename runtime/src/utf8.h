// Which bytes are text.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace palmar {

// Length of the UTF-8 character that starts at `at`, 0 if none does.
inline std::size_t utf8_length(std::string_view text, std::size_t at) {
  const auto lead = static_cast<std::uint8_t>(text[at]);
  const std::size_t length = lead < 0x80                   ? 1
                             : lead >= 0xC2 && lead < 0xE0 ? 2
                             : lead >= 0xE0 && lead < 0xF0 ? 3
                             : lead >= 0xF0 && lead < 0xF5 ? 4
                                                           : 0;
  if (length == 0 || length > text.size() - at) return 0;
  std::uint32_t code = length == 1 ? lead : lead & (0x7F >> length);
  for (std::size_t k = 1; k < length; ++k) {
    const auto next = static_cast<std::uint8_t>(text[at + k]);
    if ((next & 0xC0) != 0x80) return 0;
    code = code << 6 | (next & 0x3F);
  }
  const bool surrogate = code >= 0xD800 && code < 0xE000;
  const bool too_long = (length == 3 && code < 0x800) || (length == 4 && (code < 0x10000 || code > 0x10FFFF));
  return surrogate || too_long ? 0 : length;
}

inline bool is_utf8(std::string_view text) {
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t length = utf8_length(text, at);
    if (length == 0) return false;
    at += length;
  }
  return true;
}

// One line of text to show, whatever a file says: control characters and what is no text as \x0a, the end cut off
// where it goes on for ever.
inline std::string one_line(std::string_view text) {
  constexpr std::size_t kLongest = 1000;
  constexpr const char* kDigits = "0123456789abcdef";
  std::string line;
  for (std::size_t at = 0; at < text.size();) {
    if (line.size() >= kLongest) return line + "...";
    const auto byte = static_cast<std::uint8_t>(text[at]);
    const std::size_t length = byte < 0x20 || byte == 0x7F ? 0 : utf8_length(text, at);
    if (length > 0)
      line += text.substr(at, length);
    else
      line += {'\\', 'x', kDigits[byte >> 4], kDigits[byte & 15]};
    at += length > 0 ? length : 1;
  }
  return line;
}

}  // namespace palmar
