#include "run_file.h"

#include <cstdio>
#include <limits>

#include "channels.h"

namespace palmar {
namespace {

constexpr const char* kHeaderName = "palmar.run";
constexpr const char* kEndName = "palmar.run.end";

constexpr std::uint64_t kFnvStart = 14695981039346656037u;

// FNV-1a, 64 bit.
std::uint64_t fnv1a(mcap::Bytes bytes, std::uint64_t hash) {
  for (const std::uint8_t byte : bytes) hash = (hash ^ byte) * 1099511628211u;
  return hash;
}

std::string hex(std::uint64_t value) {
  char digits[17];
  std::snprintf(digits, sizeof digits, "%016llx", static_cast<unsigned long long>(value));
  return digits;
}

Header with_schema(Header header, const std::string& path) {
  set_schema(header, path, kRunSchema);
  return header;
}

void append_contacts(std::vector<Contact>& to, const ContactColumns& from, const std::string& where) {
  const std::size_t n = from.link.size();
  if (from.object_sphere.size() != n || from.palm_sphere.size() != n || from.gap_m.size() != n ||
      from.force_n.size() != n || from.point_m.size() != 3 * n || from.normal.size() != 3 * n)
    throw Error("E-TRACE-FORMAT", where,
                "its columns differ in length; one element a contact is needed, three for point and normal");
  for (std::size_t i = 0; i < n; ++i)
    to.push_back({from.link[i],
                  from.object_sphere[i],
                  from.palm_sphere[i],
                  from.gap_m[i],
                  from.force_n[i],
                  {from.point_m[3 * i], from.point_m[3 * i + 1], from.point_m[3 * i + 2]},
                  {from.normal[3 * i], from.normal[3 * i + 1], from.normal[3 * i + 2]}});
}

// What the end record says, against what was read.
void check_end(Run& run, const McapFile& file, std::uint64_t hash, const std::string& path) {
  const auto end = file.metadata.find(kEndName);
  if (end == file.metadata.end()) {
    run.loss.unclosed = true;
    return;
  }
  for (const char* key : {"steps", "content_fnv1a64"}) {
    const auto value = end->second.find(key);
    if (value == end->second.end())
      throw Error("E-TRACE-SCHEMA", path + ":" + kEndName,
                  std::string("no key `") + key + "`; " + kRunSchema + " has it");
    run.header[key] = value->second;
  }
  const bool sound = run.loss.bytes == 0 && run.loss.chunks == 0 && run.loss.messages == 0 && !run.loss.unclosed;
  if (sound && (run.header["content_fnv1a64"] != hex(hash) || run.header["steps"] != std::to_string(run.steps.size())))
    throw Error("E-TRACE-CRC", path + ":" + kEndName,
                run.header["steps"] + " steps with hash " + run.header["content_fnv1a64"] + " were written, " +
                    std::to_string(run.steps.size()) + " with " + hex(hash) + " are there");
}

}  // namespace

RunWriter::RunWriter(const std::string& path, Header header) : path_(path), writer_(path), hash_(kFnvStart) {
  writer_.add_metadata(kHeaderName, with_schema(std::move(header), path));
  steps_ = writer_.add_channel(kStepType.topic, kStepType.name, kStepType.text);
  contacts_ = writer_.add_channel(kContactsType.topic, kContactsType.name, kContactsType.text);
  timing_ = writer_.add_channel(kTimingType.topic, kTimingType.name, kTimingType.text);
}

void RunWriter::add_hashed(std::uint16_t channel, std::uint64_t log_time_ns) {
  hash_ = fnv1a(cdr_.bytes(), hash_);
  writer_.add_message(channel, log_time_ns, cdr_.bytes());
}

void RunWriter::add(const StepResult& step, const Timing& timing, std::span<const Contact> contacts) {
  if (!usable_time(step.time_s) || step.time_s <= last_time_s_)
    throw Error(
        "E-TRACE-TIME", path_ + ":step " + std::to_string(count_),
        "time_s " + std::to_string(step.time_s) + " follows " + std::to_string(last_time_s_) + "; times must rise");
  last_time_s_ = step.time_s;
  const std::uint64_t now_ns = log_time_ns(step.time_s);
  cdr_.start();
  step_fields(cdr_, step);
  add_hashed(steps_, now_ns);

  if (!contacts.empty()) {
    ContactColumns& c = columns_;
    c.time_s = step.time_s;
    c.link.clear();
    c.object_sphere.clear();
    c.palm_sphere.clear();
    c.gap_m.clear();
    c.force_n.clear();
    c.point_m.clear();
    c.normal.clear();
    for (const Contact& contact : contacts) {
      c.link.push_back(contact.link);
      c.object_sphere.push_back(contact.object_sphere);
      c.palm_sphere.push_back(contact.palm_sphere);
      c.gap_m.push_back(contact.gap_m);
      c.force_n.push_back(contact.force_n);
      c.point_m.insert(c.point_m.end(), contact.point_m.begin(), contact.point_m.end());
      c.normal.insert(c.normal.end(), contact.normal.begin(), contact.normal.end());
    }
    cdr_.start();
    contacts_fields(cdr_, c);
    add_hashed(contacts_, now_ns);
  }

  const TimingMessage message{step.time_s, timing};
  cdr_.start();
  timing_fields(cdr_, message);
  writer_.add_message(timing_, now_ns, cdr_.bytes());
  ++count_;
}

std::string RunWriter::close() {
  const std::string hash = hex(hash_);
  writer_.add_metadata(kEndName, {{"steps", std::to_string(count_)}, {"content_fnv1a64", hash}});
  writer_.close();
  return hash;
}

Run read_run(const std::string& path) { return run_of(read_mcap(path), path); }

Run run_of(const McapFile& file, const std::string& path) {
  Run run;
  run.header = find_header(file, path, kHeaderName, kRunSchema);
  run.loss = file.loss;

  const auto channels = find_channels(file, path, {&kStepType, &kContactsType, &kTimingType});
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  std::uint64_t hash = kFnvStart;
  std::size_t seen = 0;
  ContactColumns columns;
  TimingMessage timing;
  run.steps.reserve(file.bytes.size() / sizeof(StepResult));  // a step takes at least that much of the file
  for (const McapMessage& message : file.messages) {
    const auto channel = channels.find(message.channel);
    if (channel == channels.end()) continue;
    const MessageType& type = *channel->second;
    const std::size_t place = seen++;
    if (&type != &kTimingType) hash = fnv1a(message.payload, hash);
    // The messages of a step follow it; those whose step is gone are lost with it.
    const auto follows = [&](double time_s) { return !run.steps.empty() && run.steps.back().time_s == time_s; };
    if (&type == &kStepType) {
      StepResult step;
      decode(message.payload, step, [](auto& cdr, auto& m) { step_fields(cdr, m); }, path, type, place);
      if (!usable_time(step.time_s) || (!run.steps.empty() && step.time_s <= run.steps.back().time_s)) {
        ++run.loss.messages;
        continue;
      }
      run.steps.push_back(step);
      run.timing.push_back({kNone, kNone, kNone, kNone, kNone});
      run.contact_start.push_back(run.contacts.size());
    } else if (&type == &kContactsType) {
      decode(message.payload, columns, [](auto& cdr, auto& m) { contacts_fields(cdr, m); }, path, type, place);
      if (!follows(columns.time_s)) {
        ++run.loss.messages;
        continue;
      }
      append_contacts(run.contacts, columns, path + ":" + type.topic + " message " + std::to_string(place));
      run.contact_start.back() = run.contacts.size();
    } else {
      decode(message.payload, timing, [](auto& cdr, auto& m) { timing_fields(cdr, m); }, path, type, place);
      if (follows(timing.time_s))
        run.timing.back() = timing.timing;
      else
        ++run.loss.messages;
    }
  }
  if (run.steps.empty())
    throw Error("E-TRACE-EMPTY", path, "no whole step on " + std::string(kStepType.topic) + "; at least one is needed");
  check_end(run, file, hash, path);
  return run;
}

}  // namespace palmar
