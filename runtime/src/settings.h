// Settings by name: from JSON with every key checked, and back.
#pragma once

#include <string>

#include "solver.h"

namespace palmar {

// Text of a JSON object. Throws Error E-CONF-KEY (with the nearest known key), E-CONF-TYPE or E-CONF-VALUE (with the
// range).
Settings parse_settings(const std::string& json);

// Every setting with its value, keys sorted.
std::string settings_json(const Settings& settings);

}  // namespace palmar
