#include "mcap_reader.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <optional>

#include "crc32.h"
#include "error.h"
#include "utf8.h"

namespace palmar {

using namespace mcap;

namespace {

constexpr std::uintmax_t kFileLimit = std::uintmax_t{2} << 30;

std::vector<std::uint8_t> read_bytes(const std::string& path) {
  std::error_code problem;
  if (!std::filesystem::is_regular_file(path, problem))
    throw Error("E-TRACE-MISSING", path,
                problem ? problem.message() + "; an MCAP file is needed" : "no such file; an MCAP file is needed");
  const std::uintmax_t size = std::filesystem::file_size(path, problem);
  if (!problem && size > kFileLimit)
    throw Error("E-TRACE-SIZE", path, std::to_string(size >> 20) + " MiB; at most 2048 MiB are read");
  std::vector<std::uint8_t> bytes(problem ? 0 : size);  // before the file is open, for there may be no room
  std::FILE* file = problem ? nullptr : std::fopen(path.c_str(), "rb");
  if (!file) throw Error("E-TRACE-MISSING", path, std::string(std::strerror(errno)) + "; an MCAP file is needed");
  bytes.resize(std::fread(bytes.data(), 1, bytes.size(), file));
  const bool failed = std::ferror(file) != 0;
  std::fclose(file);
  // A disk that fails is not a file that ends.
  if (failed) throw Error("E-TRACE-READ", path, "could not be read to its end");
  return bytes;
}

struct Record {
  std::uint8_t opcode = 0;
  Bytes content;
  std::size_t size() const { return kRecordHead + content.size(); }
};

// The record that starts at `at`, if all of it is there.
std::optional<Record> record_at(Bytes bytes, std::size_t at) {
  Cursor cursor(bytes.subspan(std::min(at, bytes.size())));
  Record record;
  record.opcode = cursor.number<std::uint8_t>();
  record.content = cursor.take(cursor.number<std::uint64_t>());
  if (!cursor.ok() || record.opcode == 0) return std::nullopt;
  return record;
}

struct ChunkHead {
  std::uint64_t uncompressed_size = 0;
  std::uint32_t crc = 0;
  std::string_view compression;
  Bytes records;
  // All lengths agree, so the record ends where it says even if its content is damaged.
  bool consistent = false;
};

ChunkHead chunk_head(Bytes content) {
  Cursor cursor(content);
  ChunkHead head;
  cursor.take(16);  // first and last time
  head.uncompressed_size = cursor.number<std::uint64_t>();
  head.crc = cursor.number<std::uint32_t>();
  head.compression = cursor.text();
  head.records = cursor.take(cursor.number<std::uint64_t>());
  head.consistent =
      cursor.ok() && cursor.left() == 0 && head.compression.empty() && head.uncompressed_size == head.records.size();
  return head;
}

// The walk through one file. What is *sealed* has a CRC of its own that fits; what is *open* hangs on the CRC of the
// whole data section, which many writers leave out.
class Walk {
 public:
  Walk(const std::string& path, McapFile& file)
      : path_(path), file_(file), bytes_(file.bytes), search_budget_(4 * file.bytes.size()) {}

  void run() {
    if (bytes_.size() < kMagic.size() || !std::equal(kMagic.begin(), kMagic.end(), bytes_.begin()))
      throw Error("E-TRACE-FORMAT", path_, "does not start as an MCAP file; traces and runs are MCAP");
    read_summary();
    read_data();
    judge();
    resolve_channels();
  }

 private:
  struct Definition {
    Bytes content;  // behind the number
    bool sealed = false;
  };
  struct Found {
    McapMessage message;
    bool sealed = false;
  };

  // Looks for the footer from the end of the file, past any bytes that came behind it.
  void read_summary() {
    const auto magic = std::find_end(bytes_.begin() + kMagic.size(), bytes_.end(), kMagic.begin(), kMagic.end());
    const auto end = static_cast<std::size_t>(magic - bytes_.begin());
    if (magic == bytes_.end() || end < kMagic.size() + kFooterSize) return;
    const std::size_t footer_at = end - kFooterSize;
    const std::optional<Record> footer = record_at(bytes_.first(end), footer_at);
    if (!footer || footer->opcode != kFooter || footer->size() != kFooterSize) return;
    Cursor cursor(footer->content);
    auto start = cursor.number<std::uint64_t>();
    cursor.take(8);  // where the summary offsets start
    const auto crc = cursor.number<std::uint32_t>();
    if (start == 0) start = footer_at;  // there is no summary
    closed_ = true;
    bytes_behind_ = bytes_.size() - end - kMagic.size();
    bytes_ = bytes_.first(end + kMagic.size());
    if (start < kMagic.size() || start > footer_at) return;
    if (crc != 0 && crc32(bytes_.subspan(start, end - 4 - start)) != crc) return;
    summary_start_ = start;
    const Bytes summary = bytes_.subspan(start, footer_at - start);
    std::size_t at = 0;
    while (const std::optional<Record> record = record_at(summary, at)) {
      if (record->opcode == kSchema || record->opcode == kChannel) define(*record, crc != 0);
      if (record->opcode == kStatistics && crc != 0)
        messages_written_ = Cursor(record->content).number<std::uint64_t>();
      at += record->size();
    }
  }

  void read_data() {
    std::size_t at = kMagic.size();
    std::size_t seal = at;    // end of the last sealed record
    std::size_t damaged = 0;  // bytes of damaged records since then
    while (at < bytes_.size()) {
      const std::optional<Record> record = record_at(bytes_, at);
      if (record && record->opcode == kFooter && record->size() == kFooterSize) break;  // its DataEnd is lost
      if (record && record->opcode == kDataEnd && record->size() == kDataEndSize) {
        const auto crc = Cursor(record->content).number<std::uint32_t>();
        data_ends_ = true;
        data_fits_ = crc == 0 || crc == crc32(bytes_.first(at));
        at += record->size();
        break;
      }
      const Taken taken = record ? take(*record) : kLostPlace;
      if (taken == kLostPlace) {
        // A length is wrong: of this record, or of an open one since the last seal. Go on at the next chunk that is
        // whole.
        const std::size_t next = find_chunk(seal);
        if (next == bytes_.size()) {
          if (!record) count_torn(at);
          damaged += bytes_.size() - at;
          at = next;
          break;
        }
        file_.loss.bytes += next - seal;
        damaged = 0;
        at = seal = next;
        continue;
      }
      at += record->size();
      if (taken == kDamaged) damaged += record->size();
      if (taken == kSealed) {
        file_.loss.bytes += damaged;
        damaged = 0;
        seal = at;
        sealed_bytes_ += record->size();
      }
    }
    file_.loss.bytes += damaged;
    data_end_ = at;
  }

  enum Taken { kOpen, kSealed, kDamaged, kLostPlace };

  Taken take(const Record& record) {
    switch (record.opcode) {
      case kChunk:
        return take_chunk(record.content);
      case kMetadata:
        return take_metadata(record.content);
      case kSchema:
      case kChannel:
        define(record, false);
        return kOpen;
      case kMessage:
        return add_message(record.content, found_, false) ? kOpen : kDamaged;
      default:
        return kOpen;
    }
  }

  Taken take_chunk(Bytes content) {
    const ChunkHead head = chunk_head(content);
    if (head.compression == "lz4" || head.compression == "zstd")
      throw Error(
          "E-TRACE-COMPRESSION", path_,
          "chunks are compressed with " + std::string(head.compression) +
              "; uncompressed MCAP is read: `mcap filter IN.mcap -o OUT.mcap --output-compression none` makes it");
    const bool sealed = head.crc != 0;
    std::vector<Found> found;
    std::vector<Record> definitions;
    bool whole = head.consistent && (!sealed || crc32(head.records) == head.crc);
    for (std::size_t at = 0; whole && at < head.records.size();) {
      const std::optional<Record> record = record_at(head.records, at);
      whole = record && (record->opcode != kMessage || add_message(record->content, found, sealed));
      if (!whole) break;
      if (record->opcode == kSchema || record->opcode == kChannel) definitions.push_back(*record);
      at += record->size();
    }
    if (!whole) {
      ++file_.loss.chunks;
      lost_messages_ += count_messages(head.records);
      return head.consistent ? kDamaged : kLostPlace;
    }
    for (const Record& record : definitions) define(record, sealed);
    found_.insert(found_.end(), found.begin(), found.end());
    return sealed ? kSealed : kOpen;
  }

  Taken take_metadata(Bytes content) {
    Cursor cursor(content);
    const std::string name(cursor.text());
    const Bytes texts = cursor.take(cursor.number<std::uint32_t>());
    Header values;
    bool whole = cursor.ok() && texts.size() <= kMetadataLimit && is_utf8(name);
    Cursor pair(texts);
    while (whole && pair.left() > 0) {
      const std::string_view key = pair.text(), value = pair.text();
      whole = pair.ok() && is_utf8(key) && is_utf8(value) && values.emplace(key, value).second;
    }
    const auto crc = values.extract(kOwnCrcKey);
    if (!whole || (crc && crc.mapped() != metadata_crc(name, values))) {
      file_.damaged_metadata = true;
      return kDamaged;
    }
    if (crc)
      file_.metadata.emplace(name, std::move(values));
    else
      open_metadata_.emplace(name, std::move(values));
    return crc ? kSealed : kOpen;
  }

  bool add_message(Bytes content, std::vector<Found>& to, bool sealed) {
    if (content.size() < kMessageHead) return false;
    to.push_back({{Cursor(content).number<std::uint16_t>(), content.subspan(kMessageHead)}, sealed});
    return true;
  }

  // The first definition of a number stays, unless only the later one is sealed.
  void define(const Record& record, bool sealed) {
    Cursor cursor(record.content);
    const auto id = cursor.number<std::uint16_t>();
    if (!cursor.ok()) return;
    auto& known = record.opcode == kSchema ? schemas_ : channels_;
    const auto [place, added] = known.try_emplace(id, Definition{record.content.subspan(2), sealed});
    if (!added && sealed && !place->second.sealed) place->second = {record.content.subspan(2), sealed};
  }

  // Where the next chunk starts whose CRC fits; the end if there is none. The budget bounds what a made-up file can
  // cost.
  std::size_t find_chunk(std::size_t from) {
    for (std::size_t at = from; at + kRecordHead + kChunkHead <= bytes_.size(); ++at) {
      if (bytes_[at] != kChunk) continue;
      const std::optional<Record> record = record_at(bytes_, at);
      if (!record) continue;
      const ChunkHead head = chunk_head(record->content);
      if (!head.consistent || head.crc == 0 || head.records.size() > search_budget_) continue;
      search_budget_ -= head.records.size();
      if (crc32(head.records) == head.crc) return at;
    }
    return bytes_.size();
  }

  // The last record, when the file ends inside it.
  void count_torn(std::size_t at) {
    if (bytes_[at] == kMessage) ++lost_messages_;
    if (bytes_[at] != kChunk) return;
    ++file_.loss.chunks;
    lost_messages_ += count_messages(bytes_.subspan(std::min(bytes_.size(), at + kRecordHead + kChunkHead)));
  }

  static std::uint64_t count_messages(Bytes records) {
    std::uint64_t count = 0;
    for (std::size_t at = 0; at < records.size();) {
      if (records[at] == kMessage) ++count;
      const std::optional<Record> record = record_at(records, at);
      if (!record) break;
      at += record->size();
    }
    return count;
  }

  // Decides what is believed, and counts what is not.
  void judge() {
    Loss& loss = file_.loss;
    const bool torn = !data_ends_ && !closed_;
    // A torn file has no CRC to hold open records against. Its header is believed; open messages only if it has no
    // sealed ones, else they are more likely debris.
    const bool any_sealed = std::any_of(found_.begin(), found_.end(), [](const Found& found) { return found.sealed; });
    const bool believe_header = data_fits_ || torn;
    const bool believe_messages = data_fits_ || (torn && !any_sealed);

    if (believe_header)
      file_.metadata.merge(open_metadata_);
    else
      file_.damaged_metadata |= !open_metadata_.empty();
    for (const Found& found : found_) {
      if (found.sealed || believe_messages)
        file_.messages.push_back(found.message);
      else
        ++lost_messages_;
    }
    loss.messages = lost_messages_;
    if (messages_written_)
      loss.messages = *messages_written_ - std::min<std::uint64_t>(*messages_written_, file_.messages.size());
    loss.unclosed = !closed_;
    // The CRC of the data section does not fit and no damage was met on the way: it is somewhere in the open bytes.
    if (!data_fits_ && !torn && loss.bytes == 0) loss.bytes = data_end_ - kMagic.size() - sealed_bytes_;
    if (summary_start_ != data_end_) loss.bytes += bytes_.size() - data_end_;
    loss.bytes += bytes_behind_;
  }

  void resolve_channels() {
    for (const auto& [id, definition] : channels_) {
      Cursor cursor(definition.content);
      const auto schema_id = cursor.number<std::uint16_t>();
      McapChannel channel;
      channel.topic = cursor.text();
      channel.encoding = cursor.text();
      if (const auto schema = schemas_.find(schema_id); schema != schemas_.end()) {
        Cursor text(schema->second.content);
        channel.schema_name = text.text();
        channel.schema_encoding = text.text();
        channel.schema_text = text.text();
      }
      if (cursor.ok()) file_.channels.emplace(id, channel);
    }
  }

  const std::string& path_;
  McapFile& file_;
  Bytes bytes_;
  std::size_t search_budget_;

  bool closed_ = false;
  std::size_t bytes_behind_ = 0;
  std::optional<std::size_t> summary_start_;  // of a sound summary
  std::optional<std::uint64_t> messages_written_;

  std::size_t data_end_ = 0, sealed_bytes_ = 0;
  bool data_ends_ = false, data_fits_ = false;
  std::uint64_t lost_messages_ = 0;
  std::map<std::uint16_t, Definition> schemas_, channels_;
  std::vector<Found> found_;
  std::map<std::string, Header> open_metadata_;
};

}  // namespace

McapFile read_mcap(const std::string& path) { return mcap_of(read_bytes(path), path); }

McapFile mcap_of(std::vector<std::uint8_t> bytes, const std::string& path) {
  McapFile file;
  file.bytes = std::move(bytes);
  Walk(path, file).run();
  return file;
}

}  // namespace palmar
