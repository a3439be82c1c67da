#include "trace_file.h"

#include <cmath>
#include <cstdio>
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

void check_finite(std::span<const double> values, const char* name, const std::string& where) {
  for (std::size_t i = 0; i < values.size(); ++i)
    if (!std::isfinite(values[i]))
      throw Error(
          "E-TRACE-VALUE", where,
          std::string(name) + "[" + std::to_string(i) + "] is " + number(values[i]) + "; finite numbers are allowed");
}

void check_rotation(const std::array<double, 4>& q, const char* name, const std::string& where) {
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  // 1e-3: more than rounding to single precision or three decimals does, less than any mix-up of components.
  if (!(std::abs(norm - 1) <= 1e-3))
    throw Error("E-TRACE-VALUE", where,
                std::string(name) + " has norm " + number(norm) + "; 1 within 0.001 is allowed");
}

void check_time(double time_s, const std::string& where) {
  if (!usable_time(time_s))
    throw Error("E-TRACE-VALUE", where, "time_s is " + number(time_s) + "; 0 to 9.2e9 s are allowed");
}

void check_sample(const Sample& sample, std::size_t i, const std::string& path) {
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

void check_device_bytes(const DeviceBytes& device, std::size_t i, const std::string& path) {
  check_time(device.time_s, path + ":device_bytes " + std::to_string(i));
}

}  // namespace

Trace read_trace(const std::string& path) {
  const McapFile file = read_mcap(path);
  Trace trace;
  trace.header = find_header(file, path, kTraceHeaderName, kTraceSchema);
  check_header(trace.header, path);
  if (const auto end = file.metadata.find(kTraceEndName); end != file.metadata.end())
    for (const auto& [key, value] : end->second) trace.header[key] = value;
  trace.loss = file.loss;

  const auto channels = find_channels(file, path, {&kSampleType, &kDeviceBytesType});
  std::size_t seen = 0;
  for (const McapMessage& message : file.messages) {
    const auto channel = channels.find(message.channel);
    if (channel == channels.end()) continue;
    if (channel->second == &kSampleType) {
      Sample sample;
      decode(message.payload, sample, [](auto& cdr, auto& m) { sample_fields(cdr, m); }, path, kSampleType, seen);
      check_sample(sample, seen++, path);
      if (trace.samples.empty() || sample.time_s > trace.samples.back().time_s)
        trace.samples.push_back(sample);
      else
        ++trace.loss.messages;
    } else {
      DeviceBytes device;
      decode(
          message.payload, device, [](auto& cdr, auto& m) { device_bytes_fields(cdr, m); }, path, kDeviceBytesType,
          trace.device_bytes.size());
      check_device_bytes(device, trace.device_bytes.size(), path);
      trace.device_bytes.push_back(std::move(device));
    }
  }
  if (trace.samples.empty())
    throw Error("E-TRACE-EMPTY", path,
                "no whole sample on " + std::string(kSampleType.topic) + "; at least one is needed");
  return trace;
}

void write_trace(const std::string& path, const Trace& trace) {
  Header header = trace.header;
  set_schema(header, path, kTraceSchema);
  check_header(header, path);
  if (trace.samples.empty()) throw Error("E-TRACE-EMPTY", path, "no samples; at least one is needed");
  for (std::size_t i = 0; i < trace.samples.size(); ++i) {
    check_sample(trace.samples[i], i, path);
    if (i > 0 && trace.samples[i].time_s <= trace.samples[i - 1].time_s)
      throw Error("E-TRACE-TIME", path + ":sample " + std::to_string(i),
                  "time_s " + number(trace.samples[i].time_s) + " follows " + number(trace.samples[i - 1].time_s) +
                      "; times must rise");
  }
  for (std::size_t i = 0; i < trace.device_bytes.size(); ++i) check_device_bytes(trace.device_bytes[i], i, path);

  McapWriter writer(path);
  writer.add_metadata(kTraceHeaderName, header);
  const std::uint16_t samples = writer.add_channel(kSampleType.topic, kSampleType.name, kSampleType.text);
  const std::uint16_t bytes =
      trace.device_bytes.empty()
          ? 0
          : writer.add_channel(kDeviceBytesType.topic, kDeviceBytesType.name, kDeviceBytesType.text);
  CdrEncoder cdr;
  auto device = trace.device_bytes.begin();
  const auto write_device_bytes_until = [&](double time_s) {
    for (; device != trace.device_bytes.end() && device->time_s <= time_s; ++device) {
      cdr.start();
      device_bytes_fields(cdr, *device);
      writer.add_message(bytes, log_time_ns(device->time_s), cdr.bytes());
    }
  };
  for (const Sample& sample : trace.samples) {
    write_device_bytes_until(sample.time_s);
    cdr.start();
    sample_fields(cdr, sample);
    writer.add_message(samples, log_time_ns(sample.time_s), cdr.bytes());
  }
  write_device_bytes_until(INFINITY);
  writer.close();
}

}  // namespace palmar
