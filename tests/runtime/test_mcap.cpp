#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <string>
#include <vector>

#include "check.h"
#include "crc32.h"
#include "error.h"
#include "mcap_reader.h"
#include "mcap_writer.h"
#include "run_file.h"
#include "schemas.h"
#include "trace_file.h"

using namespace palmar;

namespace {

using FileBytes = std::vector<std::uint8_t>;

const std::filesystem::path kFolder = std::filesystem::temp_directory_path() / "palmar_test_mcap";
const std::string kPath = (kFolder / "file.mcap").string();

FileBytes load(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void store(const std::string& path, const FileBytes& bytes) {
  std::filesystem::remove(path);  // some file systems wait for the disk when a file is overwritten
  std::ofstream(path, std::ios::binary).write(reinterpret_cast<const char*>(bytes.data()), std::ssize(bytes));
}

// Values without a pattern that a shifted read could meet by luck.
double number(std::size_t i) { return std::sin(1.7 * static_cast<double>(i) + 0.3); }

HandPose make_pose(std::size_t index) {
  const std::size_t i = 100 * index;
  HandPose pose;
  pose.palm.position_m = {number(i), number(i + 1), number(i + 2)};
  const double half = number(i + 3);
  pose.palm.rotation_wxyz = {std::cos(half), 0, std::sin(half), 0};
  for (std::size_t k = 0; k < 15; ++k) pose.flexion_rad[k] = number(i + 4 + k);
  for (std::size_t k = 0; k < 5; ++k) pose.abduction_rad[k] = number(i + 19 + k);
  return pose;
}

Trace make_trace(std::size_t count, double interval_s) {
  Trace trace;
  trace.header = {{"schema", "palmar.trace/1"}, {"device", "test \xC3\xA9"}, {"hand", "a"}, {"side", "left"}};
  for (std::size_t i = 0; i < count; ++i) {
    Sample sample;
    sample.time_s = 0.5 + interval_s * static_cast<double>(i);
    sample.tracked = i % 3 != 1;
    sample.pose = make_pose(i);
    sample.has_object_pose = i % 2 == 0;
    if (sample.has_object_pose) sample.object = make_pose(i + 100).palm;
    trace.samples.push_back(sample);
  }
  return trace;
}

bool same(const Placement& a, const Placement& b) {
  return a.position_m == b.position_m && a.rotation_wxyz == b.rotation_wxyz;
}

bool same(const HandPose& a, const HandPose& b) {
  return same(a.palm, b.palm) && a.flexion_rad == b.flexion_rad && a.abduction_rad == b.abduction_rad;
}

bool same(const Sample& a, const Sample& b) {
  return a.time_s == b.time_s && a.tracked == b.tracked && same(a.pose, b.pose) &&
         a.has_object_pose == b.has_object_pose && same(a.object, b.object);
}

bool same(const StepResult& a, const StepResult& b) {
  return a.time_s == b.time_s && a.status == b.status && same(a.graphic, b.graphic) && same(a.haptic, b.haptic) &&
         same(a.object, b.object) && a.palm_force_n == b.palm_force_n && a.palm_torque_n_m == b.palm_torque_n_m &&
         a.joint_torque_n_m == b.joint_torque_n_m && a.fingertip_force_n == b.fingertip_force_n &&
         a.equation14_force_n == b.equation14_force_n && a.contacts == b.contacts && a.operations == b.operations &&
         a.state_hash == b.state_hash;
}

bool same(const Contact& a, const Contact& b) {
  return a.link == b.link && a.object_sphere == b.object_sphere && a.palm_sphere == b.palm_sphere &&
         a.gap_m == b.gap_m && a.force_n == b.force_n && a.point_m == b.point_m && a.normal == b.normal;
}

template <class T>
bool all_same(const std::vector<T>& a, const std::vector<T>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const T& x, const T& y) { return same(x, y); });
}

// True if `part` is `whole` with elements left out.
template <class T>
bool is_part(const std::vector<T>& part, const std::vector<T>& whole) {
  std::size_t at = 0;
  for (const T& element : part) {
    while (at < whole.size() && !same(whole[at], element)) ++at;
    if (at++ == whole.size()) return false;
  }
  return true;
}

bool sound(const Loss& loss) { return loss.bytes == 0 && loss.chunks == 0 && loss.messages == 0 && !loss.unclosed; }

std::string code_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.code;
  }
  return "";
}

struct Steps {
  std::vector<StepResult> steps;
  std::vector<Timing> timing;
  std::vector<std::vector<Contact>> contacts;
};

Steps make_steps(std::size_t count, double interval_s) {
  Steps all;
  for (std::size_t i = 0; i < count; ++i) {
    StepResult step;
    step.time_s = interval_s * static_cast<double>(i);
    step.status = static_cast<std::uint32_t>(i % 64);
    step.graphic = make_pose(i);
    step.haptic = make_pose(i + 50);
    step.object = make_pose(i + 60).palm;
    step.palm_force_n = {number(i), -0.0, 1e-310};
    step.joint_torque_n_m = make_pose(i + 70).flexion_rad;
    step.fingertip_force_n = make_pose(i + 71).flexion_rad;
    step.equation14_force_n = make_pose(i + 72).flexion_rad;
    step.operations = 0xFFFFFFFFu - static_cast<std::uint32_t>(i);
    step.state_hash = 0xFEDCBA9876543210u + i;
    std::vector<Contact> contacts(i % 4);
    for (std::size_t k = 0; k < contacts.size(); ++k)
      contacts[k] = {static_cast<std::uint8_t>(k),
                     static_cast<std::uint32_t>(1000 * i + k),
                     UINT32_MAX,
                     -number(k),
                     number(i + k),
                     {number(k), number(i), 3.0},
                     {0.0, 1.0, number(k + 1)}};
    step.contacts = static_cast<std::uint32_t>(contacts.size());
    all.steps.push_back(step);
    all.timing.push_back({number(i), number(i + 1), number(i + 2), number(i + 3), number(i + 4)});
    all.contacts.push_back(contacts);
  }
  return all;
}

std::string write_run(const std::string& path, const Steps& all) {
  RunWriter writer(path, {{"solver", "none"}});
  for (std::size_t i = 0; i < all.steps.size(); ++i) writer.add(all.steps[i], all.timing[i], all.contacts[i]);
  return writer.close();
}

// Every step of a damaged run must still have its own contacts and times.
bool complete_steps(const Run& run, const Steps& all) {
  if (!is_part(run.steps, all.steps) || run.contact_start.size() != run.steps.size() + 1) return false;
  for (std::size_t i = 0; i < run.steps.size(); ++i) {
    const std::size_t original = run.steps[i].operations ^ 0xFFFFFFFFu;
    const std::vector<Contact> contacts(run.contacts.begin() + std::ptrdiff_t(run.contact_start[i]),
                                        run.contacts.begin() + std::ptrdiff_t(run.contact_start[i + 1]));
    if (!all_same(contacts, all.contacts[original])) return false;
    if (run.timing[i].verify_us != all.timing[original].verify_us) return false;
  }
  return true;
}

// Reads `bytes` as a trace. Gives false if anything comes out that is not in the original, or if damage goes unseen.
bool trace_is_safe(const FileBytes& bytes, const Trace& original, std::size_t* kept = nullptr) {
  store(kPath, bytes);
  try {
    const Trace trace = read_trace(kPath);
    if (kept) *kept = trace.samples.size();
    return !sound(trace.loss) && trace.header == original.header && is_part(trace.samples, original.samples);
  } catch (const Error& error) {
    if (kept) *kept = 0;
    return error.code.starts_with("E-TRACE-");
  }
}

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

void every_prefix_gives_a_prefix_or_an_error() {
  const Trace trace = make_trace(4, 0.3);  // 0.3 s apart: each sample in its own chunk
  write_trace(kPath, trace);
  const FileBytes whole = load(kPath);
  std::size_t last = 0, most = 0, wrong = 0;
  for (std::size_t size = 0; size < whole.size(); ++size) {
    std::size_t kept = 0;
    if (!trace_is_safe({whole.begin(), whole.begin() + std::ptrdiff_t(size)}, trace, &kept)) ++wrong;
    if (kept < last) ++wrong;  // a longer file never gives less
    if (kept > 0 && !same(read_trace(kPath).samples[kept - 1], trace.samples[kept - 1])) ++wrong;
    last = kept;
    most = std::max(most, kept);
  }
  CHECK(wrong == 0);
  CHECK(most == 4);
}

void every_flipped_bit_is_refused_or_counted() {
  const Trace trace = make_trace(3, 0.3);
  write_trace(kPath, trace);
  const FileBytes whole = load(kPath);
  std::size_t wrong = 0, refused = 0;
  for (std::size_t bit = 0; bit < 8 * whole.size(); ++bit) {
    FileBytes bytes = whole;
    bytes[bit / 8] ^= static_cast<std::uint8_t>(1 << bit % 8);
    std::size_t kept = 0;
    if (!trace_is_safe(bytes, trace, &kept)) ++wrong;
    if (kept == 0) ++refused;
    // One chunk at most is lost; only magic and header are needed for all the rest.
    if (kept == 1) ++wrong;
  }
  CHECK(wrong == 0);
  std::printf("bit flips: %zu of %zu refused, the others gave 2 or 3 of 3 samples\n", refused, 8 * whole.size());
  CHECK(refused < 8 * whole.size() / 10);  // the header record is about 2 percent of this file
}

void every_inserted_or_missing_byte_is_refused_or_counted() {
  const Trace trace = make_trace(3, 0.3);
  write_trace(kPath, trace);
  const FileBytes whole = load(kPath);
  std::size_t wrong = 0;
  for (std::size_t at = 0; at <= whole.size(); ++at) {
    for (const std::uint8_t extra : {0x00, 0x06, 0xFF}) {
      FileBytes bytes = whole;
      bytes.insert(bytes.begin() + std::ptrdiff_t(at), extra);
      if (!trace_is_safe(bytes, trace)) ++wrong;
    }
    if (at == whole.size()) continue;
    FileBytes bytes = whole;
    bytes.erase(bytes.begin() + std::ptrdiff_t(at));
    if (!trace_is_safe(bytes, trace)) ++wrong;
  }
  CHECK(wrong == 0);
}

void two_damaged_places_are_both_counted() {
  const Trace trace = make_trace(30, 0.3);
  write_trace(kPath, trace);
  FileBytes bytes = load(kPath);
  for (const std::size_t i : {5, 20}) {
    FileBytes mark(8);
    std::memcpy(mark.data(), trace.samples[i].pose.flexion_rad.data(), 8);
    const auto found = std::search(bytes.begin(), bytes.end(), mark.begin(), mark.end());
    CHECK(found != bytes.end());
    *found ^= 1;
  }
  store(kPath, bytes);
  const Trace back = read_trace(kPath);
  CHECK(back.loss.chunks == 2);
  CHECK(back.loss.messages == 2);
  CHECK(back.samples.size() == 28);
  CHECK(is_part(back.samples, trace.samples));
}

void damaged_run_never_tears_a_step_from_its_contacts() {
  const Steps all = make_steps(9, 0.1);  // three steps a chunk
  write_run(kPath, all);
  const FileBytes whole = load(kPath);
  std::size_t wrong = 0, read = 0;
  const auto check = [&](const FileBytes& bytes) {
    store(kPath, bytes);
    try {
      const Run run = read_run(kPath);
      ++read;
      if (sound(run.loss) || !complete_steps(run, all)) ++wrong;
    } catch (const Error& error) {
      if (!error.code.starts_with("E-TRACE-")) ++wrong;
    }
  };
  for (std::size_t at = 0; at < whole.size(); ++at) {
    FileBytes bytes = whole;
    bytes[at] ^= static_cast<std::uint8_t>(1 << at % 8);
    check(bytes);
    if (at % 7 == 0) check({whole.begin(), whole.begin() + std::ptrdiff_t(at)});
  }
  CHECK(wrong == 0);
  CHECK(read > whole.size() / 2);
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
  refuses("E-TRACE-HEADER", [](Trace& t) { t.header["crc32"] = "1"; });
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
            McapWriter writer("/dev/full", McapWriter::Place::kInPlace);
            writer.close();
          }) == "E-TRACE-WRITE");
}

void recorder_killed_loses_under_a_quarter_second() {
  const Trace trace = make_trace(1000, 0.001);
  McapWriter writer(kPath, McapWriter::Place::kInPlace);
  writer.add_metadata("palmar.trace", trace.header);
  const std::uint16_t channel = writer.add_channel(kSampleType.topic, kSampleType.name, kSampleType.text);
  CdrEncoder cdr;
  for (const Sample& sample : trace.samples) {
    cdr.start();
    sample_fields(cdr, sample);
    writer.add_message(channel, static_cast<std::uint64_t>(std::llround(sample.time_s * 1e9)), cdr.bytes());
  }
  const Trace back = read_trace(kPath);  // what is on the disk at this moment
  CHECK(back.loss.unclosed);
  CHECK(back.samples.size() >= 750 && is_part(back.samples, trace.samples));
}

}  // namespace

int main() {
  std::filesystem::remove_all(kFolder);
  std::filesystem::create_directories(kFolder);
  writer_without_close_leaves_nothing();
  crc_is_that_of_zlib();
  trace_comes_back_bit_for_bit();
  run_comes_back_bit_for_bit();
  every_prefix_gives_a_prefix_or_an_error();
  every_flipped_bit_is_refused_or_counted();
  every_inserted_or_missing_byte_is_refused_or_counted();
  two_damaged_places_are_both_counted();
  damaged_run_never_tears_a_step_from_its_contacts();
  wrong_values_are_refused();
  wrong_files_are_refused_by_name();
  length_without_end_allocates_nothing();
  recorder_killed_loses_under_a_quarter_second();
  std::filesystem::remove_all(kFolder);
  return finish();
}
