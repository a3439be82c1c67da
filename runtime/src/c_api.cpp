#include <palmar/palmar.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <exception>

#include "error.h"
#include "pack_file.h"
#include "session.h"
#include "settings.h"

struct palmar_session {
  palmar::Session session;
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
  try {
    const Settings settings = parse_settings(settings_json ? settings_json : "{}");
    const AssetPack pack = read_pack(pack_path);
    const auto& spheres = find_level(pack, pack_path, object ? object : "", settings.level);
    *session = new palmar_session{Session(pack.hand, spheres, settings)};
    say(message, message_size, "");
    return PALMAR_OK;
  } catch (const Error& error) {
    say(message, message_size, error.what());
    return PALMAR_BAD_INPUT;
  } catch (const std::exception& error) {
    say(message, message_size, error.what());
    return PALMAR_BUG;
  }
}

palmar_code palmar_step(palmar_session* session, const palmar_sample* in, palmar_result* out) {
  if (!session || !in || !out || in->size != sizeof(palmar_sample) || out->size != sizeof(palmar_result))
    return PALMAR_BAD_INPUT;
  Sample sample;
  sample.time_s = in->time_s;
  sample.tracked = in->tracked != 0;
  copy(sample.pose.palm.position_m, in->haptic.palm.position_m);
  copy(sample.pose.palm.rotation_wxyz, in->haptic.palm.rotation_wxyz);
  copy(sample.pose.flexion_rad, in->haptic.flexion_rad);
  copy(sample.pose.abduction_rad, in->haptic.abduction_rad);
  if (in->has_object_pose) {
    sample.has_object_pose = true;
    copy(sample.object.position_m, in->object.position_m);
    copy(sample.object.rotation_wxyz, in->object.rotation_wxyz);
  }
  const StepResult& r = session->session.step(sample);
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

}  // extern "C"
