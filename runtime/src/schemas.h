// The messages of docs/formats.md: topic, name, `ros2msg` text, and the same fields for CDR. Text and fields must stay
// in step; the test that decodes our files with another library holds them together.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "records.h"

namespace palmar {

inline constexpr const char* kTraceSchema = "palmar.trace/1";
// Metadata records: what a trace says of itself, and what its recorder knew only at the end.
inline constexpr const char* kTraceHeaderName = "palmar.trace";
inline constexpr const char* kTraceEndName = "palmar.trace.end";
inline constexpr const char* kRunSchema = "palmar.run/1";

struct MessageType {
  const char* topic;
  const char* name;
  const char* text;
};

extern const MessageType kSampleType, kDeviceBytesType, kPoseBytesType, kDeviceReadingType;
extern const MessageType kStepType, kContactsType, kTimingType;

// True if two `ros2msg` texts have the same fields in the same order; comments and blanks do not count.
bool same_fields(std::string_view a, std::string_view b);

template <class Cdr, class Pose>
void hand_fields(Cdr& cdr, Pose& hand) {
  cdr(hand.palm.position_m);
  cdr(hand.palm.rotation_wxyz);
  cdr(hand.flexion_rad);
  cdr(hand.abduction_rad);
}

template <class Cdr, class Message>
void sample_fields(Cdr& cdr, Message& sample) {
  cdr(sample.time_s);
  cdr(sample.tracked);
  hand_fields(cdr, sample.pose);
  cdr(sample.has_object_pose);
  cdr(sample.object.position_m);
  cdr(sample.object.rotation_wxyz);
}

template <class Cdr, class Message>
void device_bytes_fields(Cdr& cdr, Message& device) {
  cdr(device.time_s);
  cdr(device.bytes);
}

template <class Cdr, class Message>
void device_reading_fields(Cdr& cdr, Message& reading) {
  cdr(reading.time_s);
  cdr(reading.flexion);
  cdr(reading.abduction);
  cdr(reading.joystick);
  cdr(reading.trigger);
  cdr(reading.buttons);
}

template <class Cdr, class Message>
void step_fields(Cdr& cdr, Message& step) {
  cdr(step.time_s);
  cdr(step.status);
  hand_fields(cdr, step.graphic);
  hand_fields(cdr, step.haptic);
  cdr(step.object.position_m);
  cdr(step.object.rotation_wxyz);
  cdr(step.palm_force_n);
  cdr(step.palm_torque_n_m);
  cdr(step.joint_torque_n_m);
  cdr(step.fingertip_force_n);
  cdr(step.equation14_force_n);
  cdr(step.contacts);
  cdr(step.operations);
  cdr(step.state_hash);
}

// The contacts of one step as columns, the form that they have in the file.
struct ContactColumns {
  double time_s = 0;
  std::vector<std::uint8_t> link;
  std::vector<std::uint32_t> object_sphere, palm_sphere;
  std::vector<double> gap_m, force_n, point_m, normal;
};

template <class Cdr, class Message>
void contacts_fields(Cdr& cdr, Message& contacts) {
  cdr(contacts.time_s);
  cdr(contacts.link);
  cdr(contacts.object_sphere);
  cdr(contacts.palm_sphere);
  cdr(contacts.gap_m);
  cdr(contacts.force_n);
  cdr(contacts.point_m);
  cdr(contacts.normal);
}

struct TimingMessage {
  double time_s = 0;
  Timing timing;
};

template <class Cdr, class Message>
void timing_fields(Cdr& cdr, Message& message) {
  cdr(message.time_s);
  cdr(message.timing.cpu_us);
  cdr(message.timing.wall_us);
  cdr(message.timing.search_us);
  cdr(message.timing.solve_us);
  cdr(message.timing.verify_us);
}

}  // namespace palmar
