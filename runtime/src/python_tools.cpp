// The Python face of what the sphere trees' tools need.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <memory>

#include "bound_tree.h"
#include "cover_fit.h"
#include "parallel.h"
#include "sphere_union.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace palmar {

void bind_tools(nb::module_& m);

namespace {

using Rows3 = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Rows4 = nb::ndarray<const double, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;
using Faces = nb::ndarray<const std::int64_t, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Numbers = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

std::vector<Vec3> to_points(const Rows3& rows) {
  std::vector<Vec3> points(rows.shape(0));
  for (std::size_t k = 0; k < points.size(); ++k) points[k] = Vec3(rows(k, 0), rows(k, 1), rows(k, 2));
  return points;
}

nb::object to_rows(const std::vector<InsideBall>& balls) {
  double* values = new double[balls.size() * 4 + 1];
  const nb::capsule owner(values, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  for (std::size_t k = 0; k < balls.size(); ++k) {
    const double row[4] = {balls[k].center.x(), balls[k].center.y(), balls[k].center.z(), balls[k].inside};
    std::copy_n(row, 4, values + 4 * k);
  }
  return nb::cast(nb::ndarray<nb::numpy, double>(values, {balls.size(), 4}, owner));
}

template <class T>
nb::object to_array(const std::vector<T>& values, std::initializer_list<std::size_t> shape) {
  T* copy = new T[values.size() + 1];
  std::copy(values.begin(), values.end(), copy);
  const nb::capsule owner(copy, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return nb::cast(nb::ndarray<nb::numpy, T>(copy, shape, owner));
}

SphereUnion make_union(const Rows4& spheres) {
  std::vector<Ball> balls(spheres.shape(0));
  for (std::size_t k = 0; k < balls.size(); ++k)
    balls[k] = {Vec3(spheres(k, 0), spheres(k, 1), spheres(k, 2)), spheres(k, 3)};
  return SphereUnion(std::move(balls), processors());
}

nb::tuple to_tuple(const std::vector<NearBall>& found) {
  std::vector<double> distances;
  std::vector<std::int64_t> owners;
  for (const NearBall& near : found) {
    distances.push_back(near.distance);
    owners.push_back(near.owner);
  }
  return nb::make_tuple(to_array(distances, {distances.size()}), to_array(owners, {owners.size()}));
}

nb::tuple union_nearest(const Rows4& spheres, const Rows3& points) {
  return to_tuple(make_union(spheres).nearest(to_points(points)));
}

nb::tuple union_exits(const Rows4& spheres, const Rows3& points, const Rows3& directions) {
  return to_tuple(make_union(spheres).exits(to_points(points), to_points(directions)));
}

nb::tuple union_skin(const Rows4& spheres, double offset, double spacing, std::uint64_t seed) {
  std::vector<std::int64_t> owners;
  std::vector<double> directions, angles;
  for (const SkinSample& sample : make_union(spheres).skin(offset, spacing, seed)) {
    owners.push_back(sample.owner);
    directions.insert(directions.end(), sample.direction.data(), sample.direction.data() + 3);
    angles.push_back(sample.solid_angle);
  }
  return nb::make_tuple(to_array(owners, {owners.size()}), to_array(directions, {owners.size(), 3}),
                        to_array(angles, {owners.size()}));
}

std::vector<std::array<std::int32_t, 3>> to_corners(const Faces& faces) {
  std::vector<std::array<std::int32_t, 3>> corners(faces.shape(0));
  for (std::size_t k = 0; k < corners.size(); ++k) {
    for (std::size_t axis = 0; axis < 3; ++axis) corners[k][axis] = std::int32_t(faces(k, axis));
  }
  return corners;
}

nb::object radii_to_cover(const Rows4& spheres, const Rows3& vertices, const Faces& faces, double finest) {
  const std::vector<double> radii = make_union(spheres).radii_to_cover(to_points(vertices), to_corners(faces), finest);
  return to_array(radii, {radii.size()});
}

nb::tuple bound_tree_of(const Rows4& rows, double reach) {
  std::vector<Sphere> spheres(rows.shape(0));
  for (std::size_t k = 0; k < spheres.size(); ++k) spheres[k] = {Vec3(rows(k, 0), rows(k, 1), rows(k, 2)), rows(k, 3)};
  const BoundTree tree = bound_tree(spheres, reach);
  std::vector<double> bounds;
  for (const Sphere& bound : tree.bounds)
    bounds.insert(bounds.end(), {bound.center.x(), bound.center.y(), bound.center.z(), bound.radius});
  return nb::make_tuple(
      to_array(tree.order, {tree.order.size()}), to_array(tree.sphere_parent, {tree.sphere_parent.size()}),
      to_array(bounds, {tree.bounds.size(), 4}), to_array(tree.bound_parent, {tree.bound_parent.size()}));
}

nb::object shoot_all(const TriangleTree& tree, const Rows3& points, const Rows3& inward, const Numbers& faces,
                     double slack, double start) {
  std::vector<InsideBall> balls;
  for (std::size_t k = 0; k < points.shape(0); ++k) {
    const auto ball = shoot(tree, Vec3(points(k, 0), points(k, 1), points(k, 2)),
                            Vec3(inward(k, 0), inward(k, 1), inward(k, 2)), std::int32_t(faces(k)), slack, start);
    if (ball) balls.push_back(*ball);
  }
  return to_rows(balls);
}

// Rows of centres, with or without a fourth column, and their exact distance to the surface.
template <class Rows>
std::vector<InsideBall> to_balls(const TriangleTree& tree, const Rows& rows) {
  std::vector<InsideBall> balls;
  for (std::size_t k = 0; k < rows.shape(0); ++k) {
    const Vec3 center(rows(k, 0), rows(k, 1), rows(k, 2));
    const Closest found = tree.closest(center);
    const double inside = std::sqrt(found.squared);
    balls.push_back({center, inside, found.face, inside});
  }
  return balls;
}

using ZoneList = std::vector<std::pair<const TriangleTree*, double>>;

std::vector<Zone> to_zones(const ZoneList& list) {
  std::vector<Zone> zones;
  for (const auto& [tree, share] : list) zones.push_back({tree, share});
  return zones;
}

nb::object held_all(const ZoneList& zones, const Rows4& balls, double excess) {
  std::vector<double> held(balls.shape(0));
  for (std::size_t k = 0; k < held.size(); ++k)
    held[k] = held_inside(to_zones(zones), Vec3(balls(k, 0), balls(k, 1), balls(k, 2)), balls(k, 3), excess);
  return to_array(held, {held.size()});
}

}  // namespace

void bind_tools(nb::module_& m) {
  m.def("union_nearest", &union_nearest, "spheres"_a, "points"_a);
  m.def("union_exits", &union_exits, "spheres"_a, "points"_a, "directions"_a);
  m.def("union_skin", &union_skin, "spheres"_a, "offset"_a, "spacing"_a, "seed"_a);
  m.def("radii_to_cover", &radii_to_cover, "spheres"_a, "vertices"_a, "faces"_a, "finest"_a);
  m.def("bound_tree", &bound_tree_of, "spheres"_a, "reach"_a);
  nb::class_<TriangleTree>(m, "TriangleTree")
      .def(nb::new_([](const Rows3& vertices, const Faces& faces) {
             return std::make_unique<TriangleTree>(to_points(vertices), to_corners(faces));
           }),
           "vertices"_a, "faces"_a)
      .def("shoot", &shoot_all, "points"_a, "inward"_a, "faces"_a, "slack"_a, "start"_a)
      .def(
          "distances", [](const TriangleTree& tree, const Rows3& centers) { return to_rows(to_balls(tree, centers)); },
          "centers"_a);
  m.def("held_inside", &held_all, "zones"_a, "balls"_a, "excess"_a);
  nb::class_<CoverFit>(m, "CoverFit")
      .def(nb::new_([](const TriangleTree& tree, const ZoneList& zones, const Rows3& points, const Rows3& inward,
                       const Numbers& faces, const Numbers& zone, std::uint64_t seed, int threads) {
             Samples samples{to_points(points), to_points(inward), {}, {}};
             for (std::size_t k = 0; k < faces.shape(0); ++k) {
               samples.faces.push_back(std::int32_t(faces(k)));
               samples.zones.push_back(std::int32_t(zone(k)));
             }
             return std::make_unique<CoverFit>(tree, to_zones(zones), samples, seed, threads);
           }),
           "tree"_a, "zones"_a, "points"_a, "inward"_a, "faces"_a, "zone"_a, "seed"_a, "threads"_a,
           nb::keep_alive<0, 1>(), nb::keep_alive<0, 2>())
      .def(
          "set_balls",
          [](CoverFit& fit, const TriangleTree& tree, const Rows4& rows, int fixed) {
            fit.set_balls(to_balls(tree, rows), fixed);
          },
          "tree"_a, "balls"_a, "fixed"_a = 0)
      .def("balls", [](const CoverFit& fit) { return to_rows(fit.balls()); })
      .def("set_budget", &CoverFit::set_budget, "low"_a, "high"_a, "excess"_a)
      .def("quantile", &CoverFit::quantile, "share"_a)
      .def("polish", &CoverFit::polish, "step"_a, "moves"_a, "temperature"_a)
      .def("exchange", &CoverFit::exchange, "trials"_a, "candidates"_a)
      .def("remove", &CoverFit::remove, "count"_a)
      .def("remove_useless", &CoverFit::remove_useless)
      .def("add", &CoverFit::add, "count"_a, "candidates"_a);
}

}  // namespace palmar
