// The Python face of a recording in progress, and of the raw bytes in a trace.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "device_recording.h"
#include "trace_file.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace palmar {

void bind_recording(nb::module_& m);

namespace {

DeviceBytes given_bytes(double time_s, const nb::bytes& content) {
  const auto* from = static_cast<const std::uint8_t*>(content.data());
  return {time_s, {from, from + content.size()}};
}

}  // namespace

void bind_recording(nb::module_& m) {
  nb::class_<DeviceRecording>(m, "DeviceRecording")
      .def(nb::init<const std::string&, Header>(), "path"_a, "header"_a)
      .def(
          "add_sample",
          [](DeviceRecording& to, double time_s, bool tracked, const std::array<double, 3>& position,
             const std::array<double, 4>& rotation, const std::array<double, 15>& flexion,
             const std::array<double, 5>& abduction) {
            Sample sample;
            sample.time_s = time_s;
            sample.tracked = tracked;
            sample.pose = {{position, rotation}, flexion, abduction};
            to.add(sample);
          },
          "time_s"_a, "tracked"_a, "palm_position_m"_a, "palm_rotation_wxyz"_a, "flexion_rad"_a, "abduction_rad"_a)
      .def(
          "add_reading",
          [](DeviceRecording& to, double time_s, const std::array<double, 15>& flexion,
             const std::array<double, 5>& abduction, const std::array<double, 2>& joystick, double trigger,
             std::uint32_t buttons) { to.add(DeviceReading{time_s, flexion, abduction, joystick, trigger, buttons}); },
          "time_s"_a, "flexion"_a, "abduction"_a, "joystick"_a, "trigger"_a, "buttons"_a)
      .def(
          "add_device_bytes",
          [](DeviceRecording& to, double time_s, const nb::bytes& content) {
            to.add_device_bytes(given_bytes(time_s, content));
          },
          "time_s"_a, "content"_a)
      .def(
          "add_pose_bytes",
          [](DeviceRecording& to, double time_s, const nb::bytes& content) {
            to.add_pose_bytes(given_bytes(time_s, content));
          },
          "time_s"_a, "content"_a)
      .def(
          "close",
          [](DeviceRecording& to, const Header& end) {
            const nb::gil_scoped_release free;
            to.close(end);
          },
          "end"_a)
      .def_prop_ro("dropped", &DeviceRecording::dropped);
  m.def(
      "read_device_bytes",
      [](const std::string& path) {
        const Trace trace = [&] {
          const nb::gil_scoped_release free;
          return read_trace(path);
        }();
        nb::list chunks;
        for (const DeviceBytes& chunk : trace.device_bytes)
          chunks.append(nb::make_tuple(chunk.time_s, nb::bytes(chunk.bytes.data(), chunk.bytes.size())));
        return nb::make_tuple(trace.header, chunks);
      },
      "path"_a);
}

}  // namespace palmar
