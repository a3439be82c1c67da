// Damaged files: whatever byte is missing, added or turned, what comes out was in the original, and damage is counted.
#include "check.h"
#include "made_files.h"

using namespace palmar;

namespace {

const std::filesystem::path kFolder = std::filesystem::temp_directory_path() / "palmar_test_damage";
const std::string kPath = (kFolder / "file.mcap").string();

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

}  // namespace

int main() {
  std::filesystem::remove_all(kFolder);
  std::filesystem::create_directories(kFolder);
  every_prefix_gives_a_prefix_or_an_error();
  every_flipped_bit_is_refused_or_counted();
  every_inserted_or_missing_byte_is_refused_or_counted();
  two_damaged_places_are_both_counted();
  damaged_run_never_tears_a_step_from_its_contacts();
  std::filesystem::remove_all(kFolder);
  return finish();
}
