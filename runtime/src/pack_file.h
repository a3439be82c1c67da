// Reading a pack: safetensors with a manifest (docs/formats.md).
#pragma once

#include <map>
#include <string>
#include <vector>

#include "hand.h"
#include "sphere_tree.h"

namespace palmar {

struct PackObject {
  std::vector<std::vector<Sphere>> levels;  // coarse to fine
};

struct AssetPack {
  HandModel hand;
  std::string hand_name, side;
  std::map<std::string, PackObject> objects;
};

// Throws Error (E-PACK-...) that names the file, the tensor, and what is allowed. Checks everything once, so that
// nothing need be checked in a step.
AssetPack read_pack(const std::string& path);
// The same of a file's bytes; `path` is for errors alone.
AssetPack pack_of(std::vector<unsigned char> bytes, const std::string& path);

// The named object's spheres at a level (-1 for the leaves; "" for the only object). Throws Error.
const std::vector<Sphere>& find_level(const AssetPack& pack, const std::string& path, const std::string& object,
                                      int level);
// The name that "" stands for. Throws Error if the pack has several objects, or none of that name.
std::string find_object(const AssetPack& pack, const std::string& path, const std::string& object);

}  // namespace palmar
