// What a step costs: scripted motions over the same surfaces in 3,000 and 100,000 leaves, the product's solver beside
// the published method, in mixed order in one run. Microseconds of thread CPU time, the least of the replays of each
// step, over the steps in which the product's solver touches.
//
//   bench_step [--scene NAME] [--solvers a,b] [--counts 3000,100000] [--replays 3] [--set name=value]...
//   bench_step --spheres-csv FILE --trace-csv FILE ...   a sphere list (x,y,z,r) and a reference scenario instead
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "brute_force.h"
#include "error.h"
#include "machine.h"
#include "made_hand.h"
#include "made_objects.h"
#include "session.h"
#include "settings.h"

using namespace palmar;

namespace {

struct Script {
  std::string name, object;
  std::vector<Sample> samples;
};

void go(std::vector<Sample>& samples, Configuration& from, const Configuration& to, int steps) {
  const Change way = difference(to, from);
  for (int i = 1; i <= steps; ++i) {
    Sample s;
    s.time_s = 1e-3 * double(samples.size());
    // Starts and ends at rest: 3 x^2 - 2 x^3.
    const double x = double(i) / steps;
    s.pose = to_pose(advance(from, way, x * x * (3 - 2 * x)));
    samples.push_back(s);
  }
  from = to;
}

Configuration open_hand(double x, double y, double z, double curl) {
  Configuration q;
  q.position = Vec3(x, y, z);
  for (auto& finger : q.flexion) finger = {curl, curl, curl};
  return q;
}

// The palm over the top, 120 mm above it, comes down in 0.3 s, presses 3 mm; the fist closes to 80/90/60 degrees in 1 s
// and stays half a second.
std::vector<Sample> fist(double top) {
  std::vector<Sample> samples;
  Configuration q = open_hand(0, -0.05, top + 0.12, 0.05);
  Configuration down = open_hand(0, -0.05, top + 0.008, 0.05), closed = down;
  for (auto& finger : closed.flexion) finger = {1.40, 1.57, 1.05};
  go(samples, q, down, 300);
  go(samples, q, closed, 1000);
  go(samples, q, closed, 500);
  return samples;
}

// Half curled fingers pressed 8 mm in, and moved to and fro: 60 mm at 0.1 m/s, then across.
std::vector<Sample> slide(double top) {
  std::vector<Sample> samples;
  Configuration q = open_hand(-0.02, -0.07, top + 0.12, 0.35), down = open_hand(-0.02, -0.07, top + 0.02, 0.35);
  go(samples, q, down, 300);
  for (const auto& [x, y] : {std::pair{0.03, -0.07}, {-0.03, -0.07}, {0.0, -0.05}, {0.0, -0.09}})
    go(samples, q, open_hand(x, y, top + 0.02, 0.35), 500);
  return samples;
}

// The index comes down 30 mm between two ears and sweeps 18 mm to either side.
std::vector<Sample> between_ears() {
  std::vector<Sample> samples;
  const auto at = [](double x, double z) {
    Configuration q = open_hand(x - 0.028, -0.13, z, 1.6);
    q.flexion[0] = {0, 0, 0};
    q.flexion[1] = {0.2, 0.2, 0.1};
    return q;
  };
  Configuration q = at(0, 0.19);
  go(samples, q, at(0, 0.075), 300);
  go(samples, q, at(0, 0.045), 300);
  for (double x : {0.018, -0.018, 0.018, 0.0}) go(samples, q, at(x, 0.045), 350);
  return samples;
}

std::vector<Script> made_scenes() {
  return {{"fist", "ball", fist(0.045)},
          {"fist", "ears", fist(0.035)},
          {"slide", "cube", slide(0.04)},
          {"slide", "ears", slide(0.035)},
          {"ears", "ears", between_ears()}};
}

std::vector<std::vector<double>> read_csv(const std::string& path, std::size_t columns) {
  std::ifstream in(path);
  if (!in) throw Error("E-BENCH-FILE", path, "cannot be read");
  std::vector<std::vector<double>> rows;
  std::string line, cell;
  std::getline(in, line);
  while (std::getline(in, line)) {
    std::vector<double> row;
    for (std::stringstream cells(line); std::getline(cells, cell, ',');) row.push_back(std::atof(cell.c_str()));
    if (row.size() < columns) throw Error("E-BENCH-FILE", path, "a row of " + std::to_string(row.size()) + " numbers");
    rows.push_back(row);
  }
  return rows;
}

std::vector<Sphere> read_spheres(const std::string& path) {
  std::vector<Sphere> spheres;
  for (const auto& row : read_csv(path, 4)) spheres.push_back({Vec3(row[0], row[1], row[2]), row[3]});
  return spheres;
}

std::vector<Sample> read_scenario(const std::string& path) {
  std::vector<Sample> samples;
  for (const auto& row : read_csv(path, 23)) {
    Sample s;
    s.time_s = row[0];
    std::copy_n(&row[1], 3, s.pose.palm.position_m.begin());
    std::copy_n(&row[4], 4, s.pose.palm.rotation_wxyz.begin());
    std::copy_n(&row[8], 15, s.pose.flexion_rad.begin());
    samples.push_back(s);
  }
  return samples;
}

struct Runs {
  std::string solver;
  int leaves;
  std::vector<double> us;  // of each step, the least so far
  std::vector<double> contacts;
  std::vector<double> operations;
  double deepest_m = 0;
};

void replay(const HandModel& hand, const std::vector<Sphere>& leaves, Settings settings,
            const std::vector<Sample>& samples, const made::BruteForce* judge, Runs& runs) {
  settings.solver = runs.solver;
  Session session(hand, leaves, settings);
  const bool first = runs.us.empty();
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const double start = made::thread_us();
    const StepResult& r = session.step(samples[i]);
    const double us = made::thread_us() - start;
    if (first) {
      runs.us.push_back(us);
      runs.contacts.push_back(r.contacts);
      runs.operations.push_back(r.operations);
    } else {
      runs.us[i] = std::min(runs.us[i], us);
    }
    if (judge != nullptr && i % 20 == 0)
      runs.deepest_m = std::max(runs.deepest_m, -judge->deepest(hand, r.graphic).gap_m);
  }
}

struct Options {
  std::string scene, spheres_csv, trace_csv;
  std::vector<std::string> solvers = {"progressive", "paper"};
  std::vector<int> counts = {3000, 100000};
  int replays = 3;
  nlohmann::json settings = nlohmann::json::object();
};

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> parts;
  std::string part;
  for (std::stringstream in(text); std::getline(in, part, ',');) parts.push_back(part);
  return parts;
}

Options parse(int argc, char** argv) {
  Options o;
  for (int i = 1; i < argc; i += 2) {
    const std::string name = argv[i];
    if (i + 1 == argc) throw Error("E-ARG", name, "wants a value");
    const std::string value = argv[i + 1];
    const std::size_t is = value.find('=');
    if (name == "--scene") {
      o.scene = value;
    } else if (name == "--solvers") {
      o.solvers = split(value);
    } else if (name == "--counts") {
      o.counts.clear();
      for (const std::string& count : split(value)) o.counts.push_back(std::atoi(count.c_str()));
    } else if (name == "--replays") {
      o.replays = std::max(1, std::atoi(value.c_str()));
    } else if (name == "--spheres-csv") {
      o.spheres_csv = value;
    } else if (name == "--trace-csv") {
      o.trace_csv = value;
    } else if (name == "--set" && is != std::string::npos) {
      const nlohmann::json number = nlohmann::json::parse(value.substr(is + 1), nullptr, false);
      o.settings[value.substr(0, is)] = number.is_discarded() ? nlohmann::json(value.substr(is + 1)) : number;
    } else {
      throw Error("E-ARG", name, "is not an argument, or wants name=value");
    }
  }
  if (o.spheres_csv.empty() != o.trace_csv.empty()) throw Error("E-ARG", "--spheres-csv", "goes with --trace-csv");
  return o;
}

// One scene over models of one surface. All solvers and models take turns, replay by replay.
void bench(const Options& o, const HandModel& hand, const Settings& settings, const Script& scene,
           const std::vector<std::vector<Sphere>>& models) {
  std::vector<Runs> all;
  for (const auto& leaves : models)
    for (const std::string& solver : o.solvers) all.push_back({solver, int(leaves.size()), {}, {}, {}, 0});
  for (int k = 0; k < o.replays; ++k)
    for (std::size_t run = 0; run < all.size(); ++run)
      replay(hand, models[run / o.solvers.size()], settings, scene.samples, nullptr, all[run]);
  for (std::size_t run = 0; run < all.size(); ++run) {
    const made::BruteForce judge(models[run / o.solvers.size()]);
    replay(hand, models[run / o.solvers.size()], settings, scene.samples, &judge, all[run]);
  }

  // Quantiles over the steps in which the first solver touches.
  const std::size_t solvers = o.solvers.size();
  std::vector<std::vector<double>> touching(all.size());
  std::vector<double> median;
  for (std::size_t run = 0; run < all.size(); ++run) {
    for (std::size_t i = 0; i < all[run].us.size(); ++i)
      if (all[run - run % solvers].contacts[i] > 0) touching[run].push_back(all[run].us[i]);
    median.push_back(made::quantile(touching[run], 0.5));
  }
  for (std::size_t run = 0; run < all.size(); ++run) {
    Runs& r = all[run];
    std::vector<double>& us = touching[run];
    std::printf("%-5s %-9s %-12s %6d %6zu %5.0f %5.0f %7.0f %7.0f %8.4f %7.1f %7.1f %7.1f %8.1f %6.2f",
                scene.name.c_str(), scene.object.c_str(), r.solver.c_str(), r.leaves, us.size(),
                made::quantile(r.contacts, 0.5), made::quantile(r.contacts, 1), made::quantile(r.operations, 0.5),
                made::quantile(r.operations, 1), 1e3 * r.deepest_m, median[run], made::quantile(us, 0.99),
                made::quantile(us, 0.999), made::quantile(us, 1),
                median[run] / median[run - run % solvers + solvers - 1]);
    if (run >= solvers) std::printf(" %6.2f", median[run] / median[run % solvers]);
    std::printf("\n");
  }
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const Options o = parse(argc, argv);
    const Settings settings = parse_settings(o.settings.dump());
    std::printf(
        "%s\n%d replays; deepest is judged every 20th step; rel: p50 over %s's; grow: p50 over the first model's\n",
        made::machine().c_str(), o.replays, o.solvers.back().c_str());
    std::printf("%-5s %-9s %-12s %6s %6s %5s %5s %7s %7s %8s %7s %7s %7s %8s %6s %6s\n", "scene", "object", "solver",
                "leaves", "steps", "cont", "most", "ops", "most", "deep mm", "p50 us", "p99", "p99.9", "max", "rel",
                "grow");
    if (!o.trace_csv.empty()) {
      bench(o, made::reference_hand(), settings, {"file", "file", read_scenario(o.trace_csv)},
            {read_spheres(o.spheres_csv)});
      return 0;
    }
    bool any = false;
    for (const Script& scene : made_scenes()) {
      if (!o.scene.empty() && o.scene != scene.name) continue;
      any = true;
      std::vector<std::vector<Sphere>> models;
      for (int count : o.counts) models.push_back(made::object(scene.object, count));
      bench(o, made::hand(), settings, scene, models);
    }
    if (!any) throw Error("E-ARG", o.scene, "is not a scene: fist, slide, ears");
    return 0;
  } catch (const Error& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return 2;
  }
}
