#include "mcap_writer.h"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <random>

#include "crc32.h"
#include "error.h"
#include "utf8.h"

namespace palmar {

using namespace mcap;

namespace {

// A killed writer loses at most one chunk: 64 KiB or a quarter of a second, whichever is less.
constexpr std::size_t kChunkBytes = 64 * 1024;
constexpr std::uint64_t kChunkSpanNs = 250'000'000;

using Buffer = std::vector<std::uint8_t>;

void put(Buffer& to, Bytes bytes) { to.insert(to.end(), bytes.begin(), bytes.end()); }

template <class T>
void put(Buffer& to, T value)
  requires std::is_integral_v<T>
{
  const std::size_t at = to.size();
  to.resize(at + sizeof(T));
  std::memcpy(to.data() + at, &value, sizeof(T));
}

void put_text(Buffer& to, std::string_view text) {
  put(to, static_cast<std::uint32_t>(text.size()));
  to.insert(to.end(), text.begin(), text.end());
}

void put_record(Buffer& to, Opcode opcode, Bytes content) {
  to.push_back(opcode);
  put(to, static_cast<std::uint64_t>(content.size()));
  put(to, content);
}

Buffer record(Opcode opcode, Bytes content) {
  Buffer whole;
  put_record(whole, opcode, content);
  return whole;
}

Buffer texts_by_name(const std::map<std::string, std::string>& values) {
  Buffer all;
  for (const auto& [key, value] : values) {
    put_text(all, key);
    put_text(all, value);
  }
  return all;
}

// What takes no other file in its place.
bool is_device(const std::string& path) {
  std::error_code unknown;
  const std::filesystem::file_status there = std::filesystem::status(path, unknown);
  return std::filesystem::is_character_file(there) || std::filesystem::is_fifo(there);
}

std::string temporary_beside(const std::string& path) {
  std::random_device random;
  char suffix[24];
  std::snprintf(suffix, sizeof suffix, ".%08x.part", random());
  return path + suffix;
}

}  // namespace

std::string mcap::metadata_crc(const std::string& name, const std::map<std::string, std::string>& values) {
  Buffer content;
  put_text(content, name);
  put(content, texts_by_name(values));
  char digits[9];
  std::snprintf(digits, sizeof digits, "%08x", crc32(content));
  return digits;
}

McapWriter::McapWriter(std::string path, Place place, Opened)
    : path_(std::move(path)),
      written_path_(is_device(path_) ? path_ : temporary_beside(path_)),
      place_(place),
      file_(std::fopen(written_path_.c_str(), written_path_ == path_ ? "wb" : "wbx")) {
  if (!file_) refuse("cannot be created", errno);
}

McapWriter::McapWriter(std::string path, Place place) : McapWriter(std::move(path), place, Opened{}) {
  Buffer start(kMagic.begin(), kMagic.end());
  Buffer header;
  put_text(header, "ros2");
  put_text(header, "palmar");
  put_record(start, kHeader, header);
  write_data(start);
}

McapWriter::~McapWriter() {
  if (file_) abandon();
}

std::uint16_t McapWriter::add_channel(const std::string& topic, const std::string& schema_name,
                                      const std::string& schema_text) {
  const auto id = static_cast<std::uint16_t>(channels_.size() + 1);
  Channel channel;
  Buffer content;
  put(content, id);
  put_text(content, schema_name);
  put_text(content, "ros2msg");
  put_text(content, schema_text);
  channel.schema_record = record(kSchema, content);
  content.clear();
  put(content, id);
  put(content, id);
  put_text(content, topic);
  put_text(content, "cdr");
  put_text(content, "");
  channel.channel_record = record(kChannel, content);
  // Before the chunks, not in the first of them: losing a chunk must not make the others unreadable.
  write_data(channel.schema_record);
  write_data(channel.channel_record);
  channels_.push_back(std::move(channel));
  return id;
}

void McapWriter::check_metadata(const std::string& path, const std::string& name,
                                const std::map<std::string, std::string>& values) {
  if (values.count(kOwnCrcKey))
    throw Error("E-TRACE-HEADER", path + ":" + name + "." + kOwnCrcKey, "this key is kept for the record's own CRC");
  for (const auto& [key, value] : values)
    if (!is_utf8(key) || !is_utf8(value))
      throw Error("E-TRACE-HEADER", path + ":" + name + "." + (is_utf8(key) ? key : "?"),
                  "is not UTF-8, as every text of a header must be");
  const std::size_t size = texts_by_name(values).size();
  if (size > kMetadataLimit - 64)  // the CRC needs some
    throw Error("E-TRACE-HEADER", path + ":" + name,
                std::to_string(size) + " bytes; at most " + std::to_string(kMetadataLimit - 64) + " are allowed");
}

void McapWriter::add_metadata(const std::string& name, const std::map<std::string, std::string>& values) {
  check_metadata(path_, name, values);
  std::map<std::string, std::string> checked = values;
  checked[kOwnCrcKey] = metadata_crc(name, values);
  const Buffer texts = texts_by_name(checked);
  finish_chunk();
  Buffer content;
  put_text(content, name);
  put(content, static_cast<std::uint32_t>(texts.size()));
  put(content, texts);
  const Buffer whole = record(kMetadata, content);
  Buffer index;
  put(index, offset_);
  put(index, static_cast<std::uint64_t>(whole.size()));
  put_text(index, name);
  put_record(metadata_indexes_, kMetadataIndex, index);
  ++metadata_;
  write_data(whole);
}

void McapWriter::add_message(std::uint16_t channel, std::uint64_t log_time_ns, Bytes payload) {
  const bool full = chunk_.size() >= kChunkBytes || log_time_ns >= chunk_first_ns_ + kChunkSpanNs;
  if (!chunk_.empty() && full && log_time_ns != chunk_last_ns_) finish_chunk();
  if (chunk_.empty()) {
    chunk_first_ns_ = chunk_last_ns_ = log_time_ns;
    chunk_.reserve(kChunkBytes + kChunkBytes / 4);
  }
  chunk_first_ns_ = std::min(chunk_first_ns_, log_time_ns);
  chunk_last_ns_ = std::max(chunk_last_ns_, log_time_ns);
  first_ns_ = std::min(first_ns_, log_time_ns);
  last_ns_ = std::max(last_ns_, log_time_ns);
  ++messages_;

  Channel& to = channels_.at(channel - 1u);
  to.in_chunk.emplace_back(log_time_ns, chunk_.size());
  chunk_.push_back(kMessage);
  put(chunk_, static_cast<std::uint64_t>(kMessageHead + payload.size()));
  put(chunk_, channel);
  put(chunk_, to.messages++);
  put(chunk_, log_time_ns);
  put(chunk_, log_time_ns);
  put(chunk_, payload);
}

void McapWriter::finish_chunk() {
  if (chunk_.empty()) return;
  const auto size = static_cast<std::uint64_t>(chunk_.size());
  const std::uint64_t chunk_start = offset_;
  Buffer head;
  head.push_back(kChunk);
  put(head, kChunkHead + size);
  put(head, chunk_first_ns_);
  put(head, chunk_last_ns_);
  put(head, size);
  put(head, crc32(chunk_));
  put_text(head, "");
  put(head, size);
  write_data(head);
  write_data(chunk_);

  const std::uint64_t indexes_start = offset_;
  Buffer indexes, offsets;
  for (std::size_t i = 0; i < channels_.size(); ++i) {
    auto& entries = channels_[i].in_chunk;
    if (entries.empty()) continue;
    put(offsets, static_cast<std::uint16_t>(i + 1));
    put(offsets, indexes_start + indexes.size());
    Buffer content;
    put(content, static_cast<std::uint16_t>(i + 1));
    put(content, static_cast<std::uint32_t>(16 * entries.size()));
    for (const auto& [time_ns, at] : entries) {
      put(content, time_ns);
      put(content, at);
    }
    put_record(indexes, kMessageIndex, content);
    entries.clear();
  }
  write_data(indexes);

  Buffer content;
  put(content, chunk_first_ns_);
  put(content, chunk_last_ns_);
  put(content, chunk_start);
  put(content, indexes_start - chunk_start);
  put(content, static_cast<std::uint32_t>(offsets.size()));
  put(content, offsets);
  put(content, static_cast<std::uint64_t>(indexes.size()));
  put_text(content, "");
  put(content, size);
  put(content, size);
  put_record(chunk_indexes_, kChunkIndex, content);
  ++chunks_;
  chunk_.clear();
  if (place_ == Place::kNamedOnFlush) {
    flush_file();
    take_name();
  }
}

void McapWriter::flush() {
  finish_chunk();
  flush_file();
}

void McapWriter::close() {
  finish_chunk();
  Buffer content;
  put(content, data_crc_);
  write(record(kDataEnd, content));

  const std::uint64_t summary_start = offset_;
  Buffer summary, groups;
  auto end_group = [&, start = std::size_t{0}](Opcode opcode) mutable {
    if (summary.size() > start) {
      Buffer group;
      group.push_back(opcode);
      put(group, summary_start + start);
      put(group, static_cast<std::uint64_t>(summary.size() - start));
      put_record(groups, kSummaryOffset, group);
    }
    start = summary.size();
  };
  for (const Channel& channel : channels_) put(summary, channel.schema_record);
  end_group(kSchema);
  for (const Channel& channel : channels_) put(summary, channel.channel_record);
  end_group(kChannel);
  Buffer statistics, counts;
  for (std::size_t i = 0; i < channels_.size(); ++i) {
    put(counts, static_cast<std::uint16_t>(i + 1));
    put(counts, static_cast<std::uint64_t>(channels_[i].messages));
  }
  put(statistics, messages_);
  put(statistics, static_cast<std::uint16_t>(channels_.size()));
  put(statistics, static_cast<std::uint32_t>(channels_.size()));
  put(statistics, std::uint32_t{0});  // attachments
  put(statistics, metadata_);
  put(statistics, chunks_);
  put(statistics, messages_ ? first_ns_ : 0);
  put(statistics, last_ns_);
  put(statistics, static_cast<std::uint32_t>(counts.size()));
  put(statistics, counts);
  put_record(summary, kStatistics, statistics);
  end_group(kStatistics);
  put(summary, chunk_indexes_);
  end_group(kChunkIndex);
  put(summary, metadata_indexes_);
  end_group(kMetadataIndex);
  const std::uint64_t groups_start = summary_start + summary.size();
  put(summary, groups);

  // The summary's CRC runs on into the footer, up to the CRC itself.
  summary.push_back(kFooter);
  put(summary, std::uint64_t{8 + 8 + 4});
  put(summary, summary_start);
  put(summary, groups_start);
  put(summary, crc32(summary));
  put(summary, kMagic);
  write(summary);

  std::FILE* file = std::exchange(file_, nullptr);
  if (std::fclose(file) != 0) fail("cannot be written");
  take_name();
}

void McapWriter::take_name() {
  if (written_path_ == path_) return;
  std::error_code unknown;
  if (place_ == Place::kNamedOnFlush && std::filesystem::exists(path_, unknown)) {
    errno = EEXIST;
    fail("cannot take its name");
  }
  if (std::rename(written_path_.c_str(), path_.c_str()) != 0) fail("cannot take its name");
  written_path_ = path_;
}

void McapWriter::write(Bytes bytes) {
  if (!file_ || std::fwrite(bytes.data(), 1, bytes.size(), file_) != bytes.size()) fail("cannot be written");
  offset_ += bytes.size();
}

void McapWriter::write_data(Bytes bytes) {
  data_crc_ = crc32(bytes, data_crc_);
  write(bytes);
}

void McapWriter::flush_file() {
  if (std::fflush(file_) != 0) fail("cannot be written");
}

void McapWriter::abandon() {
  if (file_) std::fclose(std::exchange(file_, nullptr));
  if (written_path_ != path_) std::remove(written_path_.c_str());
}

void McapWriter::fail(const char* what) {
  const int why = errno;
  abandon();
  refuse(what, why);
}

void McapWriter::refuse(const char* what, int why) const {
  throw Error("E-TRACE-WRITE", path_,
              std::string(what) + " (" + std::strerror(why) + "); its folder must exist and have room");
}

}  // namespace palmar
