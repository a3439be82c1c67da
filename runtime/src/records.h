// What a trace and a run hold, as plain values. SI units; quaternions w x y z; fingers thumb to little, joints
// outwards.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace palmar {

struct Placement {
  std::array<double, 3> position_m{0, 0, 0};
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};
};

struct HandPose {
  Placement palm;
  std::array<double, 15> flexion_rad{};
  std::array<double, 5> abduction_rad{};
};

struct Sample {
  double time_s = 0;
  bool tracked = true;
  double held_s = 0;  // not in files. Where tracking is lost: how long the pose before had already been held
  HandPose pose;
  bool has_object_pose = false;
  Placement object;
};

// Bits of StepResult::status; the same table stands in palmar.records.
enum Status : std::uint32_t {
  kOk = 0,
  kRecovering = 1,
  kIterationLimit = 2,
  kYielded = 4,
  kKeptPrevious = 8,
  kBadSample = 16,
  kLimit = 32,
  kReleasing = 64,
  kContactsCut = 128,
};

struct Contact {
  std::uint8_t link = 0;  // 0 palm, 1 + 3 finger + phalanx
  std::uint32_t object_sphere = 0;
  std::uint32_t palm_sphere = UINT32_MAX;
  double gap_m = 0;
  double force_n = 0;
  std::array<double, 3> point_m{};  // world, on the hand's surface
  std::array<double, 3> normal{};   // world, from the object to the hand
};

struct Timing {
  double cpu_us = 0, wall_us = 0, search_us = 0, solve_us = 0, verify_us = 0;
};

struct StepResult {
  double time_s = 0;
  std::uint32_t status = kOk;
  HandPose graphic;
  HandPose haptic;
  Placement object;
  std::array<double, 3> palm_force_n{};
  std::array<double, 3> palm_torque_n_m{};
  std::array<double, 15> joint_torque_n_m{};
  std::array<double, 15> fingertip_force_n{};
  std::array<double, 15> equation14_force_n{};
  std::uint32_t contacts = 0;
  std::uint32_t operations = 0;
  std::uint64_t state_hash = 0;
};

using Header = std::map<std::string, std::string>;

// What a damaged file had lost. All zero for a sound file.
struct Loss {
  std::uint64_t bytes = 0, chunks = 0, messages = 0;
  bool unclosed = false;  // the writer did not end the file
};

struct DeviceBytes {
  double time_s = 0;
  std::vector<std::uint8_t> bytes;
};

// Shares of the device's full scale; NaN for what it does not send.
struct DeviceReading {
  double time_s = 0;
  std::array<double, 15> flexion{};
  std::array<double, 5> abduction{};
  std::array<double, 2> joystick{};
  double trigger = 0;
  std::uint32_t buttons = 0;
};

struct Trace {
  Header header;
  std::vector<Sample> samples;
  // What a recording keeps beside them: raw bytes of the device and of the source of palm poses, and what lines said.
  std::vector<DeviceBytes> device_bytes, pose_bytes;
  std::vector<DeviceReading> device_readings;
  Loss loss;
};

// Contacts of step i are contacts[contact_start[i]] to contacts[contact_start[i + 1]].
struct Run {
  Header header;
  std::vector<StepResult> steps;
  std::vector<Timing> timing;
  std::vector<std::uint64_t> contact_start{0};
  std::vector<Contact> contacts;
  Loss loss;
};

}  // namespace palmar
