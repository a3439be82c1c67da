// The Python face of traces and runs: columns of numpy arrays, and palmar::Error as the classes of palmar.errors.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/string.h>

#include <algorithm>

#include "error.h"
#include "resample.h"
#include "run_file.h"
#include "trace_file.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace palmar {

void bind_errors(nb::module_& m);
void bind_files(nb::module_& m);

namespace {

const char* class_of(const std::string& code) {
  if (code.starts_with("E-MESH")) return "BadMesh";
  if (code.starts_with("E-PACK")) return "BadPack";
  if (code.starts_with("E-TRACE")) return "BadTrace";
  if (code.starts_with("E-GLOVE")) return "GloveError";
  return "PalmarError";
}

// One numpy array of `rows` rows and `shape` behind them; get(i) points to the numbers of row i, which lie together.
template <class T, class Get>
nb::object column(std::size_t rows, std::initializer_list<std::size_t> shape, Get get) {
  std::vector<std::size_t> sizes{rows};
  sizes.insert(sizes.end(), shape);
  std::size_t width = 1;
  for (const std::size_t n : shape) width *= n;
  T* values = new T[rows * width];
  const nb::capsule owner(values, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  for (std::size_t i = 0; i < rows; ++i) std::copy_n(get(i), width, values + i * width);
  return nb::cast(nb::ndarray<nb::numpy, T>(values, sizes.size(), sizes.data(), owner));
}

nb::dict lost(const Loss& loss) {
  nb::dict counts;
  counts["bytes"] = loss.bytes;
  counts["chunks"] = loss.chunks;
  counts["messages"] = loss.messages;
  counts["unclosed"] = loss.unclosed ? 1 : 0;
  return counts;
}

// The columns of an array of structs: one line a field.
template <class Row>
struct Columns {
  const std::vector<Row>& rows;
  nb::dict out;

  template <class Field>
  void add(const char* name, std::initializer_list<std::size_t> shape, Field field) {
    using T = std::remove_cvref_t<decltype(*field(rows[0]))>;
    out[name] = column<T>(rows.size(), shape, [&](std::size_t i) { return field(rows[i]); });
  }
  template <class Get>
  void add_hand(const std::string& prefix, Get hand) {
    add((prefix + "palm_position_m").c_str(), {3}, [&](const Row& r) { return hand(r).palm.position_m.data(); });
    add((prefix + "palm_rotation_wxyz").c_str(), {4}, [&](const Row& r) { return hand(r).palm.rotation_wxyz.data(); });
    add((prefix + "flexion_rad").c_str(), {5, 3}, [&](const Row& r) { return hand(r).flexion_rad.data(); });
    add((prefix + "abduction_rad").c_str(), {5}, [&](const Row& r) { return hand(r).abduction_rad.data(); });
  }
};

nb::dict sample_columns(const std::vector<Sample>& samples) {
  Columns<Sample> c{samples, {}};
  c.add("time_s", {}, [](const Sample& s) { return &s.time_s; });
  c.add_hand("", [](const Sample& s) -> const HandPose& { return s.pose; });
  c.add("tracked", {}, [](const Sample& s) { return &s.tracked; });
  c.add("has_object_pose", {}, [](const Sample& s) { return &s.has_object_pose; });
  c.add("object_position_m", {3}, [](const Sample& s) { return s.object.position_m.data(); });
  c.add("object_rotation_wxyz", {4}, [](const Sample& s) { return s.object.rotation_wxyz.data(); });
  return c.out;
}

nb::dict run_columns(const Run& run) {
  Columns<StepResult> c{run.steps, {}};
  c.add("time_s", {}, [](const StepResult& s) { return &s.time_s; });
  c.add("status", {}, [](const StepResult& s) { return &s.status; });
  c.add_hand("", [](const StepResult& s) -> const HandPose& { return s.graphic; });
  c.add_hand("haptic_", [](const StepResult& s) -> const HandPose& { return s.haptic; });
  c.add("object_position_m", {3}, [](const StepResult& s) { return s.object.position_m.data(); });
  c.add("object_rotation_wxyz", {4}, [](const StepResult& s) { return s.object.rotation_wxyz.data(); });
  c.add("palm_force_n", {3}, [](const StepResult& s) { return s.palm_force_n.data(); });
  c.add("palm_torque_n_m", {3}, [](const StepResult& s) { return s.palm_torque_n_m.data(); });
  c.add("joint_torque_n_m", {5, 3}, [](const StepResult& s) { return s.joint_torque_n_m.data(); });
  c.add("fingertip_force_n", {5, 3}, [](const StepResult& s) { return s.fingertip_force_n.data(); });
  c.add("equation14_force_n", {5, 3}, [](const StepResult& s) { return s.equation14_force_n.data(); });
  c.add("contacts", {}, [](const StepResult& s) { return &s.contacts; });
  c.add("operations", {}, [](const StepResult& s) { return &s.operations; });
  c.add("state_hash", {}, [](const StepResult& s) { return &s.state_hash; });

  Columns<Timing> t{run.timing, c.out};
  t.add("cpu_us", {}, [](const Timing& s) { return &s.cpu_us; });
  t.add("wall_us", {}, [](const Timing& s) { return &s.wall_us; });
  t.add("search_us", {}, [](const Timing& s) { return &s.search_us; });
  t.add("solve_us", {}, [](const Timing& s) { return &s.solve_us; });
  t.add("verify_us", {}, [](const Timing& s) { return &s.verify_us; });

  const std::vector<std::int64_t> starts(run.contact_start.begin(), run.contact_start.end());
  c.out["contact_start"] = column<std::int64_t>(starts.size(), {}, [&](std::size_t i) { return &starts[i]; });

  Columns<Contact> k{run.contacts, c.out};
  k.add("contact_link", {}, [](const Contact& s) { return &s.link; });
  k.add("contact_object_sphere", {}, [](const Contact& s) { return &s.object_sphere; });
  k.add("contact_palm_sphere", {}, [](const Contact& s) { return &s.palm_sphere; });
  k.add("contact_gap_m", {}, [](const Contact& s) { return &s.gap_m; });
  k.add("contact_force_n", {}, [](const Contact& s) { return &s.force_n; });
  k.add("contact_point_m", {3}, [](const Contact& s) { return s.point_m.data(); });
  k.add("contact_normal", {3}, [](const Contact& s) { return s.normal.data(); });
  return c.out;
}

// A column given from Python. Numbers of another type are converted as numpy does; the shape must fit.
template <class T>
nb::ndarray<nb::numpy, const T, nb::c_contig, nb::device::cpu> given(const nb::dict& columns, const char* name,
                                                                     std::size_t rows,
                                                                     std::initializer_list<std::size_t> shape) {
  const std::string where = std::string("columns.") + name;
  if (!columns.contains(name)) throw Error("E-TRACE-COLUMN", where, "is missing");
  const nb::object converted = nb::module_::import_("numpy").attr("ascontiguousarray")(
      columns[name], std::is_same_v<T, bool> ? "bool" : "float64");
  auto array = nb::cast<nb::ndarray<nb::numpy, const T, nb::c_contig, nb::device::cpu>>(converted);
  std::vector<std::size_t> sizes{rows};
  sizes.insert(sizes.end(), shape);
  bool fits = array.ndim() == sizes.size();
  for (std::size_t i = 0; fits && i < sizes.size(); ++i) fits = array.shape(i) == sizes[i];
  if (!fits) {
    std::string shape_text, needed;
    for (std::size_t i = 0; i < array.ndim(); ++i) shape_text += (i ? ", " : "") + std::to_string(array.shape(i));
    for (std::size_t i = 0; i < sizes.size(); ++i) needed += (i ? ", " : "") + std::to_string(sizes[i]);
    throw Error("E-TRACE-COLUMN", where, "shape (" + shape_text + "); (" + needed + ") is needed");
  }
  return array;
}

template <std::size_t n>
void copy_row(const double* from, std::size_t i, std::array<double, n>& to) {
  std::copy_n(from + i * n, n, to.begin());
}

std::vector<Sample> given_samples(const nb::dict& columns) {
  for (const auto& [key, value] : columns) {
    static constexpr const char* kKnown[] = {"time_s",          "palm_position_m",   "palm_rotation_wxyz",
                                             "flexion_rad",     "abduction_rad",     "tracked",
                                             "has_object_pose", "object_position_m", "object_rotation_wxyz"};
    const std::string name = nb::cast<std::string>(nb::str(key));
    if (std::find(std::begin(kKnown), std::end(kKnown), name) == std::end(kKnown))
      throw Error("E-TRACE-COLUMN", "columns." + name, "is not a column of a trace");
  }
  if (!columns.contains("time_s")) throw Error("E-TRACE-COLUMN", "columns.time_s", "is missing");
  const std::size_t n = nb::len(nb::object(columns["time_s"]));
  const auto time = given<double>(columns, "time_s", n, {});
  const auto position = given<double>(columns, "palm_position_m", n, {3});
  const auto rotation = given<double>(columns, "palm_rotation_wxyz", n, {4});
  const auto flexion = given<double>(columns, "flexion_rad", n, {5, 3});
  const auto abduction = given<double>(columns, "abduction_rad", n, {5});
  const auto tracked = given<bool>(columns, "tracked", n, {});
  std::vector<Sample> samples(n);
  for (std::size_t i = 0; i < n; ++i) {
    Sample& s = samples[i];
    s.time_s = time.data()[i];
    s.tracked = tracked.data()[i];
    copy_row(position.data(), i, s.pose.palm.position_m);
    copy_row(rotation.data(), i, s.pose.palm.rotation_wxyz);
    copy_row(flexion.data(), i, s.pose.flexion_rad);
    copy_row(abduction.data(), i, s.pose.abduction_rad);
  }
  const bool any_object = columns.contains("has_object_pose") || columns.contains("object_position_m") ||
                          columns.contains("object_rotation_wxyz");
  if (!any_object) return samples;
  const auto has_object = given<bool>(columns, "has_object_pose", n, {});
  const auto object_position = given<double>(columns, "object_position_m", n, {3});
  const auto object_rotation = given<double>(columns, "object_rotation_wxyz", n, {4});
  for (std::size_t i = 0; i < n; ++i) {
    samples[i].has_object_pose = has_object.data()[i];
    copy_row(object_position.data(), i, samples[i].object.position_m);
    copy_row(object_rotation.data(), i, samples[i].object.rotation_wxyz);
  }
  return samples;
}

template <class Call>
auto without_gil(Call call) {
  const nb::gil_scoped_release free;
  return call();
}

}  // namespace

void bind_errors(nb::module_&) {
  nb::register_exception_translator(
      [](const std::exception_ptr& thrown, void*) {
        try {
          std::rethrow_exception(thrown);
        } catch (const Error& error) {
          const nb::object type = nb::module_::import_("palmar.errors").attr(class_of(error.code));
          const nb::object value = type(error.code, error.where, error.message);
          PyErr_SetObject(type.ptr(), value.ptr());
        }
      },
      nullptr);
}

void bind_files(nb::module_& m) {
  m.def(
      "write_trace",
      [](const std::string& path, const Header& header, const nb::dict& columns) {
        Trace trace;
        trace.header = header;
        trace.samples = given_samples(columns);
        without_gil([&] { write_trace(path, trace); });
      },
      "path"_a, "header"_a, "columns"_a);
  m.def(
      "read_trace",
      [](const std::string& path) {
        const Trace trace = without_gil([&] { return read_trace(path); });
        return nb::make_tuple(trace.header, sample_columns(trace.samples), lost(trace.loss));
      },
      "path"_a);
  m.def(
      "recover_trace",
      [](const std::string& path, const std::string& out, const Header& spare) {
        const Trace trace = without_gil([&] {
          Trace found = salvage_trace(path, spare);
          write_trace(out, found);
          const Trace back = read_trace(out);
          const bool sound = !back.loss.bytes && !back.loss.chunks && !back.loss.messages && !back.loss.unclosed;
          if (!sound || !same_content(back, found))
            throw Error("E-TRACE-RECOVER", out, "what was written does not read back the same; nothing is kept");
          return found;
        });
        const std::map<std::string, std::size_t> kept{{"samples", trace.samples.size()},
                                                      {"device_readings", trace.device_readings.size()},
                                                      {"device_bytes", trace.device_bytes.size()},
                                                      {"pose_bytes", trace.pose_bytes.size()}};
        return nb::make_tuple(trace.header, trace.samples.back().time_s - trace.samples.front().time_s, kept,
                              lost(trace.loss));
      },
      "path"_a, "out"_a, "spare"_a);
  m.def(
      "read_run",
      [](const std::string& path) {
        const Run run = without_gil([&] { return read_run(path); });
        return nb::make_tuple(run.header, run_columns(run), lost(run.loss));
      },
      "path"_a);
  m.def(
      "resample",
      [](const Header& header, const nb::dict& columns, const std::string& method, double rate_hz) {
        Trace trace;
        trace.header = header;
        trace.samples = given_samples(columns);
        std::vector<Sample> samples;
        without_gil([&] {
          const Resampler resampler(trace, method, rate_hz);
          samples.reserve(resampler.size());
          for (std::size_t i = 0; i < resampler.size(); ++i) samples.push_back(resampler.at(i));
        });
        return sample_columns(samples);
      },
      "header"_a, "columns"_a, "method"_a, "rate_hz"_a);
}

}  // namespace palmar
