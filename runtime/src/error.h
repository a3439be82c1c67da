// What was wrong with an input, in the form that every face of Palmar shows: code, place, message.
#pragma once

#include <stdexcept>
#include <string>

namespace palmar {

// code such as "E-TRACE-CRC"; where: file and place inside it; message: what was found, what is allowed.
struct Error : std::runtime_error {
  Error(std::string code_, std::string where_, std::string message_)
      : std::runtime_error(code_ + " " + where_ + ": " + message_),
        code(std::move(code_)),
        where(std::move(where_)),
        message(std::move(message_)) {}
  std::string code, where, message;
};

}  // namespace palmar
