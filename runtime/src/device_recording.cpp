#include "device_recording.h"

#include <pthread.h>
#include <signal.h>

#include "channels.h"
#include "schemas.h"

namespace palmar {
namespace {

using Clock = std::chrono::steady_clock;

// Promised is a quarter of a second; the rest is for a system that lets this thread wait.
constexpr auto kFlushAfter = std::chrono::milliseconds(100);
constexpr std::size_t kWaitingMost = 64 << 20;  // bytes: an hour of a glove at 200 lines a second

std::uint16_t channel_for(McapWriter& writer, const MessageType& type) {
  return writer.add_channel(type.topic, type.name, type.text);
}

}  // namespace

DeviceRecording::DeviceRecording(const std::string& path, Header header)
    : writer_(path, McapWriter::Place::kNamedOnFlush) {
  set_schema(header, path, kTraceSchema);
  writer_.add_metadata(kTraceHeaderName, header);
  samples_ = channel_for(writer_, kSampleType);
  readings_ = channel_for(writer_, kDeviceReadingType);
  device_bytes_ = channel_for(writer_, kDeviceBytesType);
  pose_bytes_ = channel_for(writer_, kPoseBytesType);
  thread_ = std::thread([this] {
    // Signals are for the thread that reads the device.
    sigset_t all;
    sigfillset(&all);
    pthread_sigmask(SIG_BLOCK, &all, nullptr);
    write_until_stopped();
  });
}

DeviceRecording::~DeviceRecording() { stop(); }

void DeviceRecording::add(const Sample& sample) {
  cdr_.start();
  sample_fields(cdr_, sample);
  push(samples_, sample.time_s);
}

void DeviceRecording::add(const DeviceReading& reading) {
  cdr_.start();
  device_reading_fields(cdr_, reading);
  push(readings_, reading.time_s);
}

void DeviceRecording::add_device_bytes(const DeviceBytes& device) {
  cdr_.start();
  device_bytes_fields(cdr_, device);
  push(device_bytes_, device.time_s);
}

void DeviceRecording::add_pose_bytes(const DeviceBytes& pose) {
  cdr_.start();
  device_bytes_fields(cdr_, pose);
  push(pose_bytes_, pose.time_s);
}

void DeviceRecording::close(const Header& end) {
  stop();
  if (failed_) std::rethrow_exception(failed_);
  writer_.add_metadata(kTraceEndName, end);
  writer_.close();
}

std::uint64_t DeviceRecording::dropped() const {
  const std::lock_guard lock(mutex_);
  return dropped_;
}

void DeviceRecording::push(std::uint16_t channel, double time_s) {
  const auto payload = cdr_.bytes();
  const std::lock_guard lock(mutex_);
  if (failed_) std::rethrow_exception(failed_);
  if (waiting_bytes_ + payload.size() > kWaitingMost) {
    ++dropped_;
    return;
  }
  waiting_.push_back({channel, log_time_ns(time_s), {payload.begin(), payload.end()}});
  waiting_bytes_ += payload.size();
}

// It looks by itself, ten times a second: nobody waits for what is written.
void DeviceRecording::write_until_stopped() {
  std::vector<Message> messages;
  for (bool last = false; !last;) {
    {
      std::unique_lock lock(mutex_);
      last = changed_.wait_for(lock, kFlushAfter, [this] { return stopping_; });
      messages.swap(waiting_);
      waiting_bytes_ = 0;
    }
    try {
      for (const Message& message : messages)
        writer_.add_message(message.channel, message.log_time_ns, message.payload);
      writer_.flush();
    } catch (...) {
      const std::lock_guard lock(mutex_);
      failed_ = std::current_exception();
      return;
    }
    messages.clear();
  }
}

void DeviceRecording::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_one();
  if (thread_.joinable()) thread_.join();
}

}  // namespace palmar
