// One message of each kind: what is decoded is encoded to something that decodes to the same.
#include <vector>

#include "cdr.h"
#include "schemas.h"
#include "target.h"

using namespace palmar;

namespace {

template <class Message, class Fields>
void go_round(std::span<const std::uint8_t> payload, Fields fields) {
  Message message;
  CdrDecoder decoder(payload);
  fields(decoder, message);
  CdrEncoder encoder;
  fields(encoder, message);
  if (!decoder.whole()) return;
  const std::vector<std::uint8_t> once(encoder.bytes().begin(), encoder.bytes().end());
  MUST(once.size() <= payload.size());  // nothing is made that the bytes do not hold
  Message again;
  CdrDecoder back(once);
  fields(back, again);
  MUST(back.whole());
  encoder.start();
  fields(encoder, again);
  MUST(std::equal(once.begin(), once.end(), encoder.bytes().begin(), encoder.bytes().end()));
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::span<const std::uint8_t> payload(data + 1, size - 1);
  switch (data[0] % 6) {
    case 0:
      go_round<Sample>(payload, [](auto& cdr, auto& m) { sample_fields(cdr, m); });
      break;
    case 1:
      go_round<DeviceBytes>(payload, [](auto& cdr, auto& m) { device_bytes_fields(cdr, m); });
      break;
    case 2:
      go_round<StepResult>(payload, [](auto& cdr, auto& m) { step_fields(cdr, m); });
      break;
    case 3:
      go_round<ContactColumns>(payload, [](auto& cdr, auto& m) { contacts_fields(cdr, m); });
      break;
    case 4:
      go_round<TimingMessage>(payload, [](auto& cdr, auto& m) { timing_fields(cdr, m); });
      break;
    default:
      go_round<DeviceReading>(payload, [](auto& cdr, auto& m) { device_reading_fields(cdr, m); });
  }
  return 0;
}
