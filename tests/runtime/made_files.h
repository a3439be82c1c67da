// Made traces and runs, and whether what comes back from a file is the same, bit for bit, or a part of it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <string>
#include <vector>

#include "error.h"
#include "run_file.h"
#include "trace_file.h"

namespace palmar {

using FileBytes = std::vector<std::uint8_t>;

inline FileBytes load(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

inline void store(const std::string& path, const FileBytes& bytes) {
  std::filesystem::remove(path);  // some file systems wait for the disk when a file is overwritten
  std::ofstream(path, std::ios::binary).write(reinterpret_cast<const char*>(bytes.data()), std::ssize(bytes));
}

// Values without a pattern that a shifted read could meet by luck.
inline double number(std::size_t i) { return std::sin(1.7 * static_cast<double>(i) + 0.3); }

inline HandPose make_pose(std::size_t index) {
  const std::size_t i = 100 * index;
  HandPose pose;
  pose.palm.position_m = {number(i), number(i + 1), number(i + 2)};
  const double half = number(i + 3);
  pose.palm.rotation_wxyz = {std::cos(half), 0, std::sin(half), 0};
  for (std::size_t k = 0; k < 15; ++k) pose.flexion_rad[k] = number(i + 4 + k);
  for (std::size_t k = 0; k < 5; ++k) pose.abduction_rad[k] = number(i + 19 + k);
  return pose;
}

inline Trace make_trace(std::size_t count, double interval_s) {
  Trace trace;
  trace.header = {{"schema", "palmar.trace/1"}, {"device", "test \xC3\xA9"}, {"hand", "a"}, {"side", "left"}};
  for (std::size_t i = 0; i < count; ++i) {
    Sample sample;
    sample.time_s = 0.5 + interval_s * static_cast<double>(i);
    sample.tracked = i % 3 != 1;
    sample.pose = make_pose(i);
    sample.has_object_pose = i % 2 == 0;
    if (sample.has_object_pose) sample.object = make_pose(i + 100).palm;
    trace.samples.push_back(sample);
  }
  return trace;
}

inline bool same(const Placement& a, const Placement& b) {
  return a.position_m == b.position_m && a.rotation_wxyz == b.rotation_wxyz;
}

inline bool same(const HandPose& a, const HandPose& b) {
  return same(a.palm, b.palm) && a.flexion_rad == b.flexion_rad && a.abduction_rad == b.abduction_rad;
}

inline bool same(const Sample& a, const Sample& b) {
  return a.time_s == b.time_s && a.tracked == b.tracked && same(a.pose, b.pose) &&
         a.has_object_pose == b.has_object_pose && same(a.object, b.object);
}

inline bool same(const StepResult& a, const StepResult& b) {
  return a.time_s == b.time_s && a.status == b.status && same(a.graphic, b.graphic) && same(a.haptic, b.haptic) &&
         same(a.object, b.object) && a.palm_force_n == b.palm_force_n && a.palm_torque_n_m == b.palm_torque_n_m &&
         a.joint_torque_n_m == b.joint_torque_n_m && a.fingertip_force_n == b.fingertip_force_n &&
         a.equation14_force_n == b.equation14_force_n && a.contacts == b.contacts && a.operations == b.operations &&
         a.state_hash == b.state_hash;
}

inline bool same(const Contact& a, const Contact& b) {
  return a.link == b.link && a.object_sphere == b.object_sphere && a.palm_sphere == b.palm_sphere &&
         a.gap_m == b.gap_m && a.force_n == b.force_n && a.point_m == b.point_m && a.normal == b.normal;
}

template <class T>
inline bool all_same(const std::vector<T>& a, const std::vector<T>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const T& x, const T& y) { return same(x, y); });
}

// True if `part` is `whole` with elements left out.
template <class T>
inline bool is_part(const std::vector<T>& part, const std::vector<T>& whole) {
  std::size_t at = 0;
  for (const T& element : part) {
    while (at < whole.size() && !same(whole[at], element)) ++at;
    if (at++ == whole.size()) return false;
  }
  return true;
}

inline bool sound(const Loss& loss) {
  return loss.bytes == 0 && loss.chunks == 0 && loss.messages == 0 && !loss.unclosed;
}

inline std::string code_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.code;
  }
  return "";
}

struct Steps {
  std::vector<StepResult> steps;
  std::vector<Timing> timing;
  std::vector<std::vector<Contact>> contacts;
};

inline Steps make_steps(std::size_t count, double interval_s) {
  Steps all;
  for (std::size_t i = 0; i < count; ++i) {
    StepResult step;
    step.time_s = interval_s * static_cast<double>(i);
    step.status = static_cast<std::uint32_t>(i % 64);
    step.graphic = make_pose(i);
    step.haptic = make_pose(i + 50);
    step.object = make_pose(i + 60).palm;
    step.palm_force_n = {number(i), -0.0, 1e-310};
    step.joint_torque_n_m = make_pose(i + 70).flexion_rad;
    step.fingertip_force_n = make_pose(i + 71).flexion_rad;
    step.equation14_force_n = make_pose(i + 72).flexion_rad;
    step.operations = 0xFFFFFFFFu - static_cast<std::uint32_t>(i);
    step.state_hash = 0xFEDCBA9876543210u + i;
    std::vector<Contact> contacts(i % 4);
    for (std::size_t k = 0; k < contacts.size(); ++k)
      contacts[k] = {static_cast<std::uint8_t>(k),
                     static_cast<std::uint32_t>(1000 * i + k),
                     UINT32_MAX,
                     -number(k),
                     number(i + k),
                     {number(k), number(i), 3.0},
                     {0.0, 1.0, number(k + 1)}};
    step.contacts = static_cast<std::uint32_t>(contacts.size());
    all.steps.push_back(step);
    all.timing.push_back({number(i), number(i + 1), number(i + 2), number(i + 3), number(i + 4)});
    all.contacts.push_back(contacts);
  }
  return all;
}

inline std::string write_run(const std::string& path, const Steps& all) {
  RunWriter writer(path, {{"solver", "none"}});
  for (std::size_t i = 0; i < all.steps.size(); ++i) writer.add(all.steps[i], all.timing[i], all.contacts[i]);
  return writer.close();
}

// Every step of a damaged run must still have its own contacts and times.
inline bool complete_steps(const Run& run, const Steps& all) {
  if (!is_part(run.steps, all.steps) || run.contact_start.size() != run.steps.size() + 1) return false;
  for (std::size_t i = 0; i < run.steps.size(); ++i) {
    const std::size_t original = run.steps[i].operations ^ 0xFFFFFFFFu;
    const std::vector<Contact> contacts(run.contacts.begin() + std::ptrdiff_t(run.contact_start[i]),
                                        run.contacts.begin() + std::ptrdiff_t(run.contact_start[i + 1]));
    if (!all_same(contacts, all.contacts[original])) return false;
    if (run.timing[i].verify_us != all.timing[original].verify_us) return false;
  }
  return true;
}

}  // namespace palmar
