#include <cmath>
#include <limits>
#include <string>

#include "check.h"
#include "error.h"
#include "resample.h"

using namespace palmar;

namespace {

// A hand that moves along x and turns about z; `time_s` and x are the same number.
Sample make_sample(double time_s) {
  Sample sample;
  sample.time_s = time_s;
  sample.pose.palm.position_m = {time_s, 0, 0};
  sample.pose.palm.rotation_wxyz = {std::cos(time_s), 0, 0, std::sin(time_s)};
  sample.pose.flexion_rad[14] = -time_s;
  sample.pose.abduction_rad[4] = 2 * time_s;
  return sample;
}

Trace make_trace(std::initializer_list<double> times) {
  Trace trace;
  for (const double t : times) trace.samples.push_back(make_sample(t));
  return trace;
}

bool same(const Sample& a, const Sample& b) {
  return a.time_s == b.time_s && a.tracked == b.tracked && a.pose.palm.position_m == b.pose.palm.position_m &&
         a.pose.palm.rotation_wxyz == b.pose.palm.rotation_wxyz && a.pose.flexion_rad == b.pose.flexion_rad &&
         a.pose.abduction_rad == b.pose.abduction_rad && a.has_object_pose == b.has_object_pose &&
         a.object.position_m == b.object.position_m && a.object.rotation_wxyz == b.object.rotation_wxyz;
}

std::string code_of(const Trace& trace, const std::string& method, double rate_hz) {
  try {
    Resampler(trace, method, rate_hz);
  } catch (const Error& error) {
    return error.code;
  }
  return "";
}

void trace_on_the_grid_passes_unchanged() {
  for (const char* method : {"hold", "linear", "pchip"}) {
    for (const double start : {0.0, 0.123456789, 1.7e9}) {
      Trace trace;
      for (int i = 0; i < 500; ++i) {
        Sample sample = make_sample(i * 0.37);
        sample.time_s = start + i * 0.001;  // not the same doubles as i / 1000
        if (i % 2) sample.pose.palm.rotation_wxyz = {-0.6, 0.0, 0.8, 0.0};
        sample.has_object_pose = true;
        sample.object = make_sample(i * 0.11).pose.palm;
        trace.samples.push_back(sample);
      }
      const Resampler resampler(trace, method, 1000);
      CHECK(resampler.size() == 500);
      bool all = resampler.size() == 500;
      for (std::size_t i = 0; all && i < 500; ++i) all = same(resampler.at(i), trace.samples[i]);
      CHECK(all);
    }
  }
}

void grid_runs_from_first_to_last_sample() {
  const Resampler resampler(make_trace({0.5, 0.51, 0.5305}), "linear", 1000);
  CHECK(resampler.size() == 31);
  CHECK(resampler.at(0).time_s == 0.5);
  CHECK_NEAR(resampler.at(30).time_s, 0.53, 1e-15);  // one rounding of a sum below 1
  CHECK(Resampler(make_trace({3.0}), "pchip", 1000).size() == 1);
  CHECK(same(Resampler(make_trace({3.0}), "pchip", 1000).at(0), make_sample(3.0)));
}

void straight_motion_stays_straight() {
  const Trace trace = make_trace({0, 0.01, 0.035, 0.04, 0.09});
  for (const char* method : {"linear", "pchip"}) {
    const Resampler resampler(trace, method, 1000);
    for (std::size_t i = 0; i < resampler.size(); ++i) {
      const Sample s = resampler.at(i);
      const double t = s.time_s;
      // 1e-15: a few roundings of numbers below 1.
      CHECK_NEAR(s.pose.palm.position_m[0], t, 1e-15);
      CHECK_NEAR(s.pose.flexion_rad[14], -t, 1e-15);
      CHECK_NEAR(s.pose.abduction_rad[4], 2 * t, 1e-15);
      CHECK_NEAR(s.pose.palm.rotation_wxyz[0], std::cos(t), 1e-14);  // sines over a small angle lose a digit
      CHECK_NEAR(s.pose.palm.rotation_wxyz[3], std::sin(t), 1e-14);
    }
  }
}

void hold_gives_the_last_sample() {
  const Resampler resampler(make_trace({0, 0.0101, 0.02}), "hold", 1000);
  CHECK(resampler.at(10).pose.palm.position_m[0] == 0);
  CHECK(resampler.at(11).pose.palm.position_m[0] == 0.0101);
  CHECK(resampler.at(19).pose.palm.position_m[0] == 0.0101);
  CHECK(resampler.at(20).pose.palm.position_m[0] == 0.02);
}

void rotation_takes_the_short_way_whatever_the_signs() {
  Trace trace = make_trace({0, 0.01, 0.02, 0.03});
  for (const int i : {1, 2})
    for (double& x : trace.samples[i].pose.palm.rotation_wxyz) x = -x;
  for (const char* method : {"linear", "pchip"}) {
    const Resampler resampler(trace, method, 1000);
    for (std::size_t i = 0; i < resampler.size(); ++i)
      CHECK_NEAR(resampler.at(i).pose.palm.rotation_wxyz[0], std::cos(resampler.at(i).time_s), 1e-14);
  }
}

void lost_tracking_is_held_and_said() {
  for (const char* method : {"hold", "linear", "pchip"}) {
    Trace trace = make_trace({0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06});
    for (const std::size_t i : {0, 3, 4, 6}) {
      trace.samples[i].tracked = false;
      trace.samples[i].pose.palm = {{9, 9, 9}, {0, 0, 0, 0}};
    }
    const Resampler resampler(trace, method, 1000);
    for (std::size_t i = 0; i < resampler.size(); ++i) {
      const Sample s = resampler.at(i);
      const double x = s.pose.palm.position_m[0];
      if (i < 10) CHECK(!s.tracked && x == 0.01);  // nothing known yet: the first good pose
      if (i >= 20 && i < 50) CHECK(x == 0.02);     // no way is made up across the loss
      // How long the last sample had been held when the device said that the hand was lost.
      if (i >= 30 && i < 50) CHECK_NEAR(s.held_s, 0.01, 1e-15);
      if (i >= 20 && i < 30) CHECK(s.tracked);  // the device has not said so yet
      if (i >= 30 && i < 50) CHECK(!s.tracked);
      if (i >= 50 && i < 60) CHECK(s.tracked && x == 0.05);
      if (i == 60) CHECK(!s.tracked && x == 0.05);
    }
  }
}

// Ten samples, a second without any, ten samples: the device is silent after `held_ms`, and not before.
void silent_device_is_untracked(double rate_hz, std::size_t held_ms) {
  Trace trace;
  for (int i = 0; i < 20; ++i) trace.samples.push_back(make_sample((i < 10 ? i : i + rate_hz) / rate_hz));
  for (const char* method : {"hold", "linear", "pchip"}) {
    const Resampler resampler(trace, method, 1000);
    const double last_s = trace.samples[9].time_s, again_s = trace.samples[10].time_s;
    for (std::size_t i = 0; i < resampler.size(); ++i) {
      const Sample s = resampler.at(i);
      const double since_s = s.time_s - last_s;
      const bool lost = since_s > 1e-3 * static_cast<double>(held_ms) + 1e-9 && s.time_s < again_s - 1e-9;
      CHECK(s.tracked == !lost);
      CHECK(s.held_s == (lost ? resampler.hold_s() : 0));
      if (since_s >= 0 && s.time_s < again_s - 1e-9) CHECK(s.pose.palm.position_m[0] == last_s);
    }
    CHECK_NEAR(resampler.hold_s(), 1e-3 * static_cast<double>(held_ms), 1e-12);
  }
}

void silence_is_told_by_the_stream_s_own_rate() {
  silent_device_is_untracked(1000, 50);  // half of the time in which a force has to be gone
  silent_device_is_untracked(60, 50);
  silent_device_is_untracked(25, 70);  // 1.75 of its intervals
  silent_device_is_untracked(10, 100);
}

// A stream that is slow, jitters by 30 % and loses one sample in five where an interval is short: no gap to speak of.
void ordinary_streams_have_no_gap() {
  for (const double rate_hz : {20.0, 30.0, 60.0, 90.0, 115.0}) {
    Trace trace;
    for (int i = 0; i < 100; ++i) {
      if (rate_hz >= 60 && i % 5 == 3) continue;
      trace.samples.push_back(make_sample((i + (i % 2 ? 0.3 : 0)) / rate_hz));
    }
    const Resampler resampler(trace, "pchip", 1000);
    for (std::size_t i = 0; i < resampler.size(); ++i) CHECK(resampler.at(i).tracked);
  }
}

void object_pose_is_held_where_it_is_not_given() {
  Trace trace = make_trace({0, 0.01, 0.02, 0.03, 0.04});
  for (const std::size_t i : {1, 2, 4}) {
    trace.samples[i].has_object_pose = true;
    trace.samples[i].object = trace.samples[i].pose.palm;
  }
  const Resampler resampler(trace, "linear", 1000);
  for (std::size_t i = 0; i < resampler.size(); ++i) {
    const double x = resampler.at(i).object.position_m[0];
    CHECK(resampler.at(i).has_object_pose);
    if (i < 10) CHECK(x == 0.01);
    if (i >= 10 && i < 20) CHECK_NEAR(x, resampler.at(i).time_s, 1e-15);
    if (i >= 20 && i < 40) CHECK(x == 0.02);
    if (i == 40) CHECK(x == 0.04);
  }
  CHECK(!Resampler(make_trace({0, 1}), "linear", 1000).at(500).has_object_pose);
}

void wrong_wishes_are_refused() {
  const Trace trace = make_trace({0, 0.01});
  CHECK(code_of(trace, "cubic", 1000) == "E-CONF");
  CHECK(code_of(trace, "pchip", 0) == "E-CONF");
  CHECK(code_of(trace, "pchip", std::numeric_limits<double>::quiet_NaN()) == "E-CONF");
  CHECK(code_of(make_trace({0, 0}), "pchip", 1000) == "E-TRACE-TIME");
  CHECK(code_of(make_trace({0, 1e6}), "pchip", 1000) == "E-TRACE-TIME");
  CHECK(code_of({}, "pchip", 1000) == "E-TRACE-EMPTY");
  Trace lost = trace;
  for (Sample& sample : lost.samples) sample.tracked = false;
  CHECK(code_of(lost, "hold", 1000) == "E-TRACE-EMPTY");
}

}  // namespace

int main() {
  trace_on_the_grid_passes_unchanged();
  grid_runs_from_first_to_last_sample();
  straight_motion_stays_straight();
  hold_gives_the_last_sample();
  rotation_takes_the_short_way_whatever_the_signs();
  lost_tracking_is_held_and_said();
  silence_is_told_by_the_stream_s_own_rate();
  ordinary_streams_have_no_gap();
  object_pose_is_held_where_it_is_not_given();
  wrong_wishes_are_refused();
  return finish();
}
