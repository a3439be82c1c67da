#include <palmar/palmar.h>

#include <algorithm>
#include <cstdio>
#include <exception>
#include <new>

#include "error.h"
#include "pack_file.h"
#include "recorder.h"
#include "session.h"
#include "settings.h"

struct palmar_session {
  palmar::Session session;
};

struct palmar_recorder {
  palmar::Recorder recorder;
};

namespace {

using namespace palmar;

void say(char* message, size_t size, const char* text) {
  if (message && size > 0) std::snprintf(message, size, "%s", text);
}

template <std::size_t N>
void copy(std::array<double, N>& to, const double (&from)[N]) {
  std::copy_n(from, N, to.begin());
}

template <std::size_t N>
void copy(double (&to)[N], const std::array<double, N>& from) {
  std::copy_n(from.begin(), N, to);
}

Sample sample_from(const palmar_sample& in) {
  Sample sample;
  sample.time_s = in.time_s;
  sample.tracked = in.tracked != 0;
  copy(sample.pose.palm.position_m, in.haptic.palm.position_m);
  copy(sample.pose.palm.rotation_wxyz, in.haptic.palm.rotation_wxyz);
  copy(sample.pose.flexion_rad, in.haptic.flexion_rad);
  copy(sample.pose.abduction_rad, in.haptic.abduction_rad);
  if (in.has_object_pose) {
    sample.has_object_pose = true;
    copy(sample.object.position_m, in.object.position_m);
    copy(sample.object.rotation_wxyz, in.object.rotation_wxyz);
  }
  return sample;
}

Header header_from(const palmar_recording& in) {
  Header header{{"device", in.device}, {"hand", in.hand}, {"side", in.side}};
  if (in.object) header["object"] = in.object;
  if (in.rate_hz != 0) {
    if (!(in.rate_hz > 0 && in.rate_hz <= 1e6))
      throw Error("E-CONF-VALUE", "rate_hz",
                  std::to_string(in.rate_hz) + "; above 0 to 1e6, or 0 for none, is allowed");
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.9g", in.rate_hz);
    header["rate_hz"] = digits;
  }
  return header;
}

palmar_recorder_counts counts_from(const Recorder::Counts& counts) {
  return {sizeof(palmar_recorder_counts), counts.failed, counts.taken, counts.written, counts.dropped, counts.refused};
}

// Runs `work`, which throws what is wrong, and says it.
template <class Work>
palmar_code answer(char* message, size_t message_size, Work work) {
  try {
    say(message, message_size, "");
    return work();
  } catch (const Error& error) {
    say(message, message_size, error.what());
    return PALMAR_BAD_INPUT;
  } catch (const std::bad_alloc&) {
    say(message, message_size, "E-MEMORY palmar: the system gives no more memory");
    return PALMAR_BAD_INPUT;
  } catch (const std::exception& error) {
    say(message, message_size, error.what());
    return PALMAR_BUG;
  }
}

}  // namespace

extern "C" {

const char* palmar_version(void) { return PALMAR_VERSION; }

palmar_code palmar_open(const char* pack_path, const char* object, const char* settings_json, palmar_session** session,
                        char* message, size_t message_size) {
  if (!pack_path || !session) {
    say(message, message_size, "E-CONF-VALUE pack_path, session: a null pointer; both are needed");
    return PALMAR_BAD_INPUT;
  }
  *session = nullptr;
  return answer(message, message_size, [&] {
    const Settings settings = parse_settings(settings_json ? settings_json : "{}");
    const AssetPack pack = read_pack(pack_path);
    const auto& spheres = find_level(pack, pack_path, object ? object : "", settings.level);
    *session = new palmar_session{Session(pack.hand, spheres, settings)};
    return PALMAR_OK;
  });
}

palmar_code palmar_step(palmar_session* session, const palmar_sample* in, palmar_result* out) {
  if (!session || !in || !out || in->size != sizeof(palmar_sample) || out->size != sizeof(palmar_result))
    return PALMAR_BAD_INPUT;
  const StepResult& r = session->session.step(sample_from(*in));
  out->status = r.status;
  out->time_s = r.time_s;
  copy(out->graphic.palm.position_m, r.graphic.palm.position_m);
  copy(out->graphic.palm.rotation_wxyz, r.graphic.palm.rotation_wxyz);
  copy(out->graphic.flexion_rad, r.graphic.flexion_rad);
  copy(out->graphic.abduction_rad, r.graphic.abduction_rad);
  copy(out->palm_force_n, r.palm_force_n);
  copy(out->palm_torque_n_m, r.palm_torque_n_m);
  copy(out->joint_torque_n_m, r.joint_torque_n_m);
  copy(out->fingertip_force_n, r.fingertip_force_n);
  out->contacts = r.contacts;
  out->operations = r.operations;
  out->state_hash = r.state_hash;
  return PALMAR_OK;
}

uint32_t palmar_contacts(const palmar_session* session, palmar_contact* contacts, uint32_t capacity) {
  if (!session) return 0;
  const auto found = session->session.contacts();
  for (uint32_t i = 0; contacts && i < std::min<std::size_t>(capacity, found.size()); ++i) {
    const Contact& c = found[i];
    contacts[i] = {c.link, c.object_sphere, c.palm_sphere, 0, c.gap_m, c.force_n, {}, {}};
    copy(contacts[i].point_m, c.point_m);
    copy(contacts[i].normal, c.normal);
  }
  return uint32_t(found.size());
}

void palmar_close(palmar_session* session) { delete session; }

palmar_code palmar_recorder_open(const char* path, const palmar_recording* recording, palmar_recorder** recorder,
                                 char* message, size_t message_size) {
  if (recorder) *recorder = nullptr;
  if (!path || !recorder || !recording || recording->size != sizeof *recording) {
    say(message, message_size,
        "E-CONF-VALUE path, recording, recorder: a null pointer or another size; all are needed");
    return PALMAR_BAD_INPUT;
  }
  if (!recording->device || !recording->hand || !recording->side) {
    say(message, message_size, "E-CONF-VALUE device, hand, side: a null pointer; all are needed");
    return PALMAR_BAD_INPUT;
  }
  return answer(message, message_size, [&] {
    const std::size_t ring_samples = recording->ring_samples ? recording->ring_samples : 4096;
    *recorder = new palmar_recorder{{path, header_from(*recording), ring_samples}};
    return PALMAR_OK;
  });
}

palmar_code palmar_recorder_append(palmar_recorder* recorder, const palmar_sample* sample) {
  if (!recorder || !sample || sample->size != sizeof *sample) return PALMAR_BAD_INPUT;
  switch (recorder->recorder.append(sample_from(*sample))) {
    case Recorder::Taken::kYes:
      return PALMAR_OK;
    case Recorder::Taken::kNoRoom:
      return PALMAR_LOSS;
    default:
      return PALMAR_BAD_INPUT;
  }
}

palmar_code palmar_recorder_count(const palmar_recorder* recorder, palmar_recorder_counts* counts) {
  if (!recorder || !counts || counts->size != sizeof *counts) return PALMAR_BAD_INPUT;
  *counts = counts_from(recorder->recorder.counts());
  return PALMAR_OK;
}

palmar_code palmar_recorder_close(palmar_recorder* recorder, palmar_recorder_counts* counts, char* message,
                                  size_t message_size) {
  if (!recorder || (counts && counts->size != sizeof *counts)) {
    say(message, message_size, "E-CONF-VALUE recorder, counts: a null pointer or another size");
    return PALMAR_BAD_INPUT;
  }
  const palmar_code code = answer(message, message_size, [&] {
    const Recorder::Counts end = recorder->recorder.close();
    return end.dropped + end.refused > 0 ? PALMAR_LOSS : PALMAR_OK;
  });
  if (counts) *counts = counts_from(recorder->recorder.counts());
  delete recorder;
  return code;
}

}  // extern "C"
