// Traces as files: docs/formats.md, "Trace".
#pragma once

#include <string>

#include "cdr.h"
#include "mcap_reader.h"
#include "mcap_writer.h"
#include "records.h"

namespace palmar {

// Both throw Error when header or values break the format: E-TRACE-HEADER, E-TRACE-VALUE (not finite, or a rotation
// whose norm is not 1 within 1e-3), E-TRACE-EMPTY.

// What is whole is given, Trace::loss counts the rest; a sample whose time does not increase is dropped and counted.
// Also throws E-TRACE-MISSING, E-TRACE-FORMAT, E-TRACE-SCHEMA, E-TRACE-CRC, E-TRACE-COMPRESSION.
Trace read_trace(const std::string& path);
// The same of a file that is read; `path` is for errors alone.
Trace trace_of(const McapFile& file, const std::string& path);

// As read_trace, but a sample whose values break the format is left out and counted too, and a header that is damaged
// is taken to be `spare`, unless that is empty.
Trace salvage_trace(const std::string& path, const Header& spare);
// The same of a file that was read; `path` is for errors alone.
Trace salvage_of(const McapFile& file, const std::string& path, const Header& spare);

// The file appears whole or not at all. Times must rise (E-TRACE-TIME). Trace::loss is not written.
void write_trace(const std::string& path, const Trace& trace);

// True for a sample that a trace can hold: its values, not its order. Neither throws nor allocates.
bool is_storable(const Sample& sample);

// True if two traces have the same header and the same messages, bit for bit; losses are not compared.
bool same_content(const Trace& a, const Trace& b);

// Writes a trace while its samples come. Header as above; that values are storable and times rise is the caller's part.
class TraceWriter {
 public:
  // Which channels there are beside that of the samples.
  struct Beside {
    bool device_bytes = false, pose_bytes = false, readings = false;
  };
  TraceWriter(const std::string& path, Header header, McapWriter::Place place, Beside beside);
  void add(const Sample& sample);
  void add(const DeviceReading& reading);
  void add_device_bytes(const DeviceBytes& device);
  void add_pose_bytes(const DeviceBytes& pose);
  void flush() { writer_.flush(); }
  void close() { writer_.close(); }

 private:
  McapWriter writer_;
  std::uint16_t samples_ = 0, device_bytes_ = 0, pose_bytes_ = 0, readings_ = 0;
  CdrEncoder cdr_;
};

}  // namespace palmar
