// What the targets share. A target is one function over bytes; what it must not do is crash, throw anything but Error,
// or break what its reader promises. tests/fuzz/*.cpp: one target each.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "error.h"

// Stops the program where a promise is broken, so that the fuzzer keeps the input.
#define MUST(condition)                                                            \
  do {                                                                             \
    if (!(condition)) {                                                            \
      std::fprintf(stderr, "%s:%d: broken: %s\n", __FILE__, __LINE__, #condition); \
      std::abort();                                                                \
    }                                                                              \
  } while (0)

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

// Runs `read`, which may refuse its input with a code that begins so. True if it did not.
template <class Read>
bool reads(const char* code, Read read) {
  try {
    read();
    return true;
  } catch (const palmar::Error& error) {
    MUST(error.code.rfind(code, 0) == 0);
    MUST(!error.where.empty() && !error.message.empty());
    MUST(std::strchr(error.what(), '\n') == nullptr);
    return false;
  }
}
