// The C interface: what it does is what the core does, bit for bit, and what it refuses it says in one line, whatever
// room there is for that.
#include <palmar/palmar.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <new>
#include <regex>
#include <thread>

#include "check.h"
#include "made_pack.h"
#include "pack_file.h"
#include "session.h"
#include "settings.h"
#include "trace_file.h"

using namespace palmar;

namespace {

bool no_memory = false;

}  // namespace

__attribute__((noinline)) void* operator new(std::size_t size) {
  void* p = no_memory ? nullptr : std::malloc(size);
  if (!p) throw std::bad_alloc();
  return p;
}
__attribute__((noinline)) void operator delete(void* p) noexcept { std::free(p); }
__attribute__((noinline)) void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace {

const std::filesystem::path kFolder =
    std::filesystem::temp_directory_path() / ("palmar_test_c_api_" + std::to_string(getpid()));
const std::string kPack = (kFolder / "ball.pack").string(), kTrace = (kFolder / "out.mcap").string();

bool begins(const char* text, const std::string& with) { return std::string(text).starts_with(with); }

// Palm down onto the balls and along them, fingers closing, while the object is carried about; every tenth sample the
// device has lost the hand.
palmar_sample sample_at(int k) {
  palmar_sample sample{};
  sample.size = sizeof sample;
  sample.tracked = k % 10 != 9;
  sample.time_s = 0.001 * k;
  sample.haptic.palm = {{0.0002 * k, 0.01, 0.05 - 0.001 * k}, {0, 0, 1, 0}};
  for (int j = 0; j < 15; ++j) sample.haptic.flexion_rad[j] = 0.02 * k + 0.01 * j;
  for (int f = 0; f < 5; ++f) sample.haptic.abduction_rad[f] = 0.001 * k - 0.01 * f;
  sample.has_object_pose = k % 2;
  sample.object = {{0.0001 * k, 0, 0}, {std::cos(0.01 * k), 0, 0, std::sin(0.01 * k)}};
  return sample;
}

Sample core_sample_at(int k) {
  const palmar_sample from = sample_at(k);
  Sample sample;
  sample.time_s = from.time_s;
  sample.tracked = from.tracked;
  sample.pose.palm = {std::to_array(from.haptic.palm.position_m), std::to_array(from.haptic.palm.rotation_wxyz)};
  sample.pose.flexion_rad = std::to_array(from.haptic.flexion_rad);
  sample.pose.abduction_rad = std::to_array(from.haptic.abduction_rad);
  sample.has_object_pose = from.has_object_pose;
  if (from.has_object_pose)
    sample.object = {std::to_array(from.object.position_m), std::to_array(from.object.rotation_wxyz)};
  return sample;
}

void steps_as_the_core_does() {
  palmar_session* session = nullptr;
  char message[200] = "left from before";
  CHECK(palmar_open(kPack.c_str(), nullptr, R"({"iterations": 3})", &session, message, sizeof message) == PALMAR_OK);
  CHECK(message[0] == '\0');
  const AssetPack pack = read_pack(kPack);
  Session core(pack.hand, find_level(pack, kPack, "ball", -1), parse_settings(R"({"iterations": 3})"));
  std::size_t most = 0;
  for (int k = 0; k < 60; ++k) {
    const palmar_sample sample = sample_at(k);
    palmar_result result{};
    result.size = sizeof result;
    CHECK(palmar_step(session, &sample, &result) == PALMAR_OK);
    const StepResult& said = core.step(core_sample_at(k));
    CHECK(result.time_s == said.time_s && result.status == said.status && result.state_hash == said.state_hash);
    CHECK(result.operations == said.operations && result.contacts == said.contacts);
    CHECK(std::to_array(result.graphic.palm.position_m) == said.graphic.palm.position_m);
    CHECK(std::to_array(result.graphic.palm.rotation_wxyz) == said.graphic.palm.rotation_wxyz);
    CHECK(std::to_array(result.graphic.flexion_rad) == said.graphic.flexion_rad);
    CHECK(std::to_array(result.graphic.abduction_rad) == said.graphic.abduction_rad);
    CHECK(std::to_array(result.palm_force_n) == said.palm_force_n);
    CHECK(std::to_array(result.palm_torque_n_m) == said.palm_torque_n_m);
    CHECK(std::to_array(result.joint_torque_n_m) == said.joint_torque_n_m);
    CHECK(std::to_array(result.fingertip_force_n) == said.fingertip_force_n);

    const auto found = core.contacts();
    most = std::max(most, found.size());
    CHECK(palmar_contacts(session, nullptr, 100) == found.size());
    palmar_contact list[512], first[1];
    CHECK(palmar_contacts(session, list, 512) == found.size());
    for (std::size_t i = 0; i < found.size(); ++i) {
      CHECK(list[i].link == found[i].link && list[i].object_sphere == found[i].object_sphere);
      CHECK(list[i].palm_sphere == found[i].palm_sphere && list[i].gap_m == found[i].gap_m);
      CHECK(list[i].force_n == found[i].force_n && std::to_array(list[i].point_m) == found[i].point_m);
      CHECK(std::to_array(list[i].normal) == found[i].normal);
    }
    first[0].link = 77;
    CHECK(palmar_contacts(session, first, 0) == found.size() && first[0].link == 77);
    CHECK(palmar_contacts(session, first, 1) == found.size());
    CHECK(found.empty() || std::memcmp(first, list, sizeof first) == 0);
  }
  CHECK(most > 1);  // so that a list may have no room for all
  palmar_close(session);
  palmar_close(nullptr);
}

// Nothing is stepped and nothing is written into the result.
void refuses_structs_of_another_size() {
  palmar_session* session = nullptr;
  CHECK(palmar_open(kPack.c_str(), "", nullptr, &session, nullptr, 0) == PALMAR_OK);
  palmar_sample sample = sample_at(0);
  palmar_result result{}, untouched{};
  result.size = untouched.size = sizeof result;
  CHECK(palmar_step(nullptr, &sample, &result) == PALMAR_BAD_INPUT);
  CHECK(palmar_step(session, nullptr, &result) == PALMAR_BAD_INPUT);
  CHECK(palmar_step(session, &sample, nullptr) == PALMAR_BAD_INPUT);
  sample.size -= 8;
  CHECK(palmar_step(session, &sample, &result) == PALMAR_BAD_INPUT);
  CHECK(std::memcmp(&result, &untouched, sizeof result) == 0);
  sample.size += 8;
  result.size += 8;
  CHECK(palmar_step(session, &sample, &result) == PALMAR_BAD_INPUT);
  CHECK(palmar_contacts(nullptr, nullptr, 0) == 0);
  palmar_close(session);
}

void says_what_is_wrong_with_an_opening() {
  palmar_session* session = nullptr;
  char message[200], cut[12];
  CHECK(palmar_open(nullptr, "", "{}", &session, message, sizeof message) == PALMAR_BAD_INPUT);
  CHECK(begins(message, "E-CONF-VALUE pack_path, session: "));
  CHECK(palmar_open(kPack.c_str(), "", "{}", nullptr, message, sizeof message) == PALMAR_BAD_INPUT);
  CHECK(begins(message, "E-CONF-VALUE pack_path, session: "));
  const struct {
    std::string pack, object, settings, said;
  } cases[] = {
      {(kFolder / "none").string(), "", "{}", "E-PACK-MISSING " + (kFolder / "none").string() + ": "},
      {kPack, "cup", "{}", "E-PACK-OBJECT " + kPack + ": no object 'cup'; it holds: ball"},
      {kPack, "", "[]", "E-CONF-FORMAT settings: "},
      {kPack, "", R"({"solver": "magic"})", "E-CONF-VALUE solver: no solver is called 'magic'; there are: progressive"},
      {kPack, "", R"({"level": 1})", "E-PACK-LEVEL " + kPack + ": level 1 asked, but 'ball' has levels 0 to 0"},
  };
  for (const auto& c : cases) {
    session = reinterpret_cast<palmar_session*>(&session);
    CHECK(palmar_open(c.pack.c_str(), c.object.c_str(), c.settings.c_str(), &session, message, sizeof message) ==
          PALMAR_BAD_INPUT);
    CHECK(session == nullptr && begins(message, c.said));
    // A buffer that is too short gets the beginning, and no byte behind it is touched.
    std::memset(cut, '!', sizeof cut);
    palmar_open(c.pack.c_str(), c.object.c_str(), c.settings.c_str(), &session, cut, sizeof cut - 2);
    CHECK(std::string(cut) == c.said.substr(0, sizeof cut - 3) && cut[10] == '!' && cut[11] == '!');
    CHECK(palmar_open(c.pack.c_str(), c.object.c_str(), c.settings.c_str(), &session, nullptr, 9) == PALMAR_BAD_INPUT);
    CHECK(palmar_open(c.pack.c_str(), c.object.c_str(), c.settings.c_str(), &session, cut, 0) == PALMAR_BAD_INPUT);
    CHECK(begins(cut, "E-"));
  }
  no_memory = true;
  const palmar_code code = palmar_open(kPack.c_str(), "", nullptr, &session, message, sizeof message);
  no_memory = false;
  CHECK(code == PALMAR_BAD_INPUT && session == nullptr);
  CHECK(std::string(message) == "E-MEMORY palmar: the system gives no more memory");
}

palmar_recording recording_of(const char* object = nullptr, double rate_hz = 0) {
  return {sizeof(palmar_recording), 16, "a glove", "b", "left", object, rate_hz};
}

palmar_recorder_counts empty_counts() {
  palmar_recorder_counts counts{};
  counts.size = sizeof counts;
  return counts;
}

void says_what_is_wrong_with_a_recording() {
  char message[200];
  palmar_recorder* recorder = nullptr;
  const auto said = [&](const char* path, const palmar_recording* recording, const std::string& what) {
    recorder = reinterpret_cast<palmar_recorder*>(&recorder);
    const palmar_code code = palmar_recorder_open(path, recording, &recorder, message, sizeof message);
    CHECK(code == PALMAR_BAD_INPUT && recorder == nullptr && begins(message, what));
  };
  palmar_recording recording = recording_of();
  said(nullptr, &recording, "E-CONF-VALUE path, recording, recorder: ");
  said(kTrace.c_str(), nullptr, "E-CONF-VALUE path, recording, recorder: ");
  CHECK(palmar_recorder_open(kTrace.c_str(), &recording, nullptr, nullptr, 0) == PALMAR_BAD_INPUT);
  recording.size -= 4;
  said(kTrace.c_str(), &recording, "E-CONF-VALUE path, recording, recorder: ");
  for (const char* palmar_recording::* text :
       {&palmar_recording::device, &palmar_recording::hand, &palmar_recording::side}) {
    recording = recording_of();
    recording.*text = nullptr;
    said(kTrace.c_str(), &recording, "E-CONF-VALUE device, hand, side: ");
  }
  for (const double rate_hz : {-1.0, 2e6, std::numeric_limits<double>::quiet_NaN()}) {
    recording = recording_of(nullptr, rate_hz);
    said(kTrace.c_str(), &recording, "E-CONF-VALUE rate_hz: ");
  }
  for (const std::uint32_t ring : {15u, 1048577u}) {
    recording = recording_of();
    recording.ring_samples = ring;
    said(kTrace.c_str(), &recording, "E-CONF-VALUE ring_samples: " + std::to_string(ring) + "; 16 to 1048576");
  }
  recording = recording_of("not \xFF text");
  said(kTrace.c_str(), &recording, "E-TRACE-HEADER ");
  recording = recording_of();
  said("/dev/full", &recording, "E-TRACE-WRITE /dev/full: ");
  CHECK(std::distance(std::filesystem::directory_iterator(kFolder), {}) == 1);  // the pack alone
}

void records_what_it_says() {
  char message[200];
  palmar_recorder* recorder = nullptr;
  palmar_recording recording = recording_of("cup", 1000.0 / 3.0);
  recording.ring_samples = 0;
  CHECK(palmar_recorder_open(kTrace.c_str(), &recording, &recorder, message, sizeof message) == PALMAR_OK);
  palmar_sample sample = sample_at(1);
  CHECK(palmar_recorder_append(nullptr, &sample) == PALMAR_BAD_INPUT);
  CHECK(palmar_recorder_append(recorder, nullptr) == PALMAR_BAD_INPUT);
  sample.size = 0;
  CHECK(palmar_recorder_append(recorder, &sample) == PALMAR_BAD_INPUT);
  for (int k = 0; k < 50; ++k) {
    sample = sample_at(k);
    CHECK(palmar_recorder_append(recorder, &sample) == PALMAR_OK);
  }
  CHECK(palmar_recorder_append(recorder, &sample) == PALMAR_BAD_INPUT);  // the time has not risen
  palmar_recorder_counts counts = empty_counts();
  CHECK(palmar_recorder_count(nullptr, &counts) == PALMAR_BAD_INPUT);
  CHECK(palmar_recorder_count(recorder, nullptr) == PALMAR_BAD_INPUT);
  CHECK(palmar_recorder_count(recorder, &counts) == PALMAR_OK && counts.taken == 50 && counts.refused == 1);
  counts.size = 4;
  CHECK(palmar_recorder_count(recorder, &counts) == PALMAR_BAD_INPUT);
  // A struct of another size ends nothing: the recorder is still there.
  CHECK(palmar_recorder_close(recorder, &counts, message, sizeof message) == PALMAR_BAD_INPUT);
  CHECK(begins(message, "E-CONF-VALUE recorder, counts: "));
  counts = empty_counts();
  CHECK(palmar_recorder_close(recorder, &counts, message, sizeof message) == PALMAR_LOSS && message[0] == '\0');
  CHECK(counts.taken == 50 && counts.written == 50 && counts.refused == 1 && !counts.failed && counts.dropped == 0);
  CHECK(palmar_recorder_close(nullptr, nullptr, message, sizeof message) == PALMAR_BAD_INPUT);

  const Trace trace = read_trace(kTrace);
  CHECK(trace.header.at("object") == "cup" && trace.header.at("device") == "a glove");
  CHECK(trace.header.at("rate_hz") == "333.333333" && trace.header.at("side") == "left");
  CHECK(trace.samples.size() == 50);
  for (int k = 0; k < 50; ++k) {
    const Sample &read = trace.samples[k], given = core_sample_at(k);
    CHECK(read.time_s == given.time_s && read.tracked == given.tracked);
    CHECK(read.has_object_pose == given.has_object_pose && read.object.position_m == given.object.position_m);
    CHECK(read.pose.flexion_rad == (given.tracked ? given.pose.flexion_rad : HandPose{}.flexion_rad));
  }
  std::filesystem::remove(kTrace);

  recording = recording_of();
  CHECK(palmar_recorder_open(kTrace.c_str(), &recording, &recorder, nullptr, 0) == PALMAR_OK);
  sample = sample_at(0);
  CHECK(palmar_recorder_append(recorder, &sample) == PALMAR_OK);
  CHECK(palmar_recorder_close(recorder, nullptr, nullptr, 0) == PALMAR_OK);
  CHECK(!read_trace(kTrace).header.contains("rate_hz") && !read_trace(kTrace).header.contains("object"));
  std::filesystem::remove(kTrace);
}

// A disk that is full while it records: what comes then is dropped, and closing says why.
void says_that_the_disk_is_full() {
  signal(SIGXFSZ, SIG_IGN);
  palmar_recorder* recorder = nullptr;
  const palmar_recording recording = recording_of();
  CHECK(palmar_recorder_open(kTrace.c_str(), &recording, &recorder, nullptr, 0) == PALMAR_OK);
  rlimit limit{};
  getrlimit(RLIMIT_FSIZE, &limit);
  const rlim_t all = std::exchange(limit.rlim_cur, 10);
  setrlimit(RLIMIT_FSIZE, &limit);
  palmar_sample sample = sample_at(0);
  CHECK(palmar_recorder_append(recorder, &sample) == PALMAR_OK);
  palmar_recorder_counts counts = empty_counts();
  for (int wait = 0; wait < 1000 && !counts.failed; ++wait) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    palmar_recorder_count(recorder, &counts);
  }
  limit.rlim_cur = all;
  setrlimit(RLIMIT_FSIZE, &limit);
  CHECK(counts.failed == 1);
  sample = sample_at(1);
  CHECK(palmar_recorder_append(recorder, &sample) == PALMAR_LOSS);
  char message[200];
  CHECK(palmar_recorder_close(recorder, &counts, message, sizeof message) == PALMAR_BAD_INPUT);
  CHECK(begins(message, "E-TRACE-WRITE " + kTrace + ": "));
  CHECK(counts.taken == 1 && counts.written == 0 && counts.dropped == 1);
  CHECK(!std::filesystem::exists(kTrace));
}

}  // namespace

int main() {
  std::filesystem::create_directories(kFolder);
  made::PackChange two_balls;
  two_balls.shapes["object/ball/level_0/spheres_m"] = {2, 4};
  two_balls.numbers["object/ball/level_0/spheres_m"] = {0.015, 0, 0, 0.02, -0.015, 0, 0, 0.02};
  const std::string pack = made::pack_bytes(two_balls);
  std::ofstream(kPack, std::ios::binary).write(pack.data(), std::ssize(pack));
  CHECK(std::regex_match(palmar_version(), std::regex(R"(\d+\.\d+\.\d+)")));
  steps_as_the_core_does();
  refuses_structs_of_another_size();
  says_what_is_wrong_with_an_opening();
  says_what_is_wrong_with_a_recording();
  records_what_it_says();
  says_that_the_disk_is_full();
  std::filesystem::remove_all(kFolder);
  return finish();
}
