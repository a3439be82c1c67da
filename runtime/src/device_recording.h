// A trace that is written while a device is recorded: raw bytes, readings and samples. Writing is on a thread of its
// own.
#pragma once

#include <chrono>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "cdr.h"
#include "mcap_writer.h"
#include "records.h"

namespace palmar {

class DeviceRecording {
 public:
  // What is older than a fifth of a second is in the file and survives a killed process.
  // Throws Error E-TRACE-HEADER, E-TRACE-WRITE.
  DeviceRecording(const std::string& path, Header header);
  ~DeviceRecording();
  DeviceRecording(const DeviceRecording&) = delete;
  DeviceRecording& operator=(const DeviceRecording&) = delete;

  // Values have to be storable and times of samples to rise. All throw once the disk took no more (Error E-TRACE-WRITE)
  // or memory was gone (std::bad_alloc).
  void add(const Sample& sample);
  void add(const DeviceReading& reading);
  void add_device_bytes(const DeviceBytes& device);
  void add_pose_bytes(const DeviceBytes& pose);
  // `end` is what is known of the whole only now; readers find it in the header.
  void close(const Header& end);

  // Messages that a disk which stalls for long left no room for.
  std::uint64_t dropped() const;

 private:
  struct Message {
    std::uint16_t channel;
    std::uint64_t log_time_ns;
    std::vector<std::uint8_t> payload;
  };

  void push(std::uint16_t channel, double time_s);
  void write_until_stopped();
  void stop();

  McapWriter writer_;
  std::uint16_t samples_, readings_, device_bytes_, pose_bytes_;
  CdrEncoder cdr_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<Message> waiting_;
  std::size_t waiting_bytes_ = 0;
  std::uint64_t dropped_ = 0;
  bool stopping_ = false;
  std::exception_ptr failed_;
  std::thread thread_;
};

}  // namespace palmar
