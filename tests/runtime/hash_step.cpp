// Prints a hash of every state, force and contact of wild motions against three objects, for each solver. Built once
// for each instruction set of the wide loops (its name is the argument); all must print the same.
#include <cstdint>
#include <cstdio>
#include <cstring>

#include "made_hand.h"
#include "made_objects.h"
#include "session.h"

using namespace palmar;

namespace {

bool machine_has(const char* set) {
#if defined(__x86_64__) && defined(__GNUC__)
  __builtin_cpu_init();
  if (std::strcmp(set, "avx2") == 0) return __builtin_cpu_supports("avx2");
  if (std::strcmp(set, "avx512f") == 0) return __builtin_cpu_supports("avx512f");
#endif
  return std::strcmp(set, "portable") == 0 || std::strcmp(set, "dispatched") == 0;
}

// FNV-1a over raw bytes.
void mix(std::uint64_t& hash, const void* bytes, std::size_t size) {
  for (std::size_t i = 0; i < size; ++i) hash = (hash ^ static_cast<const unsigned char*>(bytes)[i]) * 1099511628211ull;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2 || !machine_has(argv[1])) {
    std::printf("this machine has no %s", argc > 1 ? argv[1] : "argument");
    return 77;
  }
  const HandModel hand = made::hand();
  for (const SolverRow& solver : SOLVERS) {
    Settings settings;
    settings.solver = solver.name;
    const bool product = std::strcmp(solver.name, "progressive") == 0;
    for (const char* name : {"ball", "ears", "cup"}) {
      std::mt19937 rng(7);
      Session session(hand, made::object(name, product ? 30000 : 1000), settings);
      std::uint64_t hash = 14695981039346656037ull;
      long contacts = 0;
      Configuration from;
      from.position = Vec3(0, -0.05, 0.2);
      for (int leg = 0; leg < (product ? 8 : 3); ++leg) {
        const Configuration to = made::random_configuration(rng, 0.06);
        const Change way = difference(to, from);
        for (int i = 1; i <= 100; ++i) {
          Sample s;
          s.time_s = 0.1 * leg + 1e-3 * i;
          s.pose = to_pose(advance(from, way, 0.01 * i));
          const StepResult& r = session.step(s);
          contacts += r.contacts;
          mix(hash, &r.state_hash, sizeof r.state_hash);
          mix(hash, &r.operations, sizeof r.operations);
          mix(hash, r.fingertip_force_n.data(), sizeof r.fingertip_force_n);
          for (const Contact& c : session.contacts()) mix(hash, &c.gap_m, sizeof c.gap_m);
        }
        from = to;
      }
      std::printf("%s %s %016llx %ld\n", solver.name, name, (unsigned long long)hash, contacts);
    }
  }
  return 0;
}
