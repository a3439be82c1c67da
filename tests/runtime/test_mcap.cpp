#include <cstring>

#include "check.h"
#include "crc32.h"
#include "made_files.h"
#include "mcap_reader.h"
#include "mcap_writer.h"
#include "schemas.h"

using namespace palmar;

namespace {

const std::filesystem::path kFolder = std::filesystem::temp_directory_path() / "palmar_test_mcap";
const std::string kPath = (kFolder / "file.mcap").string();

void crc_is_that_of_zlib() {
  const std::string text = "123456789";
  const auto* raw = reinterpret_cast<const std::uint8_t*>(text.data());
  CHECK(crc32({raw, 9}) == 0xCBF43926u);  // the published check value
  CHECK(crc32({raw + 4, 5}, crc32({raw, 4})) == 0xCBF43926u);
  CHECK(crc32({}) == 0);
}

void trace_comes_back_bit_for_bit() {
  Trace trace = make_trace(1000, 0.001);
  trace.device_bytes = {{0.1, {1, 2, 3}}, {0.9, {}}, {7.0, {255}}};
  trace.pose_bytes = {{0.05, {7}}, {0.1, {}}};
  DeviceReading reading{0.1, {}, {}, {0.5, -0.5}, 1, 3};
  reading.flexion.fill(std::nan(""));
  trace.device_readings = {reading};
  write_trace(kPath, trace);
  const Trace back = read_trace(kPath);
  CHECK(back.header == trace.header);
  CHECK(all_same(back.samples, trace.samples));
  CHECK(sound(back.loss));
  CHECK(same_content(back, trace));
  // It sees a bit of each channel.
  const auto differs = [&](auto change) {
    Trace other = trace;
    change(other);
    return !same_content(back, other);
  };
  CHECK(differs([](Trace& t) { t.device_bytes[2].bytes[0] = 254; }));
  CHECK(differs([](Trace& t) { t.pose_bytes.pop_back(); }));
  CHECK(differs([](Trace& t) { t.device_readings[0].buttons = 2; }));
  CHECK(differs([](Trace& t) { t.samples[9].pose.abduction_rad[4] += 1e-9; }));
  const FileBytes once = load(kPath);
  write_trace(kPath, trace);
  CHECK(load(kPath) == once);
}

void run_comes_back_bit_for_bit() {
  const Steps all = make_steps(500, 0.001);
  const std::string hash = write_run(kPath, all);
  const Run run = read_run(kPath);
  CHECK(sound(run.loss));
  CHECK(all_same(run.steps, all.steps));
  CHECK(complete_steps(run, all));
  CHECK(run.header.at("schema") == "palmar.run/1");
  CHECK(run.header.at("steps") == "500");
  CHECK(run.header.at("content_fnv1a64") == hash);

  Steps other = all;
  other.timing[7].cpu_us += 1;
  CHECK(write_run(kPath, other) == hash);  // times are not part of the content
  other.contacts[3][0].gap_m = std::nextafter(other.contacts[3][0].gap_m, 1);
  CHECK(write_run(kPath, other) != hash);
}

void wrong_values_are_refused() {
  const auto refuses = [](const std::string& code, const std::function<void(Trace&)>& change) {
    Trace trace = make_trace(5, 0.01);
    change(trace);
    std::filesystem::remove(kPath);
    CHECK(code_of([&] { write_trace(kPath, trace); }) == code);
    CHECK(!std::filesystem::exists(kPath));
  };
  refuses("E-TRACE-VALUE", [](Trace& t) { t.samples[2].pose.flexion_rad[4] = NAN; });
  refuses("E-TRACE-VALUE", [](Trace& t) { t.samples[1].object.position_m[0] = INFINITY; });
  refuses("E-TRACE-VALUE", [](Trace& t) { t.samples[2].pose.palm.rotation_wxyz = {1, 0.05, 0, 0}; });
  refuses("E-TRACE-VALUE", [](Trace& t) { t.samples[0].object.rotation_wxyz = {0, 0, 0, 0}; });
  refuses("E-TRACE-VALUE", [](Trace& t) { t.samples[0].time_s = -0.001; });
  refuses("E-TRACE-TIME", [](Trace& t) { t.samples[3].time_s = t.samples[2].time_s; });
  refuses("E-TRACE-EMPTY", [](Trace& t) { t.samples.clear(); });
  refuses("E-TRACE-HEADER", [](Trace& t) { t.header.erase("hand"); });
  refuses("E-TRACE-HEADER", [](Trace& t) { t.header["side"] = "both"; });
  refuses("E-TRACE-HEADER", [](Trace& t) { t.header.emplace("crc32", "1"); });
  refuses("E-TRACE-HEADER", [](Trace& t) { t.header["note"] = std::string(2 << 20, 'x'); });
  refuses("E-TRACE-SCHEMA", [](Trace& t) { t.header["schema"] = "palmar.trace/2"; });

  Trace trace = make_trace(3, 0.01);
  trace.samples[1].tracked = false;
  trace.samples[1].pose.palm.rotation_wxyz = {0, 0, 0, 0};  // not to be used, so it may be anything finite
  CHECK(code_of([&] { write_trace(kPath, trace); }) == "");
}

void wrong_files_are_refused_by_name() {
  CHECK(code_of([] { read_trace((kFolder / "missing.mcap").string()); }) == "E-TRACE-MISSING");
  CHECK(code_of([] { read_trace(kFolder.string()); }) == "E-TRACE-MISSING");
  store(kPath, {});
  CHECK(code_of([] { read_trace(kPath); }) == "E-TRACE-FORMAT");
  write_run(kPath, make_steps(3, 0.001));
  try {
    read_trace(kPath);
    CHECK(false);
  } catch (const Error& error) {
    CHECK(error.code == "E-TRACE-SCHEMA");
    CHECK(error.message.find("palmar.run/1") != std::string::npos);
    CHECK(error.message.find("palmar.trace/1") != std::string::npos);
  }
}

void length_without_end_allocates_nothing() {
  McapWriter writer(kPath);
  const std::uint16_t channel = writer.add_channel(kContactsType.topic, kContactsType.name, kContactsType.text);
  const FileBytes payload{0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF};  // four billion links
  writer.add_metadata("palmar.run", {{"schema", "palmar.run/1"}});
  writer.add_message(channel, 0, payload);
  writer.close();
  CHECK(code_of([] { read_run(kPath); }) == "E-TRACE-FORMAT");
}

// A run of two steps in which one message is another than the writer would have made it.
template <class Change>
Run run_with(Change change) {
  const Steps all = make_steps(2, 0.001);
  StepResult second = all.steps[1];
  ContactColumns contacts{second.time_s, {3}, {7}, {UINT32_MAX}, {0.0}, {1.0}, {1, 2, 3}, {0, 0, 1}};
  TimingMessage timing{second.time_s, all.timing[1]};
  change(second, contacts, timing);
  McapWriter writer(kPath);
  writer.add_metadata("palmar.run", {{"schema", "palmar.run/1"}});
  CdrEncoder cdr;
  const auto put = [&](const MessageType& type, auto fields) {
    const std::uint16_t channel = writer.add_channel(type.topic, type.name, type.text);
    cdr.start();
    fields();
    writer.add_message(channel, 0, cdr.bytes());
  };
  put(kStepType, [&] { step_fields(cdr, all.steps[0]); });
  put(kStepType, [&] { step_fields(cdr, second); });
  put(kContactsType, [&] { contacts_fields(cdr, contacts); });
  put(kTimingType, [&] { timing_fields(cdr, timing); });
  writer.close();
  return read_run(kPath);
}

void what_belongs_to_no_step_is_counted() {
  const Run sound = run_with([](auto&, auto&, auto&) {});
  CHECK(sound.steps.size() == 2 && sound.contacts.size() == 1 && sound.loss.messages == 0);
  CHECK(sound.contacts[0].point_m == (std::array{1.0, 2.0, 3.0}) && sound.timing[1].wall_us == number(2));
  // Its contacts and its timing are lost with a step whose time does not rise.
  const Run late = run_with([](StepResult& step, auto&, auto&) { step.time_s = 0; });
  CHECK(late.steps.size() == 1 && late.contacts.empty() && late.loss.messages == 3);
  const Run other = run_with([](auto&, ContactColumns& contacts, auto&) { contacts.time_s = 0.5; });
  CHECK(other.steps.size() == 2 && other.contacts.empty() && other.loss.messages == 1);
  const Run strange = run_with([](auto&, auto&, TimingMessage& timing) { timing.time_s = 0; });
  CHECK(strange.steps.size() == 2 && std::isnan(strange.timing[1].wall_us) && strange.loss.messages == 1);
  const auto refused = [](auto change) {
    return code_of([&] { run_with([&](auto&, ContactColumns& contacts, auto&) { change(contacts); }); });
  };
  CHECK(refused([](ContactColumns& c) { c.object_sphere.clear(); }) == "E-TRACE-FORMAT");
  CHECK(refused([](ContactColumns& c) { c.point_m.pop_back(); }) == "E-TRACE-FORMAT");
  CHECK(refused([](ContactColumns& c) { c.normal.push_back(0); }) == "E-TRACE-FORMAT");
  Steps again = make_steps(2, 0.001);
  again.steps[1].time_s = again.steps[0].time_s;
  CHECK(code_of([&] { write_run(kPath, again); }) == "E-TRACE-TIME");
}

void writer_without_close_leaves_nothing() {
  std::filesystem::remove(kPath);
  {
    const Steps all = make_steps(400, 0.001);
    RunWriter writer(kPath, {});
    for (std::size_t i = 0; i < 400; ++i) writer.add(all.steps[i], all.timing[i], all.contacts[i]);
    CHECK(!std::filesystem::exists(kPath));
  }
  CHECK(std::filesystem::is_empty(kFolder));
  CHECK(code_of([] { McapWriter((kFolder / "none" / "x.mcap").string()); }) == "E-TRACE-WRITE");
  if (std::filesystem::is_character_file("/dev/full"))
    CHECK(code_of([] {
            McapWriter writer("/dev/full", McapWriter::Place::kNamedOnFlush);
            writer.close();
          }) == "E-TRACE-WRITE");
}

void recorder_killed_loses_under_a_quarter_second() {
  const Trace trace = make_trace(1000, 0.001);
  std::filesystem::remove(kPath);
  McapWriter writer(kPath, McapWriter::Place::kNamedOnFlush);
  writer.add_metadata("palmar.trace", trace.header);
  const std::uint16_t channel = writer.add_channel(kSampleType.topic, kSampleType.name, kSampleType.text);
  writer.flush();
  CHECK(!std::filesystem::exists(kPath));  // a header is no recording
  CdrEncoder cdr;
  for (const Sample& sample : trace.samples) {
    cdr.start();
    sample_fields(cdr, sample);
    writer.add_message(channel, static_cast<std::uint64_t>(std::llround(sample.time_s * 1e9)), cdr.bytes());
  }
  const Trace back = read_trace(kPath);  // what is on the disk at this moment
  CHECK(back.loss.unclosed);
  CHECK(back.samples.size() >= 750 && is_part(back.samples, trace.samples));

  McapWriter late(kPath, McapWriter::Place::kNamedOnFlush);  // of a host that was told the same name
  const std::uint16_t its_channel = late.add_channel(kSampleType.topic, kSampleType.name, kSampleType.text);
  late.add_message(its_channel, 0, cdr.bytes());
  CHECK(code_of([&] { late.flush(); }) == "E-TRACE-WRITE");
  CHECK(read_trace(kPath).samples.size() == back.samples.size());
}

}  // namespace

int main() {
  std::filesystem::remove_all(kFolder);
  std::filesystem::create_directories(kFolder);
  writer_without_close_leaves_nothing();
  crc_is_that_of_zlib();
  trace_comes_back_bit_for_bit();
  run_comes_back_bit_for_bit();
  wrong_values_are_refused();
  what_belongs_to_no_step_is_counted();
  wrong_files_are_refused_by_name();
  length_without_end_allocates_nothing();
  recorder_killed_loses_under_a_quarter_second();
  std::filesystem::remove_all(kFolder);
  return finish();
}
