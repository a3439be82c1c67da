// A pack of the plainest hand and one ball, as another tool would write it, or one that is wrong in one place.
#pragma once

#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace palmar::made {

// What is another than in a sound pack: merge patches of the tensors' entries and of the manifest; numbers and shapes
// by tensor.
struct PackChange {
  nlohmann::json entries = nlohmann::json::object(), manifest = nlohmann::json::object();
  std::map<std::string, std::vector<double>> numbers = {};
  std::map<std::string, std::vector<std::size_t>> shapes = {};
};

inline std::string pack_bytes(const PackChange& change = {}) {
  nlohmann::json header;
  std::string data;
  const auto add = [&](const std::string& name, std::vector<std::size_t> shape, std::vector<double> pattern) {
    if (const auto other = change.numbers.find(name); other != change.numbers.end()) pattern = other->second;
    if (const auto other = change.shapes.find(name); other != change.shapes.end()) shape = other->second;
    std::size_t count = 1;
    for (const std::size_t n : shape) count *= n;
    const std::size_t start = data.size();
    for (std::size_t i = 0; i < count; ++i)
      data.append(reinterpret_cast<const char*>(&pattern[i % pattern.size()]), sizeof(double));
    header[name] = {{"dtype", "F64"}, {"shape", shape}, {"data_offsets", {start, data.size()}}};
  };
  add("hand/palm_spheres_m", {1, 4}, {0, 0, 0, 0.01});
  add("hand/joint_m", {5, 3, 3}, {0, 0.03, 0});
  add("hand/flexion_axis", {5, 3, 3}, {1, 0, 0});
  add("hand/abduction_axis", {5, 3}, {0, 0, 1});
  add("hand/phalanx_m", {5, 3, 2, 3}, {0, 0.03, 0, 0, 0.06, 0});
  add("hand/phalanx_radius_m", {5, 3, 2}, {0.008});
  add("hand/flexion_limit_rad", {5, 3, 2}, {0, 1.5});
  add("hand/abduction_limit_rad", {5, 2}, {-0.3, 0.3});
  add("hand/joint_stiffness_n_m_per_rad", {5, 3}, {1});
  add("hand/palm_stiffness_n_per_m", {1}, {500});
  add("hand/palm_rotation_stiffness_n_m_per_rad", {1}, {2});
  add("object/ball/level_0/spheres_m", {1, 4}, {0, 0, 0, 0.02});
  nlohmann::json manifest = {{"schema", "palmar.pack/2"}, {"objects", {{"ball", {{"levels", {{}}}}}}}};
  manifest.merge_patch(change.manifest);
  header["__metadata__"]["palmar"] = manifest.dump();
  header.merge_patch(change.entries);
  const std::string text = header.dump();
  const std::uint64_t size = text.size();
  return std::string(reinterpret_cast<const char*>(&size), 8) + text + data;
}

}  // namespace palmar::made
