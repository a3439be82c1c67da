// Memory that ends and disks that fail, at every place where they can: the Nth allocation, the Nth call to the file
// system, the Nth byte. Whatever fails, an earlier file under the name stays as it was, nothing else is left, no file
// stays open, and the next attempt succeeds.
#include <dlfcn.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <set>

#include "check.h"
#include "device_recording.h"
#include "error.h"
#include "made_pack.h"
#include "pack_file.h"
#include "recorder.h"
#include "replay.h"
#include "run_file.h"
#include "trace_file.h"

using namespace palmar;

namespace {

// How many go well until one fails; below 0: all do.
std::atomic<long> memory_left{-1}, calls_left{-1};
std::size_t small = 0;  // allocations below this size always go well

bool fails(std::atomic<long>& left) { return left.load() >= 0 && left.fetch_sub(1) == 0; }

template <class Function>
Function* original(Function*, const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

}  // namespace

__attribute__((noinline)) void* operator new(std::size_t size) {
  void* p = size >= small && fails(memory_left) ? nullptr : std::malloc(size);
  if (!p) throw std::bad_alloc();
  return p;
}
__attribute__((noinline)) void operator delete(void* p) noexcept { std::free(p); }
__attribute__((noinline)) void operator delete(void* p, std::size_t) noexcept { std::free(p); }

// Each way by which the writers and the readers of MCAP reach a file. A file that fails to close is closed all the
// same.
extern "C" {
FILE* fopen(const char* path, const char* mode) {
  static auto* const open = original(&fopen, "fopen");
  return fails(calls_left) ? (errno = EMFILE, nullptr) : open(path, mode);
}
size_t fwrite(const void* from, size_t size, size_t count, FILE* file) {
  static auto* const put = original(&fwrite, "fwrite");
  return fails(calls_left) ? (errno = ENOSPC, 0) : put(from, size, count, file);
}
size_t fread(void* to, size_t size, size_t count, FILE* file) {
  static auto* const get = original(&fread, "fread");
  if (!fails(calls_left)) return get(to, size, count, file);
  file->_flags |= 0x20;  // what ferror() of glibc asks for
  return get(to, size, count / 2, file);
}
int fflush(FILE* file) {
  static auto* const flush = original(&fflush, "fflush");
  return fails(calls_left) ? (errno = EIO, EOF) : flush(file);
}
int fclose(FILE* file) {
  static auto* const close_file = original(&fclose, "fclose");
  const bool failing = fails(calls_left);
  return close_file(file) != 0 || failing ? (errno = EIO, EOF) : 0;
}
int rename(const char* from, const char* to) {
  static auto* const name = original(static_cast<int (*)(const char*, const char*)>(&rename), "rename");
  return fails(calls_left) ? (errno = EACCES, -1) : name(from, to);
}
}

namespace {

const std::filesystem::path kFolder =
    std::filesystem::temp_directory_path() / ("palmar_test_failures_" + std::to_string(getpid()));
const std::string kTrace = (kFolder / "in.mcap").string(), kPack = (kFolder / "in.pack").string(),
                  kRun = (kFolder / "in.run.mcap").string(), kOut = (kFolder / "out.mcap").string();

std::string content(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void store(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary).write(bytes.data(), std::ssize(bytes));
}

std::set<std::string> names() {
  std::set<std::string> all;
  for (const auto& entry : std::filesystem::directory_iterator(kFolder)) all.insert(entry.path().filename().string());
  return all;
}

std::ptrdiff_t open_files() {
  const std::filesystem::directory_iterator all("/proc/self/fd");
  return std::distance(begin(all), end(all));
}

std::string code_of(const std::function<void()>& call) {
  try {
    call();
    return "";
  } catch (const Error& error) {
    return error.code;
  } catch (const std::bad_alloc&) {
    return "memory";
  }
}

Trace make_trace(std::size_t count) {
  Trace trace;
  trace.header = {{"device", "test"}, {"hand", "a hand whose name is no short text"}, {"side", "left"}};
  for (std::size_t i = 0; i < count; ++i) {
    Sample sample;
    sample.time_s = 0.01 * double(i);
    sample.pose.palm.position_m = {0, 0, 0.3 - 0.001 * double(i)};
    trace.samples.push_back(sample);
    trace.device_bytes.push_back({sample.time_s, std::vector<std::uint8_t>(1 + i % 7, std::uint8_t(i))});
  }
  return trace;
}

// Fails `work` at each place where `left` can. What it writes is `out`, "" for nothing. Gives how many places there
// are.
long fail_everywhere(std::atomic<long>& left, const std::string& out, const std::function<void()>& work) {
  const std::set<std::string> before = names();
  const std::string earlier = out.empty() ? "" : content(out);
  const std::ptrdiff_t open = open_files();
  for (long good = 0;; ++good) {
    left = good;
    const std::string code = code_of(work);
    const bool reached = left < 0;
    left = -1;
    CHECK(reached || code.empty());
    CHECK(!reached || !code.empty() || out.empty());  // what a reader has read is its own, whatever closing says
    CHECK(open_files() == open);
    if (!reached) return good;
    CHECK(code.empty() || code == "memory" || code.starts_with("E-"));
    CHECK(names() == before);
    CHECK(out.empty() || content(out) == earlier);
    if (checks_failed > 20) return good;
  }
}

// What `make` gives must be a sound file the same as `whole`; before that, every failure leaves the earlier one.
void writes_whole_or_not_at_all(const char* what, const std::string& whole, const std::function<void()>& make) {
  for (auto* left : {&memory_left, &calls_left}) {
    store(kOut, "an earlier file");
    const long places = fail_everywhere(*left, kOut, make);
    CHECK(places > 5);
    CHECK(content(kOut) == whole);
    std::printf("%s: fails at each of %ld %s\n", what, places, left == &memory_left ? "allocations" : "calls");
  }
  // A disk that is full after so many bytes.
  store(kOut, "an earlier file");
  const std::set<std::string> before = names();
  rlimit limit{};
  getrlimit(RLIMIT_FSIZE, &limit);
  const rlim_t all = limit.rlim_cur;
  for (std::size_t bytes = 0; bytes < whole.size(); bytes += 1 + whole.size() / 199) {
    limit.rlim_cur = bytes;
    setrlimit(RLIMIT_FSIZE, &limit);
    const std::string code = code_of(make);
    limit.rlim_cur = all;
    setrlimit(RLIMIT_FSIZE, &limit);
    CHECK(code == "E-TRACE-WRITE");
    CHECK(names() == before);
    CHECK(content(kOut) == "an earlier file");
  }
  make();
  CHECK(content(kOut) == whole);
}

void reads_or_says_why(const char* what, const std::function<std::string()>& read) {
  const std::string whole = read();
  for (auto* left : {&memory_left, &calls_left}) {
    const long places = fail_everywhere(*left, "", [&] { CHECK(read() == whole); });
    std::printf("%s: fails at each of %ld %s\n", what, places, left == &memory_left ? "allocations" : "calls");
  }
}

std::string said(const Trace& trace) {
  return std::to_string(trace.samples.size()) + " " + std::to_string(trace.loss.bytes + trace.loss.messages);
}

// A recorder keeps what it has. What it says it has written is there, and a name that it could not use is free again.
void records_or_says_why() {
  const Header header{{"device", "test"}, {"hand", "a"}, {"side", "left"}};
  const std::vector<Sample> samples = make_trace(100).samples;
  std::filesystem::remove(kOut);
  for (auto* left : {&memory_left, &calls_left}) {
    const std::set<std::string> before = names();
    const std::ptrdiff_t open = open_files();
    Recorder::Counts counts;
    const std::function<void()> record = [&] {
      counts = {};
      Recorder recorder(kOut, header, 256);
      for (const Sample& sample : samples) recorder.append(sample);
      try {
        counts = recorder.close();
      } catch (...) {
        counts = recorder.counts();
        throw;
      }
    };
    for (long good = 0;; ++good) {
      *left = good;
      const std::string code = code_of(record);
      const bool reached = *left < 0;
      *left = -1;
      CHECK(reached || code.empty());
      CHECK(code.empty() || code == "memory" || code == "E-TRACE-WRITE");
      CHECK(open_files() == open);
      if (counts.written > 0)
        CHECK(read_trace(kOut).samples.size() >= counts.written);
      else if (!code.empty())
        CHECK(names() == before || read_mcap(kOut).messages.size() > 0);
      std::filesystem::remove(kOut);
      if (!reached || checks_failed > 20) {
        CHECK(counts.written == samples.size());
        std::printf("recorder: fails at each of %ld %s\n", good, left == &memory_left ? "allocations" : "calls");
        break;
      }
    }
  }
}

// Nor does a device's recording end its process: the thread that writes hands over what it met, and what has the name
// can be read.
void records_a_device_or_says_why() {
  const Trace trace = make_trace(40);
  for (auto* left : {&memory_left, &calls_left}) {
    const std::set<std::string> before = names();
    const std::ptrdiff_t open = open_files();
    std::size_t added = 0;
    const std::function<void()> record = [&] {
      added = 0;
      DeviceRecording recording(kOut, trace.header);
      for (std::size_t i = 0; i < trace.samples.size(); ++i) {
        recording.add_device_bytes(trace.device_bytes[i]), ++added;
        recording.add(trace.samples[i]), ++added;
      }
      recording.close({{"recorded", "to its end"}});
    };
    for (long good = 0;; ++good) {
      *left = good;
      const std::string code = code_of(record);
      const bool reached = *left < 0;
      *left = -1;
      CHECK(code.empty() != reached);
      CHECK(code.empty() || code == "memory" || code == "E-TRACE-WRITE");
      CHECK(open_files() == open);
      const std::size_t kept = names() == before ? 0 : read_mcap(kOut).messages.size();
      CHECK(kept <= added && (names() == before || kept > 0));
      if (code.empty()) CHECK(kept == 2 * trace.samples.size());
      if (code.empty()) CHECK(read_trace(kOut).header.at("recorded") == "to its end");
      std::filesystem::remove(kOut);
      if (!reached || checks_failed > 20) {
        std::printf("device: fails at each of %ld %s\n", good, left == &memory_left ? "allocations" : "calls");
        break;
      }
    }
  }
}

// What stood under the name of a recording that never began is not its own to take away.
void what_cannot_be_opened_stays() {
  store(kOut, "of somebody else");
  calls_left = 0;
  CHECK(code_of([] { McapWriter(kOut, McapWriter::Place::kNamedOnFlush); }) == "E-TRACE-WRITE");
  calls_left = -1;
  CHECK(content(kOut) == "of somebody else");
  std::filesystem::remove(kOut);
}

}  // namespace

int main() {
  signal(SIGXFSZ, SIG_IGN);  // a limit on files is then an error of the write
  std::filesystem::create_directories(kFolder);
  const Trace trace = make_trace(40);
  write_trace(kTrace, trace);
  store(kPack, made::pack_bytes());
  replay(kPack, kTrace, kRun, "ball", {}, {}, {});

  writes_whole_or_not_at_all("trace", content(kTrace), [&] { write_trace(kOut, trace); });
  const Run run = read_run(kRun);
  const auto write_run = [&] {
    RunWriter writer(kOut, {{"solver", "none"}, {"object", "an object whose name is no short text"}});
    for (std::size_t i = 0; i < run.steps.size(); ++i) writer.add(run.steps[i], run.timing[i], {});
    writer.close();
  };
  write_run();
  writes_whole_or_not_at_all("run", content(kOut), write_run);
  reads_or_says_why("trace reader", [] { return said(read_trace(kTrace)); });
  reads_or_says_why("run reader", [] { return std::to_string(read_run(kRun).steps.size()); });
  // The library's tree of a JSON text asks for memory to give memory back, and ends the program where there is none:
  // only what is larger than its stack for this text can fail.
  small = 512;
  reads_or_says_why("pack reader", [] { return std::to_string(read_pack(kPack).objects.size()); });
  small = 0;
  records_or_says_why();
  records_a_device_or_says_why();
  what_cannot_be_opened_stays();
  std::filesystem::remove_all(kFolder);
  return finish();
}
