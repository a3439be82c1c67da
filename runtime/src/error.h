// What was wrong with an input, in the form that every face of Palmar shows: code, place, message.
#pragma once

#include <stdexcept>
#include <string>

#include "utf8.h"

namespace palmar {

// code such as "E-TRACE-CRC"; where: file and place inside it; message: what was found, what is allowed. All of it text
// in one line, whatever a file says.
struct Error : std::runtime_error {
  Error(const std::string& code_, const std::string& where_, const std::string& message_)
      : std::runtime_error(one_line(code_) + " " + one_line(where_) + ": " + one_line(message_)),
        code(one_line(code_)),
        where(one_line(where_)),
        message(one_line(message_)) {}
  std::string code, where, message;
};

}  // namespace palmar
