// Records samples from a thread that must not wait: a ring between that thread and one that writes the trace.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <exception>
#include <string>
#include <thread>
#include <vector>

#include "records.h"
#include "trace_file.h"

namespace palmar {

class Recorder {
 public:
  enum class Taken {
    kYes,
    kUnusable,  // a trace cannot hold it: not finite, no rotation, or its time does not rise
    kNoRoom,    // the ring is full, or the disk has failed
  };
  struct Counts {
    std::uint64_t taken = 0;    // by append
    std::uint64_t written = 0;  // of those: with the system, so that they survive the death of this process
    std::uint64_t dropped = 0;  // kNoRoom
    std::uint64_t refused = 0;  // kUnusable
    bool failed = false;        // the disk does not take more; close() says why
  };

  // Throws Error: E-TRACE-EXISTS (a recording is never written over), E-TRACE-WRITE, E-TRACE-HEADER, E-CONF-VALUE.
  Recorder(const std::string& path, const Header& header, std::size_t ring_samples);
  ~Recorder();
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  // For one thread. Neither waits, allocates, locks nor calls the system.
  Taken append(const Sample& sample);
  // For any thread.
  Counts counts() const;
  // Writes what the ring holds and ends the file; after the last append. Throws Error E-TRACE-WRITE if the disk failed.
  Counts close();

 private:
  void write_all();
  void drain();

  std::vector<Sample> ring_;
  TraceWriter writer_;
  double last_time_s_ = -1;  // of the thread that appends, as are head_ and the counts below it
  alignas(64) std::atomic<std::uint64_t> head_ = 0;
  std::atomic<std::uint64_t> dropped_ = 0, refused_ = 0;
  alignas(64) std::atomic<std::uint64_t> tail_ = 0;  // of the thread that writes, as is the rest
  std::atomic<std::uint64_t> written_ = 0;
  std::atomic<bool> failed_ = false;
  std::chrono::steady_clock::time_point oldest_;  // when the first sample came that is not yet with the system
  std::exception_ptr failure_;
  std::atomic<bool> closing_ = false;
  std::thread thread_;
};

}  // namespace palmar
