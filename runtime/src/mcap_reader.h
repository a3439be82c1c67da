// Reads MCAP, also torn or damaged: what a CRC vouches for is given, the rest is left out and counted.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "mcap.h"
#include "records.h"

namespace palmar {

// Texts and payloads lie in McapFile::bytes.
struct McapMessage {
  std::uint16_t channel = 0;
  mcap::Bytes payload;
};

struct McapChannel {
  std::string_view topic, encoding, schema_name, schema_encoding, schema_text;
};

struct McapFile {
  std::vector<std::uint8_t> bytes;
  std::map<std::uint16_t, McapChannel> channels;
  std::vector<McapMessage> messages;  // in the order of the file
  std::map<std::string, Header> metadata;
  bool damaged_metadata = false;  // at least one record was left out
  Loss loss;

  McapFile() = default;
  McapFile(McapFile&&) = default;
  McapFile& operator=(McapFile&&) = default;
};

// Every CRC is checked. A chunk is given whole or not at all. Errors: E-TRACE-MISSING, E-TRACE-SIZE (above 2 GiB),
// E-TRACE-READ (the disk failed), E-TRACE-FORMAT (not MCAP), E-TRACE-COMPRESSION (a compressed chunk).
McapFile read_mcap(const std::string& path);
// The same of a file's bytes; `path` is for errors alone.
McapFile mcap_of(std::vector<std::uint8_t> bytes, const std::string& path);

}  // namespace palmar
