// What trace and run files share beyond MCAP: which channels carry our messages, the header record, and times.
#pragma once

#include <initializer_list>
#include <map>
#include <string>

#include "cdr.h"
#include "error.h"
#include "mcap_reader.h"
#include "schemas.h"

namespace palmar {

// By channel number: the message type it carries. Channels of other topics are left out. Throws E-TRACE-SCHEMA if a
// topic of ours has another encoding, schema name or other fields.
std::map<std::uint16_t, const MessageType*> find_channels(const McapFile& file, const std::string& path,
                                                          std::initializer_list<const MessageType*> types);

// The Metadata record `name`, whose key `schema` must be `schema`. Throws E-TRACE-CRC if it is damaged, E-TRACE-SCHEMA
// (with both versions) if the file is of another kind or version.
Header find_header(const McapFile& file, const std::string& path, const std::string& name, const std::string& schema);

// Fills in the key `schema` if it is missing; throws E-TRACE-SCHEMA if it says something else.
void set_schema(Header& header, const std::string& path, const std::string& schema);

// True for times that fit MCAP's nanoseconds: finite and 0 to 9.2e9 s.
bool usable_time(double time_s);
std::uint64_t log_time_ns(double time_s);

// Decodes one payload by the list of fields given. Throws E-TRACE-FORMAT, naming the count of messages before it.
template <class Message, class Fields>
void decode(mcap::Bytes payload, Message& message, Fields fields, const std::string& path, const MessageType& type,
            std::size_t before) {
  CdrDecoder cdr(payload);
  fields(cdr, message);
  if (!cdr.whole())
    throw Error("E-TRACE-FORMAT", path + ":" + type.topic + " message " + std::to_string(before),
                std::to_string(payload.size()) + " bytes are not one little-endian CDR " + type.name);
}

}  // namespace palmar
