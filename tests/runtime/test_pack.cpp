// Each way in which a pack can be wrong is refused with the code, the place and the value that are its own; what is
// right comes back as it was written.
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <limits>

#include "check.h"
#include "error.h"
#include "made_pack.h"
#include "pack_file.h"

using namespace palmar;
using made::PackChange;
using Json = nlohmann::json;

namespace {

AssetPack pack_from(const std::string& bytes) { return pack_of({bytes.begin(), bytes.end()}, "p"); }

// What is said of a pack, or "" if it is taken. `p` is its path.
std::string said_of(const std::string& bytes) {
  try {
    pack_from(bytes);
    return "";
  } catch (const Error& error) {
    return error.what();
  }
}

std::string said_of(const PackChange& change) { return said_of(made::pack_bytes(change)); }

std::string with_header(const std::string& header) {
  const std::uint64_t size = header.size();
  return std::string(reinterpret_cast<const char*>(&size), 8) + header;
}

void a_sound_pack_comes_back() {
  const AssetPack pack = pack_from(made::pack_bytes({.manifest = {{"hand", {{"name", "h"}, {"side", "left"}}}}}));
  CHECK(pack.hand_name == "h" && pack.side == "left");
  CHECK(pack.hand.palm.size() == 1 && pack.hand.palm[0].radius == 0.01);
  CHECK(pack.hand.palm_stiffness == 500 && pack.hand.palm_rotation_stiffness == 2);
  for (const Finger& finger : pack.hand.finger) {
    CHECK(finger.abduction_axis == Vec3(0, 0, 1) && finger.abduction_limit == (std::array{-0.3, 0.3}));
    for (int j = 0; j < kPhalanges; ++j) {
      CHECK(finger.joint[j] == Vec3(0, 0.03, 0) && finger.flexion_axis[j] == Vec3(1, 0, 0));
      CHECK(finger.phalanx[j].c1 == Vec3(0, 0.03, 0) && finger.phalanx[j].c2 == Vec3(0, 0.06, 0));
      CHECK(finger.phalanx[j].r1 == 0.008 && finger.flexion_limit[j] == (std::array{0.0, 1.5}));
    }
  }
  const Sphere& ball = find_level(pack, "p", "", -1).front();
  CHECK(ball.center == Vec3(0, 0, 0) && ball.radius == 0.02);
  // Names that are no text are none.
  CHECK(pack_from(made::pack_bytes({.manifest = {{"hand", {{"name", 3}}}}})).hand_name.empty());
  CHECK(pack_from(made::pack_bytes({.manifest = {{"hand", 3}}})).side.empty());
}

void what_is_no_safetensors_file_is_refused() {
  const std::string sound = made::pack_bytes(), format = "E-PACK-FORMAT p: ";
  std::string longer = sound;
  longer[6] = 1;
  for (const std::string& bytes : {std::string(), sound.substr(0, 7), longer, sound.substr(0, 100)})
    CHECK(said_of(bytes) == format + "not a whole safetensors file: its header is longer than the file");
  for (const char* header : {"", "{", "[]", "3", "\"{}\"", "\xFF"})
    CHECK(said_of(with_header(header)) == format + "its header is not a JSON object");
  const std::string none = format + "no manifest under the metadata key `palmar`";
  CHECK(said_of(with_header("{}")) == none);
  for (const char* metadata : {"null", "{}", R"({"palmar": 3})", R"({"palmar": "["})", R"({"palmar": "[]"})"})
    CHECK(said_of(with_header(std::string(R"({"__metadata__": )") + metadata + "}")) == none);
}

void an_entry_that_is_none_is_refused() {
  const std::string name = "hand/joint_m", at = "E-PACK-FORMAT p:hand/joint_m: ";
  const auto said = [&](const Json& patch) { return said_of(PackChange{.entries = {{name, patch}}}); };
  for (const Json& patch : std::vector<Json>{3,
                                             {{"dtype", nullptr}},
                                             {{"dtype", 3}},
                                             {{"shape", nullptr}},
                                             {{"shape", 45}},
                                             {{"data_offsets", nullptr}},
                                             {{"data_offsets", 3}},
                                             {{"data_offsets", {0}}},
                                             {{"data_offsets", {0, 8, 16}}}})
    CHECK(said(patch) == at + "not a tensor entry");
  for (const Json& shape : std::vector<Json>{{-1}, {1.5}, {"5"}, {std::uint64_t(1) << 40}})
    CHECK(said({{"shape", shape}}) == at + "its shape is not a list of sizes");
  CHECK(said({{"shape", {1 << 29, 2}}}) == at + "its shape is larger than any file");
  for (const Json& offsets : std::vector<Json>{{-8, 352}, {0, "360"}, {0.5, 360}})
    CHECK(said({{"data_offsets", offsets}}) == at + "its offsets are not numbers");
  for (const Json& offsets : std::vector<Json>{{360, 0}, {0, std::uint64_t(1) << 40}, {0, 352}, {8, 376}})
    CHECK(said({{"data_offsets", offsets}}) == at + "its bytes lie outside the file or do not fit its shape");
  CHECK(said({{"dtype", "F32"}}) == "E-PACK-SHAPE p:hand/joint_m: F32; F64 or I32 is needed");
  // Two tensors of the same bytes: in the order of their names, the one that finds none left is named.
  const Json twice = {{"dtype", "F64"}, {"shape", {45}}, {"data_offsets", {32, 392}}};
  const std::string taken = said_of(PackChange{.entries = {{"another", twice}}});
  CHECK(taken == "E-PACK-FORMAT p:hand/phalanx_m: its bytes are another tensor's");
}

void a_tensor_that_does_not_fit_is_refused() {
  const auto said = [](const std::string& name, const Json& entry) {
    return said_of(PackChange{.entries = {{name, entry}}});
  };
  CHECK(said("hand/flexion_axis", nullptr) == "E-PACK-MISSING p:hand/flexion_axis: tensor is not in the file");
  CHECK(said("hand/joint_m", {{"shape", {5, 9}}}) ==
        "E-PACK-SHAPE p:hand/joint_m: F64 (5, 9); F64 (5, 3, 3) is needed");
  CHECK(said("hand/joint_m", {{"shape", {3, 5, 3}}}) ==
        "E-PACK-SHAPE p:hand/joint_m: F64 (3, 5, 3); F64 (5, 3, 3) is needed");
  CHECK(said("hand/palm_stiffness_n_per_m", {{"dtype", "I32"}, {"shape", {2}}}) ==
        "E-PACK-SHAPE p:hand/palm_stiffness_n_per_m: I32 (2); F64 (1) is needed");
  CHECK(said("hand/palm_spheres_m", {{"shape", {0, 4}}, {"data_offsets", {0, 0}}}) ==
        "E-PACK-SHAPE p:hand/palm_spheres_m: F64 (0, 4); F64 (any, 4) is needed");
  CHECK(said_of(PackChange{.shapes = {{"hand/palm_spheres_m", {100'001, 4}}}}) ==
        "E-PACK-SIZE p:hand/palm_spheres_m: 100001 spheres; at most 100000");
}

void numbers_that_make_no_hand_are_refused() {
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  const auto said = [](const std::string& name, std::vector<double> numbers) {
    return said_of(PackChange{.numbers = {{name, std::move(numbers)}}});
  };
  for (const double wrong : {nan, infinity, -infinity, 1.0001e6, -1e300})
    CHECK(said("hand/joint_m", {0, 0, 0, 0, wrong}) ==
          "E-PACK-VALUE p:hand/joint_m[4]: not a finite number, or above 1e6 in size");
  CHECK(said("hand/joint_m", {1e6}).empty());
  CHECK(said("hand/palm_spheres_m", {0, 0, 0, 0}) == "E-PACK-VALUE p:hand/palm_spheres_m[0]: radii are above 0");
  CHECK(said("object/ball/level_0/spheres_m", {0, 0, 0, -1}) ==
        "E-PACK-VALUE p:object/ball/level_0/spheres_m[0]: radii are above 0");
  for (const char* axis : {"hand/flexion_axis", "hand/abduction_axis"}) {
    CHECK(said(axis, {1.00001, 0, 0}) == "E-PACK-VALUE p:" + std::string(axis) + ": axes have length 1");
    CHECK(said(axis, {0}) == "E-PACK-VALUE p:" + std::string(axis) + ": axes have length 1");
  }
  for (const char* limit : {"hand/flexion_limit_rad", "hand/abduction_limit_rad"}) {
    CHECK(said(limit, {0.1, 0}) == "E-PACK-VALUE p:" + std::string(limit) + ": the lower limit is above the upper");
    CHECK(said(limit, {0.1, 0.1}).empty());
  }
  const std::string lengths = "E-PACK-VALUE p:hand/phalanx_m: radii and lengths are above 0";
  CHECK(said("hand/phalanx_radius_m", {0.008, 0}) == lengths);
  CHECK(said("hand/phalanx_radius_m", {-0.008, 0.008}) == lengths);
  CHECK(said("hand/phalanx_m", {0, 0.03, 0}) == lengths);
  // The least cone that holds such a frustum is larger than any hand.
  PackChange steep;
  steep.numbers = {{"hand/phalanx_m", {0, 0, 0, 0, 1e-12, 0}}, {"hand/phalanx_radius_m", {0.008, 0.016}}};
  CHECK(said_of(steep) == "E-PACK-VALUE p:hand/phalanx_radius_m: a radius changes too much over its length");
  for (const double stiffness : {0.0, -1.0}) {
    CHECK(said("hand/joint_stiffness_n_m_per_rad", {1, stiffness}) ==
          "E-PACK-VALUE p:hand/joint_stiffness_n_m_per_rad: stiffness is above 0");
    for (const char* palm : {"hand/palm_stiffness_n_per_m", "hand/palm_rotation_stiffness_n_m_per_rad"})
      CHECK(said(palm, {stiffness}) == "E-PACK-VALUE p:hand/palm_stiffness_n_per_m: stiffness is above 0");
  }
}

void a_manifest_that_says_something_else_is_refused() {
  const auto said = [](const Json& patch) { return said_of(PackChange{.manifest = patch}); };
  const std::string reads = "this version reads 'palmar.pack/2'";
  CHECK(said({{"schema", nullptr}}) == "E-PACK-VERSION p: schema ''; " + reads);
  CHECK(said({{"schema", 2}}) == "E-PACK-VERSION p: schema ''; " + reads);
  CHECK(said({{"schema", "palmar.pack/3"}}) == "E-PACK-VERSION p: schema 'palmar.pack/3'; " + reads);
  for (const Json& objects : std::vector<Json>{nullptr, 3, "ball"})
    CHECK(said({{"objects", objects}}) == "E-PACK-FORMAT p: the manifest lists no objects");
  for (const Json& ball : std::vector<Json>{3, {{"levels", nullptr}}, {{"levels", 1}}, {{"levels", Json::array()}}})
    CHECK(said({{"objects", {{"ball", ball}}}}) == "E-PACK-FORMAT p:ball: the manifest names no levels of this object");
  CHECK(said({{"objects", {{"ball", {{"levels", {1, 2}}}}}}}) ==
        "E-PACK-MISSING p:object/ball/level_1/spheres_m: tensor is not in the file");
  CHECK(said({{"objects", {{"a\nb", {{"levels", {1}}}}}}}).starts_with("E-PACK-MISSING p:object/a\\x0ab/level_0"));
}

// Tools of others may leave the checksum away; one that stands there holds.
void a_checksum_that_stands_there_holds() {
  std::string bytes = made::pack_bytes({.manifest = {{"crc32", "00000000"}}});
  const std::string mark = R"(\"crc32\":\"00000000)";
  const std::size_t at = bytes.find(mark);
  CHECK(at != std::string::npos);
  CHECK(said_of(bytes).empty());  // not in the form in which packs are written, so no checksum of this file
  bytes.replace(at, mark.size(), R"(\"crc32\": \"0000000)");
  const std::string damaged = "E-PACK-CRC p: the file is damaged: its bytes do not fit their checksum";
  CHECK(said_of(bytes) == damaged);
}

void an_object_or_a_level_that_is_not_there_is_named() {
  AssetPack pack = pack_from(made::pack_bytes());
  const auto said = [&](const char* object, int level) -> std::string {
    try {
      find_level(pack, "p", object, level);
      return "";
    } catch (const Error& error) {
      return error.what();
    }
  };
  const std::string levels = " asked, but 'ball' has levels 0 to 0 (-1 for the leaves)";
  CHECK(said("", 0).empty() && said("ball", -1).empty());
  CHECK(said("ball", 1) == "E-PACK-LEVEL p: level 1" + levels);
  CHECK(said("ball", -2) == "E-PACK-LEVEL p: level -2" + levels);
  CHECK(said("cup", 0) == "E-PACK-OBJECT p: no object 'cup'; it holds: ball");
  pack.objects["cup"] = pack.objects["ball"];
  CHECK(said("", 0) == "E-PACK-OBJECT p: holds several objects, name one of: ball, cup");
  CHECK(said("can", 0) == "E-PACK-OBJECT p: no object 'can'; it holds: ball, cup");
}

// What is no file is not waited for.
void what_is_no_file_is_refused() {
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("palmar_test_pack_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const std::string pipe = (folder / "pipe").string(), file = (folder / "file").string();
  CHECK(mkfifo(pipe.c_str(), 0600) == 0);
  for (const std::string& path : {folder.string(), pipe, (folder / "none").string(), std::string()}) {
    std::string said;
    try {
      read_pack(path);
    } catch (const Error& error) {
      said = error.what();
    }
    CHECK(said == "E-PACK-MISSING " + path + ": cannot be read; a file written by `palmar build` is needed");
  }
  const std::string bytes = made::pack_bytes();
  std::ofstream(file, std::ios::binary).write(bytes.data(), std::ssize(bytes));
  CHECK(read_pack(file).objects.contains("ball"));
  std::filesystem::resize_file(file, (512ull << 20) + 1);  // a hole: it takes no room
  try {
    read_pack(file);
    CHECK(false);
  } catch (const Error& error) {
    CHECK(error.code == "E-PACK-SIZE" && error.message == "536870913 bytes; at most 536870912");
  }
  std::filesystem::remove_all(folder);
}

}  // namespace

int main() {
  a_sound_pack_comes_back();
  what_is_no_safetensors_file_is_refused();
  an_entry_that_is_none_is_refused();
  a_tensor_that_does_not_fit_is_refused();
  numbers_that_make_no_hand_are_refused();
  a_manifest_that_says_something_else_is_refused();
  a_checksum_that_stands_there_holds();
  an_object_or_a_level_that_is_not_there_is_named();
  what_is_no_file_is_refused();
  return finish();
}
