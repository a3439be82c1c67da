// Runs a fuzz target over saved files, and over copies of them with a few bytes changed: what a machine without a
// fuzzer can do. replay FOLDER [CHANGED_COPIES]
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <vector>

#include "target.h"

namespace {

using FileBytes = std::vector<std::uint8_t>;

FileBytes changed(FileBytes bytes, std::mt19937& random) {
  const auto below = [&](std::size_t n) { return std::size_t(random() % std::max<std::size_t>(n, 1)); };
  for (std::size_t k = 0; k < 1 + below(4) && !bytes.empty(); ++k) {
    const std::size_t at = below(bytes.size());
    const auto place = bytes.begin() + std::ptrdiff_t(at);
    switch (below(5)) {
      case 0:
        bytes[at] ^= std::uint8_t(1 << below(8));
        break;
      case 1:
        bytes[at] = std::uint8_t(random());
        break;
      case 2:
        bytes.insert(place, std::uint8_t(random()));
        break;
      case 3:
        bytes.erase(place, place + std::ptrdiff_t(below(std::min<std::size_t>(bytes.size() - at, 16)) + 1));
        break;
      default:  // a length or a count that lies
        for (std::size_t i = 0; i < 4 && at + i < bytes.size(); ++i) bytes[at + i] = below(2) ? 0xFF : 0;
    }
  }
  return bytes;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) return 2;
  const long copies = argc > 2 ? std::atol(argv[2]) : 0;
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(argv[1])) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  std::mt19937 random(1);
  for (const auto& path : files) {
    std::ifstream in(path, std::ios::binary);
    const FileBytes bytes{std::istreambuf_iterator<char>(in), {}};
    LLVMFuzzerTestOneInput(bytes.data(), bytes.size());
    for (long i = 0; i < copies; ++i) {
      const FileBytes copy = changed(bytes, random);
      LLVMFuzzerTestOneInput(copy.data(), copy.size());
    }
  }
  std::printf("%zu files, %ld changed copies of each\n", files.size(), copies);
  return files.empty();
}
