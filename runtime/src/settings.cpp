#include "settings.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <variant>
#include <vector>

#include "error.h"

namespace palmar {

namespace {

struct Key {
  const char* name;
  std::variant<double Settings::*, int Settings::*, std::string Settings::*> member;
  double least, most;  // of a number
};

// One row a setting: what replay, Python and C may set, and the range that makes sense.
const std::vector<Key>& keys() {
  static const std::vector<Key> table = {
      {"aim_m", &Settings::aim_m, 1e-9, 1e-3},
      {"candidates", &Settings::candidates, 64, 8192},
      {"corrections", &Settings::corrections, 0, 100},
      {"curvature", &Settings::curvature, 0, 1},
      {"fade_s", &Settings::fade_s, 1e-3, 10},
      {"filter", &Settings::filter, 0, 0},
      {"filter_beta", &Settings::filter_beta, 0, 1000},
      {"filter_cutoff_hz", &Settings::filter_cutoff_hz, 1e-3, 1000},
      {"force_step_n", &Settings::force_step_n, 0, 1e9},
      {"free_reach_m", &Settings::free_reach_m, 1e-4, 10},
      {"imposed_priority", &Settings::imposed_priority, 1e-3, 1e6},
      {"iterations", &Settings::iterations, 1, 1000},
      {"joint_step_rad", &Settings::joint_step_rad, 1e-4, 100},
      {"leave_out", &Settings::leave_out, 0, 0},
      {"level", &Settings::level, -1, 64},
      {"object_jump_m", &Settings::object_jump_m, 1e-3, 1e3},
      {"operations", &Settings::operations, 10'000, 1'000'000'000},
      {"palm_priority", &Settings::palm_priority, 1e-3, 1e6},
      {"qp_iterations", &Settings::qp_iterations, 1, 100'000},
      {"rate_hz", &Settings::rate_hz, 1, 100'000},
      {"reach_least_m", &Settings::reach_least_m, 1e-6, 0.1},
      {"reach_most_m", &Settings::reach_most_m, 1e-5, 0.1},
      {"release_after_s", &Settings::release_after_s, 0, 3600},
      {"release_beyond_m", &Settings::release_beyond_m, 0.01, 1000},
      {"resample", &Settings::resample, 0, 0},
      {"settled_m", &Settings::settled_m, 0, 1e-4},
      {"solver", &Settings::solver, 0, 0},
  };
  return table;
}

std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({above + 1, row[j - 1] + 1, diagonal + (a[i - 1] != b[j - 1])});
      diagonal = above;
    }
  }
  return row[b.size()];
}

}  // namespace

Settings parse_settings(const std::string& json) {
  const nlohmann::json given = nlohmann::json::parse(json, nullptr, false);
  if (!given.is_object()) throw Error("E-CONF-FORMAT", "settings", "not a JSON object");
  Settings settings;
  for (const auto& [name, value] : given.items()) {
    const auto found = std::find_if(keys().begin(), keys().end(), [&](const Key& k) { return name == k.name; });
    if (found == keys().end()) {
      const auto nearest = std::min_element(keys().begin(), keys().end(), [&](const Key& a, const Key& b) {
        return edit_distance(name, a.name) < edit_distance(name, b.name);
      });
      throw Error("E-CONF-KEY", name.empty() ? "''" : name,
                  std::string("no setting of this name; the nearest is '") + nearest->name + "'");
    }
    if (const auto text = std::get_if<std::string Settings::*>(&found->member)) {
      if (!value.is_string()) throw Error("E-CONF-TYPE", name, value.dump() + "; text is needed");
      settings.*(*text) = value.get<std::string>();
      continue;
    }
    const auto whole = std::get_if<int Settings::*>(&found->member);
    if (whole ? !value.is_number_integer() : !value.is_number())
      throw Error("E-CONF-TYPE", name, value.dump() + (whole ? "; a whole number is needed" : "; a number is needed"));
    const double number = value.get<double>();
    if (!(number >= found->least && number <= found->most)) {
      const nlohmann::json range = {found->least, found->most};
      throw Error("E-CONF-VALUE", name, value.dump() + "; the range is " + range.dump());
    }
    if (whole)
      settings.*(*whole) = int(number);
    else
      settings.*std::get<double Settings::*>(found->member) = number;
  }
  if (settings.filter != "none" && settings.filter != "one_euro")
    throw Error("E-CONF-VALUE", "filter", "'" + settings.filter + "'; there are: none, one_euro");
  links_of(settings.leave_out);
  if (settings.reach_least_m > std::min(settings.reach_most_m, settings.free_reach_m))
    throw Error("E-CONF-VALUE", "reach_least_m",
                nlohmann::json(settings.reach_least_m).dump() + "; at most reach_most_m and free_reach_m");
  return settings;
}

std::string settings_json(const Settings& settings) {
  nlohmann::json out;
  for (const Key& key : keys()) std::visit([&](auto member) { out[key.name] = settings.*member; }, key.member);
  return out.dump();
}

}  // namespace palmar
