// What threads share, or must not: sessions side by side, a fit by several threads, a device that is recorded while
// somebody asks. Under a detector of races (make sanitize) it says more than that the answers are right.
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <thread>

#include "check.h"
#include "cover_fit.h"
#include "device_recording.h"
#include "made_hand.h"
#include "made_objects.h"
#include "session.h"
#include "sphere_union.h"
#include "trace_file.h"

using namespace palmar;

namespace {

// Hashes of wild steps against one object.
std::vector<std::uint64_t> hashes(const HandModel& hand, const std::vector<Sphere>& object, const Settings& settings) {
  Session session(hand, object, settings);
  std::mt19937 rng(11);
  std::vector<std::uint64_t> all;
  Configuration from;
  from.position = Vec3(0, -0.05, 0.2);
  for (int leg = 0; leg < 3; ++leg) {
    const Configuration to = made::random_configuration(rng, 0.06);
    const Change way = difference(to, from);
    for (int k = 1; k <= 50; ++k) {
      Sample sample;
      sample.time_s = 1e-3 * (50 * leg + k);
      sample.pose = to_pose(advance(from, way, 0.02 * k));
      all.push_back(session.step(sample).state_hash);
    }
    from = to;
  }
  return all;
}

void sessions_side_by_side_step_as_alone() {
  const HandModel hand = made::hand();
  const std::vector<Sphere> object = made::object("ears", 3000);
  for (const SolverRow& solver : SOLVERS) {
    Settings settings;
    settings.solver = solver.name;
    const std::vector<std::uint64_t> alone = hashes(hand, object, settings);
    std::vector<std::vector<std::uint64_t>> found(4);
    std::vector<std::thread> threads;
    for (auto& mine : found) threads.emplace_back([&] { mine = hashes(hand, object, settings); });
    for (std::thread& thread : threads) thread.join();
    for (const auto& mine : found) CHECK(mine == alone);
  }
}

// A cube of 40 mm as a mesh, and a lattice of samples on it.
struct Cube {
  std::vector<Vec3> vertices;
  std::vector<std::array<std::int32_t, 3>> faces;
  Samples samples;

  Cube() {
    constexpr double half = 0.02;
    constexpr int across = 24;
    for (int axis = 0; axis < 3; ++axis)
      for (const double way : {-1.0, 1.0}) {
        const Vec3 out = way * Vec3::Unit(axis), u = Vec3::Unit((axis + 1) % 3), v = out.cross(u);
        const auto at = [&](double a, double b) { return Vec3(half * (out + a * u + b * v)); };
        const auto first = std::int32_t(vertices.size()), face = std::int32_t(faces.size());
        for (const auto& [a, b] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}) vertices.push_back(at(a, b));
        faces.push_back({first, first + 1, first + 2});
        faces.push_back({first, first + 2, first + 3});
        for (int i = 0; i < across; ++i)
          for (int k = 0; k < across; ++k) {
            const double a = (2 * i + 1.0) / across - 1, b = (2 * k + 1.0) / across - 1;
            samples.points.push_back(at(a, b));
            samples.inward.push_back(-out);
            samples.faces.push_back(face + (a < b ? 1 : 0));
            samples.zones.push_back(0);
          }
      }
  }
};

// Centres of the balls, how far samples lie outside them, and the radii that would cover all.
std::vector<double> fitted(const Cube& cube, const TriangleTree& tree, int threads) {
  std::vector<InsideBall> balls;
  for (std::size_t k = 0; k < cube.samples.points.size(); k += 40)
    if (const auto ball =
            shoot(tree, cube.samples.points[k], cube.samples.inward[k], cube.samples.faces[k], 1e-5, 0.5 * tree.size()))
      balls.push_back(*ball);
  CoverFit fit(tree, {}, cube.samples, 5, threads);
  fit.set_budget(0.5e-3, 1e-3, 0);
  fit.set_balls(balls, 0);
  fit.exchange(100, 4);
  fit.polish(0.3, 4, 0.1);
  fit.remove(5);
  fit.remove_useless();
  fit.add(20, 4);
  std::vector<Ball> spheres;
  std::vector<double> all;
  for (const InsideBall& ball : fit.balls()) {
    spheres.push_back({ball.center, ball.held});
    all.insert(all.end(), ball.center.begin(), ball.center.end());
  }
  const SphereUnion spheres_union(spheres, threads);
  for (const NearBall& near : spheres_union.nearest(cube.samples.points)) all.push_back(near.distance);
  for (const NearBall& exit : spheres_union.exits(cube.samples.points, cube.samples.inward))
    all.push_back(exit.distance);
  for (const double radius : spheres_union.radii_to_cover(cube.vertices, cube.faces, 1e-4)) all.push_back(radius);
  for (const SkinSample& on : spheres_union.skin(0, 1e-3, 3)) all.push_back(on.solid_angle);
  return all;
}

void a_fit_is_the_same_for_any_number_of_threads() {
  const Cube cube;
  const TriangleTree tree(cube.vertices, cube.faces);
  const std::vector<double> alone = fitted(cube, tree, 1);
  CHECK(alone.size() > cube.samples.points.size());
  for (const int threads : {2, 3, 8}) CHECK(fitted(cube, tree, threads) == alone);
}

// One thread adds until some of it is in the file, another asks meanwhile.
void a_device_is_recorded_while_somebody_asks() {
  const std::string path =
      (std::filesystem::temp_directory_path() / ("palmar_threads_" + std::to_string(getpid()) + ".mcap")).string();
  DeviceRecording recording(path, {{"device", "test"}, {"hand", "a"}, {"side", "left"}});
  std::atomic<bool> done = false;
  bool dropped = false;
  std::thread asks([&] {
    while (!done) dropped |= recording.dropped() > 0;
  });
  std::size_t count = 0;
  for (std::size_t last = SIZE_MAX; count < last; ++count) {
    Sample sample;
    sample.time_s = 1e-3 * double(count);
    recording.add(sample);
    recording.add_device_bytes({sample.time_s, {std::uint8_t(count)}});
    if (last == SIZE_MAX && std::filesystem::exists(path)) last = count + 100;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  done = true;
  asks.join();
  CHECK(!dropped);
  recording.close({});
  const Trace trace = read_trace(path);
  CHECK(trace.samples.size() == count && trace.device_bytes.size() == count && !trace.loss.unclosed);
  std::filesystem::remove(path);
}

}  // namespace

int main() {
  sessions_side_by_side_step_as_alone();
  a_fit_is_the_same_for_any_number_of_threads();
  a_device_is_recorded_while_somebody_asks();
  return finish();
}
