#include "pack_file.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numeric>
#include <string_view>

#include "crc32.h"
#include "error.h"

namespace palmar {

namespace {

using Json = nlohmann::json;

constexpr std::uint64_t kFileLimit = 512ull << 20;
constexpr std::uint64_t kHeaderLimit = 16ull << 20;
constexpr std::size_t kSphereLimit = 4'000'000;
constexpr std::size_t kPalmLimit = 100'000;
constexpr double kLargest = 1e6;  // of any number: squares and floats of it are still far from overflow

struct Tensor {
  std::string dtype;
  std::vector<std::size_t> shape;
  const unsigned char* bytes;
  std::size_t size() const { return std::accumulate(shape.begin(), shape.end(), std::size_t(1), std::multiplies<>()); }
};

struct File {
  std::string path;
  std::vector<unsigned char> bytes;
  std::map<std::string, Tensor> tensors;
  Json manifest;
};

[[noreturn]] void fail(const char* code, const std::string& where, const std::string& message) {
  throw Error(code, where, message);
}

// The manifest's value `crc32` is that of the whole file with its own eight digits as zeros. Packs of other tools may
// have none.
void check_crc(const File& file, std::size_t header_end) {
  constexpr std::string_view kMark = "\\\"crc32\\\": \\\"", kZeros = "00000000";  // in JSON inside JSON
  const std::span<const std::uint8_t> bytes(file.bytes);
  const auto header = bytes.first(header_end);
  const auto mark = std::search(header.begin(), header.end(), kMark.begin(), kMark.end());
  const auto at = std::size_t(mark - header.begin()) + kMark.size();
  if (at + kZeros.size() > header_end) return;
  std::uint32_t crc = crc32(bytes.first(at));
  crc = crc32({reinterpret_cast<const std::uint8_t*>(kZeros.data()), kZeros.size()}, crc);
  crc = crc32(bytes.subspan(at + kZeros.size()), crc);
  char digits[9];
  std::snprintf(digits, sizeof digits, "%08x", crc);
  if (!std::equal(digits, digits + 8, bytes.begin() + std::ptrdiff_t(at)))
    fail("E-PACK-CRC", file.path, "the file is damaged: its bytes do not fit their checksum");
}

std::vector<unsigned char> read_bytes(const std::string& path) {
  std::error_code problem;
  std::ifstream in;
  // A pipe would keep its reader waiting.
  if (std::filesystem::is_regular_file(path, problem)) in.open(path, std::ios::binary | std::ios::ate);
  if (!in.is_open()) fail("E-PACK-MISSING", path, "cannot be read; a file written by `palmar build` is needed");
  const std::uint64_t size = std::uint64_t(in.tellg());
  if (size > kFileLimit) fail("E-PACK-SIZE", path, std::to_string(size) + " bytes; at most 536870912");
  std::vector<unsigned char> bytes(size);
  in.seekg(0);
  in.read(reinterpret_cast<char*>(bytes.data()), std::streamsize(size));
  if (!in) fail("E-PACK-FORMAT", path, "could not be read to its end");
  return bytes;
}

// The tensors and the manifest, by their entries alone.
File open_file(std::vector<unsigned char> bytes, const std::string& path) {
  File file;
  file.path = path;
  file.bytes = std::move(bytes);
  const std::uint64_t size = file.bytes.size();
  std::uint64_t header_size = 0;
  if (size >= 8) std::memcpy(&header_size, file.bytes.data(), 8);
  if (size < 8 || header_size > size - 8 || header_size > kHeaderLimit)
    fail("E-PACK-FORMAT", path, "not a whole safetensors file: its header is longer than the file");
  const unsigned char* text = file.bytes.data() + 8;
  const unsigned char* data = text + header_size;
  const std::size_t data_size = size - 8 - header_size;
  const Json header = Json::parse(text, data, nullptr, false);
  if (!header.is_object()) fail("E-PACK-FORMAT", path, "its header is not a JSON object");

  std::uint64_t taken = 0;
  for (const auto& [name, entry] : header.items()) {
    if (name == "__metadata__") {
      const auto found = entry.find("palmar");
      if (found == entry.end() || !found->is_string())
        fail("E-PACK-FORMAT", path, "no manifest under the metadata key `palmar`");
      file.manifest = Json::parse(found->get<std::string>(), nullptr, false);
      continue;
    }
    Tensor tensor;
    const bool formed = entry.is_object() && entry.contains("dtype") && entry["dtype"].is_string() &&
                        entry.contains("shape") && entry["shape"].is_array() && entry.contains("data_offsets") &&
                        entry["data_offsets"].is_array() && entry["data_offsets"].size() == 2;
    if (!formed) fail("E-PACK-FORMAT", path + ":" + name, "not a tensor entry");
    tensor.dtype = entry["dtype"].get<std::string>();
    std::size_t count = 1;
    for (const Json& n : entry["shape"]) {
      if (!n.is_number_unsigned() || n.get<std::uint64_t>() > kFileLimit)
        fail("E-PACK-FORMAT", path + ":" + name, "its shape is not a list of sizes");
      tensor.shape.push_back(n.get<std::size_t>());
      if (tensor.shape.back() != 0 && count > kFileLimit / tensor.shape.back())
        fail("E-PACK-FORMAT", path + ":" + name, "its shape is larger than any file");
      count *= tensor.shape.back();
    }
    for (const Json& n : entry["data_offsets"])
      if (!n.is_number_unsigned()) fail("E-PACK-FORMAT", path + ":" + name, "its offsets are not numbers");
    const std::uint64_t begin = entry["data_offsets"][0].get<std::uint64_t>();
    const std::uint64_t end = entry["data_offsets"][1].get<std::uint64_t>();
    const std::size_t width = tensor.dtype == "F64" ? 8 : tensor.dtype == "I32" ? 4 : 0;
    if (width == 0) fail("E-PACK-SHAPE", path + ":" + name, tensor.dtype + "; F64 or I32 is needed");
    if (begin > end || end > data_size || end - begin != count * width)
      fail("E-PACK-FORMAT", path + ":" + name, "its bytes lie outside the file or do not fit its shape");
    // Tensors do not overlap: else a small file could ask for any amount of memory.
    taken += end - begin;
    if (taken > data_size) fail("E-PACK-FORMAT", path + ":" + name, "its bytes are another tensor's");
    tensor.bytes = data + begin;
    file.tensors.emplace(name, tensor);
  }
  if (!file.manifest.is_object()) fail("E-PACK-FORMAT", path, "no manifest under the metadata key `palmar`");
  check_crc(file, 8 + header_size);
  const auto named = file.manifest.find("schema");
  const std::string schema = named != file.manifest.end() && named->is_string() ? named->get<std::string>() : "";
  if (schema != "palmar.pack/2")
    fail("E-PACK-VERSION", path, "schema '" + schema + "'; this version reads 'palmar.pack/2'");
  return file;
}

// A tensor's numbers, checked: shape (0 stands for any size above 0) and finite.
std::vector<double> read_numbers(const File& file, const std::string& name, const std::vector<std::size_t>& shape) {
  const auto found = file.tensors.find(name);
  if (found == file.tensors.end()) fail("E-PACK-MISSING", file.path + ":" + name, "tensor is not in the file");
  const Tensor& tensor = found->second;
  bool fits = tensor.dtype == "F64" && tensor.shape.size() == shape.size();
  std::string wanted, have;
  for (std::size_t k = 0; k < shape.size(); ++k)
    wanted += (k ? ", " : "") + (shape[k] == 0 ? std::string("any") : std::to_string(shape[k]));
  for (std::size_t k = 0; k < tensor.shape.size(); ++k) have += (k ? ", " : "") + std::to_string(tensor.shape[k]);
  for (std::size_t k = 0; fits && k < shape.size(); ++k)
    fits = shape[k] == 0 ? tensor.shape[k] > 0 : tensor.shape[k] == shape[k];
  if (!fits)
    fail("E-PACK-SHAPE", file.path + ":" + name, tensor.dtype + " (" + have + "); F64 (" + wanted + ") is needed");
  std::vector<double> numbers(tensor.size());
  std::memcpy(numbers.data(), tensor.bytes, 8 * numbers.size());
  for (std::size_t i = 0; i < numbers.size(); ++i)
    if (!(std::abs(numbers[i]) <= kLargest))
      fail("E-PACK-VALUE", file.path + ":" + name + "[" + std::to_string(i) + "]",
           "not a finite number, or above 1e6 in size");
  return numbers;
}

std::vector<Sphere> read_spheres(const File& file, const std::string& name, std::size_t most) {
  const std::vector<double> v = read_numbers(file, name, {0, 4});
  if (v.size() / 4 > most)
    fail("E-PACK-SIZE", file.path + ":" + name,
         std::to_string(v.size() / 4) + " spheres; at most " + std::to_string(most));
  std::vector<Sphere> spheres;
  for (std::size_t i = 0; i < v.size(); i += 4) {
    if (!(v[i + 3] > 0))
      fail("E-PACK-VALUE", file.path + ":" + name + "[" + std::to_string(i / 4) + "]", "radii are above 0");
    spheres.push_back({Vec3(v[i], v[i + 1], v[i + 2]), v[i + 3]});
  }
  return spheres;
}

HandModel read_hand(const File& file) {
  HandModel hand;
  for (const Sphere& s : read_spheres(file, "hand/palm_spheres_m", kPalmLimit))
    hand.palm.push_back({s.center, s.radius});
  const auto joint = read_numbers(file, "hand/joint_m", {5, 3, 3});
  const auto axis = read_numbers(file, "hand/flexion_axis", {5, 3, 3});
  const auto abduction = read_numbers(file, "hand/abduction_axis", {5, 3});
  const auto phalanx = read_numbers(file, "hand/phalanx_m", {5, 3, 2, 3});
  const auto radius = read_numbers(file, "hand/phalanx_radius_m", {5, 3, 2});
  const auto flexion_limit = read_numbers(file, "hand/flexion_limit_rad", {5, 3, 2});
  const auto abduction_limit = read_numbers(file, "hand/abduction_limit_rad", {5, 2});
  const auto stiffness = read_numbers(file, "hand/joint_stiffness_n_m_per_rad", {5, 3});
  hand.palm_stiffness = read_numbers(file, "hand/palm_stiffness_n_per_m", {1})[0];
  hand.palm_rotation_stiffness = read_numbers(file, "hand/palm_rotation_stiffness_n_m_per_rad", {1})[0];
  const auto vec = [](const std::vector<double>& v, int i) { return Vec3(v[3 * i], v[3 * i + 1], v[3 * i + 2]); };
  const auto unit = [&](const Vec3& v, const char* name) {
    if (std::abs(v.norm() - 1.0) > 1e-6) fail("E-PACK-VALUE", file.path + ":" + name, "axes have length 1");
    return v.normalized();
  };
  const auto check_limit = [&](const std::array<double, 2>& limit, const char* name) {
    if (!(limit[0] <= limit[1])) fail("E-PACK-VALUE", file.path + ":" + name, "the lower limit is above the upper");
    return limit;
  };
  for (int f = 0; f < kFingers; ++f) {
    Finger& finger = hand.finger[f];
    finger.abduction_axis = unit(vec(abduction, f), "hand/abduction_axis");
    finger.abduction_limit =
        check_limit({abduction_limit[2 * f], abduction_limit[2 * f + 1]}, "hand/abduction_limit_rad");
    for (int j = 0; j < kPhalanges; ++j) {
      const int i = 3 * f + j;
      finger.joint[j] = vec(joint, i);
      finger.flexion_axis[j] = unit(vec(axis, i), "hand/flexion_axis");
      const Vec3 d = vec(phalanx, 2 * i), e = vec(phalanx, 2 * i + 1);
      const double r1 = radius[2 * i], r2 = radius[2 * i + 1];
      if (!(r1 > 0 && r2 > 0 && (e - d).norm() > 0))
        fail("E-PACK-VALUE", file.path + ":hand/phalanx_m", "radii and lengths are above 0");
      finger.phalanx[j] = capsule_of_frustum(d, e, r1, r2);
      if (!(finger.phalanx[j].r1 <= kLargest && finger.phalanx[j].r2 <= kLargest))
        fail("E-PACK-VALUE", file.path + ":hand/phalanx_radius_m", "a radius changes too much over its length");
      finger.flexion_limit[j] = check_limit({flexion_limit[2 * i], flexion_limit[2 * i + 1]}, "hand/flexion_limit_rad");
      finger.stiffness[j] = stiffness[i];
      if (!(stiffness[i] > 0))
        fail("E-PACK-VALUE", file.path + ":hand/joint_stiffness_n_m_per_rad", "stiffness is above 0");
    }
  }
  if (!(hand.palm_stiffness > 0 && hand.palm_rotation_stiffness > 0))
    fail("E-PACK-VALUE", file.path + ":hand/palm_stiffness_n_per_m", "stiffness is above 0");
  hand.finish();
  return hand;
}

}  // namespace

AssetPack read_pack(const std::string& path) { return pack_of(read_bytes(path), path); }

AssetPack pack_of(std::vector<unsigned char> bytes, const std::string& path) {
  const File file = open_file(std::move(bytes), path);
  AssetPack pack;
  pack.hand = read_hand(file);
  const auto text = [](const Json& from, const char* key) {
    return from.is_object() && from.contains(key) && from[key].is_string() ? from[key].get<std::string>()
                                                                           : std::string();
  };
  if (file.manifest.contains("hand")) {
    pack.hand_name = text(file.manifest["hand"], "name");
    pack.side = text(file.manifest["hand"], "side");
  }
  if (!file.manifest.contains("objects") || !file.manifest["objects"].is_object())
    fail("E-PACK-FORMAT", path, "the manifest lists no objects");
  for (const auto& [name, about] : file.manifest["objects"].items()) {
    if (!about.is_object() || !about.contains("levels") || !about["levels"].is_array() || about["levels"].empty())
      fail("E-PACK-FORMAT", path + ":" + name, "the manifest names no levels of this object");
    PackObject object;
    for (std::size_t k = 0; k < about["levels"].size(); ++k)
      object.levels.push_back(
          read_spheres(file, "object/" + name + "/level_" + std::to_string(k) + "/spheres_m", kSphereLimit));
    pack.objects.emplace(name, std::move(object));
  }
  return pack;
}

std::string find_object(const AssetPack& pack, const std::string& path, const std::string& object) {
  std::string names;
  for (const auto& [name, tree] : pack.objects) names += (names.empty() ? "" : ", ") + name;
  if (object.empty()) {
    if (pack.objects.size() == 1) return pack.objects.begin()->first;
    fail("E-PACK-OBJECT", path, "holds several objects, name one of: " + names);
  }
  if (!pack.objects.contains(object)) fail("E-PACK-OBJECT", path, "no object '" + object + "'; it holds: " + names);
  return object;
}

const std::vector<Sphere>& find_level(const AssetPack& pack, const std::string& path, const std::string& object,
                                      int level) {
  const std::string name = find_object(pack, path, object);
  const PackObject& tree = pack.objects.at(name);
  const int count = int(tree.levels.size());
  if (level < -1 || level >= count)
    fail("E-PACK-LEVEL", path,
         "level " + std::to_string(level) + " asked, but '" + name + "' has levels 0 to " + std::to_string(count - 1) +
             " (-1 for the leaves)");
  return tree.levels[level < 0 ? count - 1 : level];
}

}  // namespace palmar
