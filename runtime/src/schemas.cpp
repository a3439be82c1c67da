#include "schemas.h"

namespace palmar {

const MessageType kSampleType{
    "/haptic_hand", "palmar_msgs/msg/Sample",
    R"(# One pose of the haptic hand, as the device reported it. SI units; quaternions w x y z, world from body.
float64 time_s
bool tracked                          # false: the device had lost the hand; the pose is not to be used
float64[3] palm_position_m
float64[4] palm_rotation_wxyz
float64[15] flexion_rad               # thumb MCP PIP DIP, index MCP PIP DIP, ... little
float64[5] abduction_rad              # thumb to little
bool has_object_pose
float64[3] object_position_m          # world from object; zero and identity if not has_object_pose
float64[4] object_rotation_wxyz
)"};

const MessageType kDeviceBytesType{"/device_bytes", "palmar_msgs/msg/DeviceBytes",
                                   R"(# What the device sent, before any decoding.
float64 time_s                        # of arrival
uint8[] bytes
)"};

const MessageType kPoseBytesType{"/pose_bytes", kDeviceBytesType.name, kDeviceBytesType.text};

const MessageType kDeviceReadingType{"/device_reading", "palmar_msgs/msg/DeviceReading",
                                     R"(# What the device said, decoded, as shares of its own full scale.
float64 time_s                        # of arrival
float64[15] flexion                   # thumb MCP PIP DIP, index ...; 0 open to 1 closed, NaN for a joint that is not sent
float64[5] abduction                  # -1 to 1, NaN if not sent
float64[2] joystick                   # -1 to 1
float64 trigger                       # 0 to 1
uint32 buttons                        # bits: 1 joystick, 2 trigger, 4 A, 8 B, 16 grab, 32 pinch, 64 menu, 128 calibrate
)"};

const MessageType kStepType{"/graphic_hand", "palmar_msgs/msg/Step",
                            R"(# One answer of the solver. SI units; quaternions w x y z, world from body.
float64 time_s
uint32 status                         # bits: 1 recovering, 2 iteration limit, 4 yielded, 8 kept previous, 16 bad sample, 32 limit
float64[3] palm_position_m            # graphic hand: what is shown
float64[4] palm_rotation_wxyz
float64[15] flexion_rad               # thumb MCP PIP DIP, index MCP PIP DIP, ... little
float64[5] abduction_rad              # thumb to little
float64[3] haptic_palm_position_m     # haptic hand: what was asked for
float64[4] haptic_palm_rotation_wxyz
float64[15] haptic_flexion_rad
float64[5] haptic_abduction_rad
float64[3] object_position_m          # world from object
float64[4] object_rotation_wxyz
float64[3] palm_force_n               # on the user, world axes
float64[3] palm_torque_n_m
float64[15] joint_torque_n_m
float64[15] fingertip_force_n         # 5 x 3, world axes: normal force at each fingertip
float64[15] equation14_force_n        # 5 x 3, world axes: sum over the contacts of each finger
uint32 contacts                       # contacts reported
uint32 operations                     # operation budget used
uint64 state_hash                     # of everything that the next step starts from
)"};

const MessageType kContactsType{
    "/contacts", "palmar_msgs/msg/Contacts",
    R"(# The contacts of the step with the same time, one element each; point and normal have three.
float64 time_s
uint8[] link                          # 0 palm, 1 + 3 finger + phalanx
uint32[] object_sphere                # leaf index
uint32[] palm_sphere                  # index of the palm sphere; 4294967295 for a phalanx
float64[] gap_m                       # negative: inside
float64[] force_n
float64[] point_m                     # world, on the hand's surface
float64[] normal                      # world, unit, from the object to the hand
)"};

const MessageType kTimingType{"/timing", "palmar_msgs/msg/Timing",
                              R"(# How long the step with the same time took, in microseconds.
float64 time_s
float64 cpu_us
float64 wall_us
float64 search_us
float64 solve_us
float64 verify_us
)"};

namespace {

// Words of a text without comments, each followed by one blank; a field ends with a line.
std::string bare(std::string_view text) {
  std::string words;
  bool comment = false;
  for (const char c : text) {
    if (c == '\n') comment = false;
    if (c == '#') comment = true;
    if (comment) continue;
    const bool blank = c == ' ' || c == '\t' || c == '\r' || c == '\n';
    if (!blank) words += c;
    if (blank && !words.empty() && words.back() != ' ') words += ' ';
  }
  if (!words.empty() && words.back() != ' ') words += ' ';
  return words;
}

}  // namespace

bool same_fields(std::string_view a, std::string_view b) { return bare(a) == bare(b); }

}  // namespace palmar
