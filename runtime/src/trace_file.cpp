#include "trace_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <span>

#include "channels.h"
#include "mcap_writer.h"

namespace palmar {
namespace {

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.9g", value);
  return text;
}

void check_header(const Header& header, const std::string& path) {
  for (const char* key : {"device", "hand", "side"})
    if (!header.count(key))
      throw Error("E-TRACE-HEADER", path + ":header",
                  std::string("no key `") + key + "`; schema, device, hand and side are needed");
  const std::string& side = header.at("side");
  if (side != "right" && side != "left")
    throw Error("E-TRACE-HEADER", path + ":header.side", "'" + side + "'; 'right' or 'left' is allowed");
}

bool is_finite(std::span<const double> values) {
  return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

double norm_of(const std::array<double, 4>& q) {
  return std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
}

// 1e-3: more than rounding to single precision or three decimals does, less than any mix-up of components.
bool is_rotation(const std::array<double, 4>& q) { return std::abs(norm_of(q) - 1) <= 1e-3; }

void complete_header(Header& header, const std::string& path) {
  set_schema(header, path, kTraceSchema);
  check_header(header, path);
  McapWriter::check_metadata(path, kTraceHeaderName, header);
}

void check_finite(std::span<const double> values, const char* name, const std::string& where) {
  for (std::size_t i = 0; i < values.size(); ++i)
    if (!std::isfinite(values[i]))
      throw Error(
          "E-TRACE-VALUE", where,
          std::string(name) + "[" + std::to_string(i) + "] is " + number(values[i]) + "; finite numbers are allowed");
}

void check_rotation(const std::array<double, 4>& q, const char* name, const std::string& where) {
  if (!is_rotation(q))
    throw Error("E-TRACE-VALUE", where,
                std::string(name) + " has norm " + number(norm_of(q)) + "; 1 within 0.001 is allowed");
}

void check_time(double time_s, const std::string& where) {
  if (!usable_time(time_s))
    throw Error("E-TRACE-VALUE", where, "time_s is " + number(time_s) + "; 0 to 9.2e9 s are allowed");
}

void check_sample(const Sample& sample, std::size_t i, const std::string& path) {
  if (is_storable(sample)) return;
  const std::string where = path + ":sample " + std::to_string(i);
  check_time(sample.time_s, where);
  check_finite(sample.pose.palm.position_m, "palm_position_m", where);
  check_finite(sample.pose.palm.rotation_wxyz, "palm_rotation_wxyz", where);
  check_finite(sample.pose.flexion_rad, "flexion_rad", where);
  check_finite(sample.pose.abduction_rad, "abduction_rad", where);
  check_finite(sample.object.position_m, "object_position_m", where);
  check_finite(sample.object.rotation_wxyz, "object_rotation_wxyz", where);
  if (sample.tracked) check_rotation(sample.pose.palm.rotation_wxyz, "palm_rotation_wxyz", where);
  if (sample.has_object_pose) check_rotation(sample.object.rotation_wxyz, "object_rotation_wxyz", where);
}

// Of a message beside the samples; what it holds may be anything.
template <class Message>
void check_beside(const Message& message, const MessageType& type, std::size_t i, const std::string& path) {
  check_time(message.time_s, path + ":" + (type.topic + 1) + " " + std::to_string(i));
}

template <class Message, class Fields>
void take_beside(std::vector<Message>& all, const McapMessage& from, Fields fields, const MessageType& type,
                 const std::string& path, std::size_t number) {
  Message message;
  decode(from.payload, message, fields, path, type, number);
  check_beside(message, type, number, path);
  all.push_back(std::move(message));
}

// A sample whose time does not rise is counted as lost.
void take(Trace& trace, const McapMessage& message, const MessageType& type, const std::string& path,
          std::size_t number) {
  if (&type == &kSampleType) {
    Sample sample;
    decode(message.payload, sample, [](auto& cdr, auto& m) { sample_fields(cdr, m); }, path, type, number);
    check_sample(sample, number, path);
    if (trace.samples.empty() || sample.time_s > trace.samples.back().time_s)
      trace.samples.push_back(sample);
    else
      ++trace.loss.messages;
  } else if (&type == &kDeviceReadingType) {
    const auto fields = [](auto& cdr, auto& m) { device_reading_fields(cdr, m); };
    take_beside(trace.device_readings, message, fields, type, path, number);
  } else {
    const auto fields = [](auto& cdr, auto& m) { device_bytes_fields(cdr, m); };
    take_beside(&type == &kPoseBytesType ? trace.pose_bytes : trace.device_bytes, message, fields, type, path, number);
  }
}

// salvage: samples that cannot be a hand's are left out and counted, and a damaged header is `spare`, if that has any
// key.
Trace read(const McapFile& file, const std::string& path, bool salvage, const Header& spare) {
  Trace trace;
  const bool header_lost = file.damaged_metadata && !file.metadata.count(kTraceHeaderName);
  trace.header = header_lost && !spare.empty() ? spare : find_header(file, path, kTraceHeaderName, kTraceSchema);
  check_header(trace.header, path);
  if (const auto end = file.metadata.find(kTraceEndName); end != file.metadata.end())
    for (const auto& [key, value] : end->second) trace.header[key] = value;
  trace.loss = file.loss;

  const auto channels =
      find_channels(file, path, {&kSampleType, &kDeviceReadingType, &kDeviceBytesType, &kPoseBytesType});
  std::map<const MessageType*, std::size_t> seen;
  for (const McapMessage& message : file.messages) {
    const auto channel = channels.find(message.channel);
    if (channel == channels.end()) continue;
    try {
      take(trace, message, *channel->second, path, seen[channel->second]++);
    } catch (const Error&) {
      if (!salvage) throw;
      ++trace.loss.messages;
    }
  }
  if (trace.samples.empty())
    throw Error("E-TRACE-EMPTY", path,
                "no whole sample on " + std::string(kSampleType.topic) + "; at least one is needed");
  return trace;
}

}  // namespace

bool is_storable(const Sample& sample) {
  const auto fits = [](const Placement& place, bool used) {
    return is_finite(place.position_m) && is_finite(place.rotation_wxyz) && (!used || is_rotation(place.rotation_wxyz));
  };
  return usable_time(sample.time_s) && fits(sample.pose.palm, sample.tracked) && is_finite(sample.pose.flexion_rad) &&
         is_finite(sample.pose.abduction_rad) && fits(sample.object, sample.has_object_pose);
}

bool same_content(const Trace& a, const Trace& b) {
  CdrEncoder one, other;
  const auto all_same = [&](const auto& left, const auto& right, auto fields) {
    return std::equal(left.begin(), left.end(), right.begin(), right.end(), [&](auto& l, auto& r) {
      one.start(), other.start();
      fields(one, l), fields(other, r);
      return std::equal(one.bytes().begin(), one.bytes().end(), other.bytes().begin(), other.bytes().end());
    });
  };
  const auto bytes = [](auto& cdr, auto& m) { device_bytes_fields(cdr, m); };
  return a.header == b.header && all_same(a.samples, b.samples, [](auto& cdr, auto& m) { sample_fields(cdr, m); }) &&
         all_same(a.device_readings, b.device_readings, [](auto& cdr, auto& m) { device_reading_fields(cdr, m); }) &&
         all_same(a.device_bytes, b.device_bytes, bytes) && all_same(a.pose_bytes, b.pose_bytes, bytes);
}

Trace read_trace(const std::string& path) { return read(read_mcap(path), path, false, {}); }

Trace trace_of(const McapFile& file, const std::string& path) { return read(file, path, false, {}); }

Trace salvage_trace(const std::string& path, const Header& spare) { return salvage_of(read_mcap(path), path, spare); }

Trace salvage_of(const McapFile& file, const std::string& path, const Header& spare) {
  return read(file, path, true, spare);
}

TraceWriter::TraceWriter(const std::string& path, Header header, McapWriter::Place place, Beside beside)
    : writer_((complete_header(header, path), path), place) {  // a wrong header makes no file
  writer_.add_metadata(kTraceHeaderName, header);
  const auto channel = [&](const MessageType& type) { return writer_.add_channel(type.topic, type.name, type.text); };
  samples_ = channel(kSampleType);
  if (beside.readings) readings_ = channel(kDeviceReadingType);
  if (beside.device_bytes) device_bytes_ = channel(kDeviceBytesType);
  if (beside.pose_bytes) pose_bytes_ = channel(kPoseBytesType);
}

void TraceWriter::add(const Sample& sample) {
  cdr_.start();
  sample_fields(cdr_, sample);
  writer_.add_message(samples_, log_time_ns(sample.time_s), cdr_.bytes());
}

void TraceWriter::add(const DeviceReading& reading) {
  cdr_.start();
  device_reading_fields(cdr_, reading);
  writer_.add_message(readings_, log_time_ns(reading.time_s), cdr_.bytes());
}

void TraceWriter::add_device_bytes(const DeviceBytes& device) {
  cdr_.start();
  device_bytes_fields(cdr_, device);
  writer_.add_message(device_bytes_, log_time_ns(device.time_s), cdr_.bytes());
}

void TraceWriter::add_pose_bytes(const DeviceBytes& pose) {
  cdr_.start();
  device_bytes_fields(cdr_, pose);
  writer_.add_message(pose_bytes_, log_time_ns(pose.time_s), cdr_.bytes());
}

void write_trace(const std::string& path, const Trace& trace) {
  check_header(trace.header, path);
  if (trace.samples.empty()) throw Error("E-TRACE-EMPTY", path, "no samples; at least one is needed");
  for (std::size_t i = 0; i < trace.samples.size(); ++i) {
    check_sample(trace.samples[i], i, path);
    if (i > 0 && trace.samples[i].time_s <= trace.samples[i - 1].time_s)
      throw Error("E-TRACE-TIME", path + ":sample " + std::to_string(i),
                  "time_s " + number(trace.samples[i].time_s) + " follows " + number(trace.samples[i - 1].time_s) +
                      "; times must rise");
  }
  const auto check_all = [&](const auto& messages, const MessageType& type) {
    for (std::size_t i = 0; i < messages.size(); ++i) check_beside(messages[i], type, i, path);
  };
  check_all(trace.device_bytes, kDeviceBytesType);
  check_all(trace.pose_bytes, kPoseBytesType);
  check_all(trace.device_readings, kDeviceReadingType);

  TraceWriter writer(path, trace.header, McapWriter::Place::kNamedOnClose,
                     {!trace.device_bytes.empty(), !trace.pose_bytes.empty(), !trace.device_readings.empty()});
  // In order of time; of one time bytes come before what was made of them.
  std::size_t device = 0, pose = 0, reading = 0, sample = 0;
  const auto time_of = [](const auto& messages, std::size_t i) {
    return i < messages.size() ? messages[i].time_s : std::numeric_limits<double>::infinity();
  };
  for (;;) {
    const std::array<double, 4> next{time_of(trace.device_bytes, device), time_of(trace.pose_bytes, pose),
                                     time_of(trace.device_readings, reading), time_of(trace.samples, sample)};
    const auto first = std::min_element(next.begin(), next.end());
    if (std::isinf(*first)) break;
    switch (first - next.begin()) {
      case 0:
        writer.add_device_bytes(trace.device_bytes[device++]);
        break;
      case 1:
        writer.add_pose_bytes(trace.pose_bytes[pose++]);
        break;
      case 2:
        writer.add(trace.device_readings[reading++]);
        break;
      default:
        writer.add(trace.samples[sample++]);
    }
  }
  writer.close();
}

}  // namespace palmar
