// What a step and an append promise a real-time thread: nothing allocated, nothing locked, no call to the system. The
// kernel itself catches the calls. test_real_time [STEPS]
#include <dlfcn.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <pthread.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <mutex>
#include <string>

#include "check.h"
#include "made_hand.h"
#include "made_objects.h"
#include "recorder.h"
#include "session.h"

using namespace palmar;

namespace {

struct Seen {
  long allocations, locks, clock_reads, calls;
  int last_call;  // number of the last system call that was none of the clock
  bool done;
};

thread_local bool watched = false;
Seen* seen = nullptr;  // shared with the parent process

void count(long Seen::* what) {
  if (watched) ++(seen->*what);
}

template <class Function>
Function* original(Function*, const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

}  // namespace

// Every way to the heap and every lock of the C library, as this program and the libraries under it call them.
extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);
void __libc_free(void*);

void* malloc(size_t size) {
  count(&Seen::allocations);
  return __libc_malloc(size);
}
void* calloc(size_t n, size_t size) {
  count(&Seen::allocations);
  return __libc_calloc(n, size);
}
void* realloc(void* p, size_t size) {
  count(&Seen::allocations);
  return __libc_realloc(p, size);
}
void* aligned_alloc(size_t align, size_t size) {
  count(&Seen::allocations);
  return __libc_memalign(align, size);
}
int posix_memalign(void** p, size_t align, size_t size) {
  count(&Seen::allocations);
  *p = __libc_memalign(align, size);
  return *p ? 0 : 12;
}
void free(void* p) {
  count(&Seen::allocations);
  __libc_free(p);
}

int pthread_mutex_lock(pthread_mutex_t* mutex) {
  static auto* const lock = original(&pthread_mutex_lock, "pthread_mutex_lock");
  count(&Seen::locks);
  return lock(mutex);
}
int pthread_rwlock_rdlock(pthread_rwlock_t* rwlock) {
  static auto* const lock = original(&pthread_rwlock_rdlock, "pthread_rwlock_rdlock");
  count(&Seen::locks);
  return lock(rwlock);
}
int pthread_rwlock_wrlock(pthread_rwlock_t* rwlock) {
  static auto* const lock = original(&pthread_rwlock_wrlock, "pthread_rwlock_wrlock");
  count(&Seen::locks);
  return lock(rwlock);
}
}

namespace {

void caught(int, siginfo_t* info, void*) {
  // The clock is a page that the kernel lends, and a call only where a machine has no such clock.
  if (info->si_syscall == SYS_clock_gettime) {
    ++seen->clock_reads;
  } else {
    ++seen->calls;
    seen->last_call = info->si_syscall;
  }
}

// From here on each system call of this thread raises a signal instead; but the return from its handler, and the end.
bool forbid_system_calls() {
  struct sigaction action{};
  action.sa_sigaction = caught;
  action.sa_flags = SA_SIGINFO;
  sigaction(SIGSYS, &action, nullptr);
  sock_filter rows[] = {
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_rt_sigreturn, 1, 0),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_exit_group, 0, 1),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRAP),
  };
  sock_fprog program{std::size(rows), rows};
  return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 && prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0;
}

// Runs `body` watched, in a process of its own. False if this system does not let a process watch itself so.
template <class Body>
bool watch(Body body) {
  std::memset(static_cast<void*>(seen), 0, sizeof *seen);
  const pid_t child = fork();
  if (child == 0) {
    body([] {
      if (!forbid_system_calls()) _exit(77);
      watched = true;
    });
    watched = false;
    seen->done = true;
    _exit(0);
  }
  int status = 0;
  waitpid(child, &status, 0);
  return !(WIFEXITED(status) && WEXITSTATUS(status) == 77);
}

// The trap must catch, or its silence says nothing.
void the_trap_catches() {
  std::mutex mutex;
  if (!watch([&](auto begin) {
        begin();
        free(malloc(16));
        mutex.lock();
        syscall(SYS_getpid);
      })) {
    std::printf("this system has no seccomp filters: calls to it are not watched\n");
    std::exit(finish());
  }
  CHECK(seen->done && seen->allocations == 2 && seen->locks == 1 && seen->calls == 1);
  CHECK(seen->last_call == SYS_getpid);
}

void nothing_is_called(const char* solver, const char* object, long steps) {
  const std::filesystem::path path =
      std::filesystem::temp_directory_path() / ("palmar_real_time_" + std::to_string(getpid()) + ".mcap");
  long contacts = 0;
  watch([&](auto begin) {
    Settings settings;
    settings.solver = solver;
    Session session(made::hand(), made::object(object, 10000), settings);
    Recorder recorder(path.string(), {{"device", "test"}, {"hand", "a"}, {"side", "right"}}, 4096);
    std::mt19937 rng(5);
    Configuration from;
    from.position = Vec3(0, -0.05, 0.2);
    session.step({});  // the first step looks for a free place
    begin();
    for (long i = 0; i < steps;) {
      const Configuration to = made::random_configuration(rng, 0.06);
      const Change way = difference(to, from);
      for (int k = 1; k <= 100 && i < steps; ++k, ++i) {
        Sample sample;
        sample.time_s = 1e-3 * double(i + 1);
        sample.tracked = i % 997 != 0;
        sample.pose = to_pose(advance(from, way, 0.01 * k));
        contacts += session.step(sample).contacts;
        recorder.append(sample);
      }
      from = to;
    }
    seen->done = contacts > 0;
    _exit(seen->done ? 0 : 1);
  });
  std::filesystem::remove(path);
  std::printf("%s, %s, %ld steps: %ld allocations, %ld locks, %ld system calls", solver, object, steps,
              seen->allocations, seen->locks, seen->calls);
  std::printf(seen->calls ? " (the last is number %d)\n" : "\n", seen->last_call);
  if (seen->clock_reads) std::printf("the clock of this machine is a system call: read %ld times\n", seen->clock_reads);
  CHECK(seen->done);
  CHECK(seen->allocations == 0 && seen->locks == 0 && seen->calls == 0);
}

}  // namespace

int main(int argc, char** argv) {
  const long steps = argc > 1 ? std::atol(argv[1]) : 20000;
  seen = static_cast<Seen*>(mmap(nullptr, sizeof(Seen), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  the_trap_catches();
  for (const SolverRow& solver : SOLVERS) {
    const bool product = std::strcmp(solver.name, "progressive") == 0;
    nothing_is_called(solver.name, "ears", product ? steps : steps / 20);
    if (product) nothing_is_called(solver.name, "cup", steps / 4);
  }
  return finish();
}
