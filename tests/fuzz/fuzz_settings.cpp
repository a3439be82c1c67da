// Settings as JSON text.
#include <string>

#include "settings.h"
#include "target.h"

using namespace palmar;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Settings settings;
  const std::string text(reinterpret_cast<const char*>(data), size);
  if (!reads("E-CONF-", [&] { settings = parse_settings(text); })) return 0;
  const std::string once = settings_json(settings);
  MUST(settings_json(parse_settings(once)) == once);
  MUST(settings.rate_hz >= 1 && settings.rate_hz <= 100000);
  MUST(settings.candidates >= 64 && settings.iterations >= 1);
  return 0;
}
