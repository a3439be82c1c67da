/* A host in plain C: opens a pack, steps the hand once a frame, and reads poses, contacts and forces back. */
#include <inttypes.h>
#include <palmar/palmar.h>
#include <stdio.h>
#include <string.h>

/* The device's part: an open hand comes down on the object, 200 mm in a second, and stays. */
static palmar_sample read_device(int frame) {
  palmar_sample sample;
  memset(&sample, 0, sizeof sample);
  sample.size = sizeof sample;
  sample.tracked = 1;
  sample.time_s = 0.001 * frame;
  sample.haptic.palm.position_m[1] = -0.045;
  sample.haptic.palm.position_m[2] = 0.22 - 0.0002 * (frame < 1000 ? frame : 1000);
  sample.haptic.palm.rotation_wxyz[0] = 1;
  return sample;
}

int main(int argc, char** argv) {
  char message[256] = "";
  palmar_session* session = NULL;
  printf("palmar %s\n", palmar_version());
  if (palmar_open(argc > 1 ? argv[1] : "absent.pack", NULL, "{\"rate_hz\": 1000}", &session, message, sizeof message) !=
      PALMAR_OK) {
    printf("%s\n", message);
    return 1;
  }

  /* The frame loop: pose in; pose, forces and contacts out. Nothing in it allocates or waits. */
  palmar_result result;
  palmar_contact contacts[64];
  memset(&result, 0, sizeof result);
  result.size = sizeof result;
  for (int frame = 0; frame < 1500; ++frame) {
    const palmar_sample sample = read_device(frame);
    if (palmar_step(session, &sample, &result) != PALMAR_OK) return 1;
    const uint32_t touching = palmar_contacts(session, contacts, 64);
    /* draw(result.graphic); render_force(result.palm_force_n, result.fingertip_force_n); */
    if (frame % 250 == 249)
      printf("%.3f s: palm at %.6f m, %" PRIu32 " contacts, force %.3f N\n", result.time_s,
             result.graphic.palm.position_m[2], touching, result.palm_force_n[2]);
  }
  printf("state %016" PRIx64 ", nearest gap %.1e m\n", result.state_hash, contacts[0].gap_m);
  palmar_close(session);
  return 0;
}
