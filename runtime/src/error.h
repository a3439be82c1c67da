// What was wrong with an input, in the form that every face of Palmar shows: code, place, message.
#pragma once

#include <stdexcept>
#include <string>

namespace palmar {

// One line, whatever a file says: control characters as \x0a.
inline std::string one_line(const std::string& text) {
  constexpr const char* kDigits = "0123456789abcdef";
  std::string line;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 0x20 || byte == 0x7f)
      line += {'\\', 'x', kDigits[byte >> 4], kDigits[byte & 15]};
    else
      line += c;
  }
  return line;
}

// code such as "E-TRACE-CRC"; where: file and place inside it; message: what was found, what is allowed.
struct Error : std::runtime_error {
  Error(std::string code_, std::string where_, std::string message_)
      : std::runtime_error(one_line(code_ + " " + where_ + ": " + message_)),
        code(std::move(code_)),
        where(std::move(where_)),
        message(std::move(message_)) {}
  std::string code, where, message;
};

}  // namespace palmar
