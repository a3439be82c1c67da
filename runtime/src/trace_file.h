// Traces as files: docs/formats.md, "Trace".
#pragma once

#include <string>

#include "records.h"

namespace palmar {

// Both throw Error when header or values break the format: E-TRACE-HEADER, E-TRACE-VALUE (not finite, or a rotation
// whose norm is not 1 within 1e-3), E-TRACE-EMPTY.

// What is whole is given, Trace::loss counts the rest; a sample whose time does not increase is dropped and counted.
// Also throws E-TRACE-MISSING, E-TRACE-FORMAT, E-TRACE-SCHEMA, E-TRACE-CRC, E-TRACE-COMPRESSION.
Trace read_trace(const std::string& path);

// The file appears whole or not at all. Times must rise (E-TRACE-TIME). Trace::loss is not written.
void write_trace(const std::string& path, const Trace& trace);

}  // namespace palmar
