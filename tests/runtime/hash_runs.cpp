// Replays packs and traces and prints the content hash of each run: hash_runs THREADS [PACK TRACE OBJECT SETTINGS]...
// Each of THREADS threads replays all of them at the same time; all must come to the same.
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "error.h"
#include "replay.h"
#include "settings.h"

using namespace palmar;

namespace {

std::string hashes_of(const std::vector<std::string>& inputs, const std::string& out) {
  std::string said;
  for (std::size_t i = 0; i + 3 < inputs.size(); i += 4) {
    try {
      said +=
          replay(inputs[i], inputs[i + 1], out, inputs[i + 2], parse_settings(inputs[i + 3]), {}, {}).content_fnv1a64;
    } catch (const Error& error) {
      said += error.what();
    }
    said += " " + std::filesystem::path(inputs[i + 1]).filename().string() + "\n";
  }
  std::filesystem::remove(out);
  return said;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 6 || argc % 4 != 2) return 2;
  const std::vector<std::string> inputs(argv + 2, argv + argc);
  const std::string place = (std::filesystem::temp_directory_path() / "palmar_hash_runs_").string();
  std::vector<std::string> said(std::size_t(std::max(1, std::atoi(argv[1]))));
  std::vector<std::thread> threads;
  for (std::size_t k = 0; k < said.size(); ++k)
    threads.emplace_back(
        [&, k] { said[k] = hashes_of(inputs, place + std::to_string(getpid()) + "_" + std::to_string(k) + ".mcap"); });
  for (std::thread& thread : threads) thread.join();
  for (const std::string& one : said)
    if (one != said.front()) {
      std::printf("threads differ:\n%s%s", said.front().c_str(), one.c_str());
      return 1;
    }
  std::fputs(said.front().c_str(), stdout);
  return 0;
}
