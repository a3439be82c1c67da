// Writes MCAP: schemas and channels first, then chunks with CRC and message index, then the summary that lets readers
// seek.
#pragma once

#include <cstdio>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "mcap.h"

namespace palmar {

class McapWriter {
 public:
  enum class Place {
    kNamedOnClose,  // under a temporary name beside `path` until close(); without close() nothing stays
    kNamedOnFlush,  // takes its name with the first chunk, each of which is flushed: for recorders, where a torn file
                    // is worth having and one without a chunk is not; never that of another file. A device is
                    // written where it is
  };

  // Every function but the destructor throws Error E-TRACE-WRITE when the disk does not take the bytes.
  explicit McapWriter(std::string path, Place place = Place::kNamedOnClose);
  ~McapWriter();
  McapWriter(const McapWriter&) = delete;
  McapWriter& operator=(const McapWriter&) = delete;

  // A channel for CDR messages with its `ros2msg` schema; gives its number. All channels come before the first message.
  std::uint16_t add_channel(const std::string& topic, const std::string& schema_name, const std::string& schema_text);
  // Error E-TRACE-HEADER if the record would be above 1 MiB, is not UTF-8, or uses the key of its own CRC.
  void add_metadata(const std::string& name, const std::map<std::string, std::string>& values);
  // That error alone, before there is a file.
  static void check_metadata(const std::string& path, const std::string& name,
                             const std::map<std::string, std::string>& values);
  // Messages of one time always lie in one chunk, so that damage never tears a step from its contacts.
  void add_message(std::uint16_t channel, std::uint64_t log_time_ns, mcap::Bytes payload);
  // Ends the chunk; with kNamedOnFlush it is then with the system, and survives the death of this process.
  void flush();
  void close();

 private:
  struct Channel {
    std::vector<std::uint8_t> schema_record, channel_record;
    std::uint32_t messages = 0;
    std::vector<std::pair<std::uint64_t, std::uint64_t>> in_chunk;  // log time, offset in the chunk
  };

  struct Opened {};
  McapWriter(std::string path, Place place, Opened);  // the file alone: from here on the destructor takes it away

  void write(mcap::Bytes bytes);
  void write_data(mcap::Bytes bytes);
  void finish_chunk();
  void flush_file();
  void take_name();
  void abandon();
  [[noreturn]] void fail(const char* what);
  [[noreturn]] void refuse(const char* what, int why) const;

  std::string path_, written_path_;
  Place place_;
  std::FILE* file_ = nullptr;
  std::uint64_t offset_ = 0;
  std::uint32_t data_crc_ = 0;
  std::vector<Channel> channels_;
  std::vector<std::uint8_t> chunk_;
  std::uint64_t chunk_first_ns_ = 0, chunk_last_ns_ = 0;
  std::uint64_t first_ns_ = UINT64_MAX, last_ns_ = 0, messages_ = 0;
  std::uint32_t chunks_ = 0, metadata_ = 0;
  std::vector<std::uint8_t> chunk_indexes_, metadata_indexes_;
};

}  // namespace palmar
