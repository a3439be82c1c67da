#include "channels.h"

#include <cmath>

namespace palmar {

std::map<std::uint16_t, const MessageType*> find_channels(const McapFile& file, const std::string& path,
                                                          std::initializer_list<const MessageType*> types) {
  std::map<std::uint16_t, const MessageType*> found;
  for (const auto& [id, channel] : file.channels) {
    for (const MessageType* type : types) {
      if (channel.topic != type->topic) continue;
      const std::string where = path + ":" + type->topic;
      if (channel.encoding != "cdr" || channel.schema_encoding != "ros2msg" || channel.schema_name != type->name)
        throw Error("E-TRACE-SCHEMA", where,
                    "carries '" + std::string(channel.schema_name) + "' as '" + std::string(channel.encoding) +
                        "' with '" + std::string(channel.schema_encoding) + "'; '" + type->name +
                        "' as 'cdr' with 'ros2msg' is needed");
      if (!same_fields(channel.schema_text, type->text))
        throw Error("E-TRACE-SCHEMA", where,
                    "its " + std::string(type->name) + " has other fields than " + kTraceSchema + " and " + kRunSchema +
                        " know (docs/formats.md)");
      found.emplace(id, type);
    }
  }
  return found;
}

Header find_header(const McapFile& file, const std::string& path, const std::string& name, const std::string& schema) {
  const auto record = file.metadata.find(name);
  if (record == file.metadata.end() && file.damaged_metadata)
    throw Error("E-TRACE-CRC", path + ":" + name, "the header is damaged, so what the file holds is not known");
  std::string present = "none";
  if (record != file.metadata.end()) {
    const auto found = record->second.find("schema");
    if (found != record->second.end()) present = found->second;
    if (present == schema) return record->second;
  } else {
    for (const auto& [other, values] : file.metadata)
      if (const auto found = values.find("schema"); found != values.end()) present = found->second;
  }
  throw Error("E-TRACE-SCHEMA", path + ":" + name, "schema " + present + "; this version reads " + schema + " here");
}

void set_schema(Header& header, const std::string& path, const std::string& schema) {
  const std::string present = header.emplace("schema", schema).first->second;
  if (present != schema)
    throw Error("E-TRACE-SCHEMA", path + ":header.schema",
                "schema " + present + "; this version writes " + schema + " here");
}

bool usable_time(double time_s) { return time_s >= 0 && time_s <= 9.2e9; }

std::uint64_t log_time_ns(double time_s) { return static_cast<std::uint64_t>(std::llround(time_s * 1e9)); }

}  // namespace palmar
