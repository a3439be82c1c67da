/* A host that records its hand in plain C: record FILE [FRAMES]. One frame a millisecond, for ever without FRAMES. */
#define _POSIX_C_SOURCE 200809L
#include <inttypes.h>
#include <palmar/palmar.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* The device's part: a hand that goes up and closes by and by. */
static palmar_sample read_device(long frame) {
  palmar_sample sample;
  memset(&sample, 0, sizeof sample);
  sample.size = sizeof sample;
  sample.tracked = 1;
  sample.time_s = 0.001 * (double)frame;
  sample.haptic.palm.position_m[2] = 1e-6 * (double)frame;
  sample.haptic.palm.rotation_wxyz[0] = 1;
  for (int i = 0; i < 15; ++i) sample.haptic.flexion_rad[i] = 1e-3 * (double)(frame % 1000);
  return sample;
}

static void wait_for_frame(struct timespec* next) {
  next->tv_nsec += 1000000;
  if (next->tv_nsec >= 1000000000) {
    next->tv_nsec -= 1000000000;
    ++next->tv_sec;
  }
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, next, NULL) != 0) {
  }
}

int main(int argc, char** argv) {
  char message[256] = "";
  palmar_recording recording;
  memset(&recording, 0, sizeof recording);
  recording.size = sizeof recording;
  recording.device = "example";
  recording.hand = "default";
  recording.side = "right";
  recording.rate_hz = 1000;
  palmar_recorder* recorder = NULL;
  if (argc < 2 || palmar_recorder_open(argv[1], &recording, &recorder, message, sizeof message) != PALMAR_OK) {
    printf("%s\n", argc < 2 ? "record FILE [FRAMES]" : message);
    return 2;
  }

  /* The frame loop: append never waits for the disk. What it could not take is counted. */
  palmar_recorder_counts counts;
  counts.size = sizeof counts;
  struct timespec next;
  clock_gettime(CLOCK_MONOTONIC, &next);
  const long frames = argc > 2 ? atol(argv[2]) : -1;
  for (long frame = 0; frame != frames; ++frame) {
    const palmar_sample sample = read_device(frame);
    palmar_recorder_append(recorder, &sample);
    if (frame % 10 == 9 && palmar_recorder_count(recorder, &counts) == PALMAR_OK) {
      printf("%" PRIu64 " taken, %" PRIu64 " written\n", counts.taken, counts.written);
      fflush(stdout);
    }
    wait_for_frame(&next);
  }

  const palmar_code code = palmar_recorder_close(recorder, &counts, message, sizeof message);
  printf("%" PRIu64 " written, %" PRIu64 " dropped, %" PRIu64 " refused%s%s\n", counts.written, counts.dropped,
         counts.refused, message[0] ? ": " : "", message);
  return (int)code;
}
