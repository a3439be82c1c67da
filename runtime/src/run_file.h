// Runs as files: docs/formats.md, "Run".
#pragma once

#include <span>
#include <string>

#include "cdr.h"
#include "mcap_reader.h"
#include "mcap_writer.h"
#include "records.h"
#include "schemas.h"

namespace palmar {

// Throws Error E-TRACE-WRITE when the disk fails, E-TRACE-SCHEMA or E-TRACE-HEADER for a header that cannot be stored.
// Without close() no file stays.
class RunWriter {
 public:
  // The key `schema` is filled in.
  RunWriter(const std::string& path, Header header);
  // Times of the steps must rise.
  void add(const StepResult& step, const Timing& timing, std::span<const Contact> contacts);
  // Writes the end record and gives its content_fnv1a64: 16 hex digits over every payload of /graphic_hand and
  // /contacts.
  std::string close();

 private:
  void add_hashed(std::uint16_t channel, std::uint64_t log_time_ns);

  std::string path_;
  McapWriter writer_;
  std::uint16_t steps_, contacts_, timing_;
  CdrEncoder cdr_;
  ContactColumns columns_;
  std::uint64_t count_ = 0, hash_;
  double last_time_s_ = -1;
};

// What is whole is given, Run::loss counts the rest; unclosed also says that the end record is missing. The header also
// has `steps` and `content_fnv1a64` of the end record. A step without its timing has NaN there. Throws Error
// E-TRACE-MISSING, E-TRACE-FORMAT, E-TRACE-SCHEMA, E-TRACE-EMPTY, E-TRACE-COMPRESSION, and E-TRACE-CRC when nothing is
// lost and yet the content hash differs.
Run read_run(const std::string& path);
// The same of a file that is read; `path` is for errors alone.
Run run_of(const McapFile& file, const std::string& path);

}  // namespace palmar
