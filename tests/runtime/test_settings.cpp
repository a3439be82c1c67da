// Settings as JSON: what is taken comes back, what is not is named with what is allowed.
#include <nlohmann/json.hpp>

#include "check.h"
#include "error.h"
#include "settings.h"

using namespace palmar;

namespace {

std::string said_of(const std::string& json) {
  try {
    parse_settings(json);
    return "";
  } catch (const Error& error) {
    return error.what();
  }
}

// One that is in the middle of its range, or another word, for each.
void every_setting_comes_back() {
  const nlohmann::json usual = nlohmann::json::parse(settings_json(Settings{}));
  const nlohmann::json words = {
      {"filter", "one_euro"}, {"leave_out", "palm+little"}, {"resample", "hold"}, {"solver", "paper"}};
  CHECK(parse_settings("{}").solver == "progressive");
  for (const auto& [name, value] : usual.items()) {
    nlohmann::json one;
    if (value.is_string())
      one[name] = words.at(name);
    else if (value.is_number_integer())
      one[name] = name == "level" ? 3 : value.get<int>() + 1;
    else
      one[name] = value == 0 ? 1e-5 : 0.75 * value.get<double>();
    const nlohmann::json back = nlohmann::json::parse(settings_json(parse_settings(one.dump())));
    nlohmann::json wanted = usual;
    wanted.update(one);
    CHECK(back == wanted);
  }
}

void what_is_no_object_is_refused() {
  for (const char* text : {"", "{", "[]", "3", "null", "\"solver\"", "{\"level\": 1} x", "\xFF"})
    CHECK(said_of(text) == "E-CONF-FORMAT settings: not a JSON object");
}

void an_unknown_name_gets_the_nearest() {
  const auto near = [](const std::string& name, const std::string& shown, const std::string& nearest) {
    CHECK(said_of("{\"" + name + "\": 1}") ==
          "E-CONF-KEY " + shown + ": no setting of this name; the nearest is '" + nearest + "'");
  };
  near("iteratons", "iteratons", "iterations");
  near("itertaions", "itertaions", "iterations");
  near("Level", "Level", "level");
  near("rate", "rate", "rate_hz");
  near("joint_step", "joint_step", "joint_step_rad");
  near("", "''", "aim_m");  // of the shortest names the first
  near("rate_hz\\n", "rate_hz\\x0a", "rate_hz");
}

void a_value_of_another_kind_is_refused() {
  CHECK(said_of(R"({"solver": 3})") == "E-CONF-TYPE solver: 3; text is needed");
  CHECK(said_of(R"({"filter": null})") == "E-CONF-TYPE filter: null; text is needed");
  CHECK(said_of(R"({"iterations": 2.5})") == "E-CONF-TYPE iterations: 2.5; a whole number is needed");
  CHECK(said_of(R"({"level": "1"})") == "E-CONF-TYPE level: \"1\"; a whole number is needed");
  CHECK(said_of(R"({"rate_hz": [1]})") == "E-CONF-TYPE rate_hz: [1]; a number is needed");
  CHECK(said_of(R"({"rate_hz": true})") == "E-CONF-TYPE rate_hz: true; a number is needed");
}

void a_value_outside_its_range_is_refused() {
  CHECK(said_of(R"({"iterations": 0})") == "E-CONF-VALUE iterations: 0; the range is [1.0,1000.0]");
  CHECK(said_of(R"({"iterations": 1000})").empty());
  CHECK(said_of(R"({"iterations": 5000000000})").starts_with("E-CONF-VALUE iterations: 5000000000; "));
  CHECK(said_of(R"({"curvature": -0.0001})") == "E-CONF-VALUE curvature: -0.0001; the range is [0.0,1.0]");
  CHECK(said_of(R"({"rate_hz": 1e999})").starts_with("E-CONF-"));
  CHECK(said_of(R"({"filter": "kalman"})") == "E-CONF-VALUE filter: 'kalman'; there are: none, one_euro");
  for (const char* parts : {"", "hand", "palm+", "+palm", "palm+none", "palm,thumb"})
    CHECK(said_of(std::string(R"({"leave_out": ")") + parts + "\"}")
              .starts_with("E-CONF-VALUE leave_out: '" + std::string(parts) + "'; none, or some of palm, thumb, "));
  CHECK(links_of("palm+thumb") == 0b1111 && links_of("little") == 0b111u << 13 && links_of("none") == 0);
}

// A step that looks at least as far as it looks at most.
void reaches_that_contradict_each_other_are_refused() {
  const std::string at_most = "; at most reach_most_m and free_reach_m";
  CHECK(said_of(R"({"reach_least_m": 0.004})") == "E-CONF-VALUE reach_least_m: 0.004" + at_most);
  CHECK(said_of(R"({"free_reach_m": 0.0001})") == "E-CONF-VALUE reach_least_m: 0.0002" + at_most);
  CHECK(said_of(R"({"reach_least_m": 0.003})").empty());
}

}  // namespace

int main() {
  every_setting_comes_back();
  what_is_no_object_is_refused();
  an_unknown_name_gets_the_nearest();
  a_value_of_another_kind_is_refused();
  a_value_outside_its_range_is_refused();
  reaches_that_contradict_each_other_are_refused();
  return finish();
}
