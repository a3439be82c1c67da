// The Python face: a session, replay, and what the build is. Files are bound in python_files.cpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>

#include "error.h"
#include "pack_file.h"
#include "replay.h"
#include "session.h"
#include "settings.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace palmar {

void bind_errors(nb::module_& m);
void bind_files(nb::module_& m);
void bind_recording(nb::module_& m);
void bind_tools(nb::module_& m);

namespace {

using Numbers = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;

std::string to_json(nb::object value) {
  return nb::cast<std::string>(nb::module_::import_("json").attr("dumps")(value, "allow_nan"_a = false));
}

nb::object from_json(const std::string& text) { return nb::module_::import_("json").attr("loads")(text); }

template <std::size_t N>
void fill(std::array<double, N>& out, const Numbers& in, const char* name) {
  if (in.size() != N)
    throw Error("E-CONF-SHAPE", name, std::to_string(in.size()) + " numbers; " + std::to_string(N) + " are needed");
  std::copy_n(in.data(), N, out.begin());
}

nb::object array(const double* from, std::initializer_list<std::size_t> shape) {
  std::size_t size = 1;
  for (std::size_t n : shape) size *= n;
  double* own = new double[size];
  std::copy_n(from, size, own);
  nb::capsule owner(own, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  return nb::cast(nb::ndarray<nb::numpy, double>(own, shape.size(), shape.begin(), owner));
}

struct PySession {
  PySession(const std::string& pack_path, const std::string& object, nb::dict given)
      : session(open(pack_path, object, parse_settings(to_json(given)))) {}

  static Session open(const std::string& path, const std::string& object, const Settings& settings) {
    const AssetPack pack = read_pack(path);
    return Session(pack.hand, find_level(pack, path, object, settings.level), settings);
  }

  nb::dict step(double time_s, const Numbers& position, const Numbers& rotation, const Numbers& flexion,
                const Numbers& abduction, bool tracked, std::optional<Numbers> object_position,
                std::optional<Numbers> object_rotation) {
    Sample sample;
    sample.time_s = time_s;
    sample.tracked = tracked;
    fill(sample.pose.palm.position_m, position, "palm_position_m");
    fill(sample.pose.palm.rotation_wxyz, rotation, "palm_rotation_wxyz");
    fill(sample.pose.flexion_rad, flexion, "flexion_rad");
    fill(sample.pose.abduction_rad, abduction, "abduction_rad");
    if (object_position) fill(sample.object.position_m, *object_position, "object_position_m");
    if (object_rotation) fill(sample.object.rotation_wxyz, *object_rotation, "object_rotation_wxyz");
    sample.has_object_pose = object_position || object_rotation;
    const StepResult& r = session.step(sample);

    nb::dict out;
    out["time_s"] = r.time_s;
    out["status"] = r.status;
    out["palm_position_m"] = array(r.graphic.palm.position_m.data(), {3});
    out["palm_rotation_wxyz"] = array(r.graphic.palm.rotation_wxyz.data(), {4});
    out["flexion_rad"] = array(r.graphic.flexion_rad.data(), {5, 3});
    out["abduction_rad"] = array(r.graphic.abduction_rad.data(), {5});
    out["palm_force_n"] = array(r.palm_force_n.data(), {3});
    out["palm_torque_n_m"] = array(r.palm_torque_n_m.data(), {3});
    out["joint_torque_n_m"] = array(r.joint_torque_n_m.data(), {5, 3});
    out["fingertip_force_n"] = array(r.fingertip_force_n.data(), {5, 3});
    out["equation14_force_n"] = array(r.equation14_force_n.data(), {5, 3});
    out["operations"] = r.operations;
    out["state_hash"] = r.state_hash;
    nb::list contacts;
    for (const Contact& c : session.contacts()) {
      nb::dict row;
      row["link"] = c.link;
      row["object_sphere"] = c.object_sphere;
      if (c.palm_sphere == UINT32_MAX)
        row["palm_sphere"] = nb::none();
      else
        row["palm_sphere"] = c.palm_sphere;
      row["gap_m"] = c.gap_m;
      row["force_n"] = c.force_n;
      row["point_m"] = array(c.point_m.data(), {3});
      row["normal"] = array(c.normal.data(), {3});
      contacts.append(row);
    }
    out["contacts"] = contacts;
    return out;
  }

  Session session;
};

nb::dict py_replay(const std::string& pack, const std::string& trace, const std::string& out, const std::string& object,
                   nb::dict settings, const Header& header,
                   std::optional<std::function<bool(std::uint64_t, std::uint64_t)>> progress) {
  const Settings parsed = parse_settings(to_json(settings));
  ReplaySummary summary;
  {
    nb::gil_scoped_release release;
    Progress report;
    if (progress) {
      report = [&](std::uint64_t done, std::uint64_t total) {
        nb::gil_scoped_acquire acquire;
        if (PyErr_CheckSignals() != 0) throw nb::python_error();
        return (*progress)(done, total);
      };
    }
    summary = replay(pack, trace, out, object, parsed, header, report);
  }
  nb::dict by_status;
  for (const auto& [status, steps] : summary.steps_by_status) by_status[nb::int_(status)] = steps;
  nb::dict lost;
  lost["bytes"] = summary.loss.bytes;
  lost["chunks"] = summary.loss.chunks;
  lost["messages"] = summary.loss.messages;
  lost["unclosed"] = int(summary.loss.unclosed);
  nb::dict result;
  result["steps"] = summary.steps;
  result["steps_by_status"] = by_status;
  result["content_fnv1a64"] = summary.content_fnv1a64;
  result["lost"] = lost;
  result["stopped"] = summary.stopped;
  return result;
}

}  // namespace

}  // namespace palmar

NB_MODULE(_runtime, m) {
  using namespace palmar;
  bind_errors(m);
  bind_files(m);
  bind_recording(m);
  bind_tools(m);
  m.def("replay", &py_replay, "pack"_a, "trace"_a, "out"_a, "object"_a, "settings"_a, "header"_a,
        "progress"_a = nb::none());
  m.def("default_settings", [] { return from_json(settings_json(Settings{})); });
  m.def("solver_names", [] {
    std::vector<std::string> names;
    for (const SolverRow& row : SOLVERS) names.push_back(row.name);
    return names;
  });
  m.def("build_info", &build_info);
  nb::class_<PySession>(m, "Session")
      .def(nb::init<const std::string&, const std::string&, nb::dict>(), "pack"_a, "object"_a = "",
           "settings"_a = nb::dict())
      .def("step", &PySession::step, "time_s"_a, "palm_position_m"_a, "palm_rotation_wxyz"_a, "flexion_rad"_a,
           "abduction_rad"_a, "tracked"_a = true, "object_position_m"_a = nb::none(),
           "object_rotation_wxyz"_a = nb::none());
}
