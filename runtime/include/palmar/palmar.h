/* Palmar's C interface: step a virtual hand against an object, from any host's frame loop.
 *
 * Units are SI: metres, radians, seconds, newtons. A quaternion is unit, ordered w x y z. Fingers are ordered thumb,
 * index, middle, ring, little; joints from the palm outwards (MCP, PIP, DIP). A link is 0 for the palm, 1 + 3 finger +
 * phalanx else.
 *
 * A sample, a result, a recording and its counts begin with their own size in bytes: set it to sizeof(the struct), and
 * a host built against another header is refused instead of misread. Functions that can fail return a palmar_code and
 * write one line for a person into `message`. One session belongs to one thread at a time; different sessions are
 * independent. */
#ifndef PALMAR_H
#define PALMAR_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define PALMAR_API __attribute__((visibility("default")))

typedef enum palmar_code {
  PALMAR_OK = 0,
  PALMAR_BAD_INPUT = 2, /* the message begins with a code such as E-PACK-SHAPE */
  PALMAR_LOSS = 3,      /* of a recorder: samples are missing from the file; the counts say how many */
  PALMAR_BUG = 70       /* an error of Palmar's own */
} palmar_code;

/* Bits of palmar_result.status; 0 is the plain answer. */
enum {
  PALMAR_RECOVERING = 1,      /* the hand started inside the object */
  PALMAR_ITERATION_LIMIT = 2, /* the operation budget ended before the pose converged */
  PALMAR_YIELDED = 4,         /* a finger was blocked and the palm, the wrist or an abduction gave way */
  PALMAR_KEPT_PREVIOUS = 8,   /* no better pose could be verified */
  PALMAR_BAD_SAMPLE = 16,     /* the sample was not usable; the last good one stays */
  PALMAR_LIMIT = 32,          /* a joint limit clipped the sample */
  PALMAR_RELEASING = 64,      /* the hand was left behind and is led round the object; no force */
  PALMAR_CONTACTS_CUT = 128   /* the step's list of contacts has no room for all of them */
};

typedef struct palmar_placement {
  double position_m[3];
  double rotation_wxyz[4];
} palmar_placement;

typedef struct palmar_pose {
  palmar_placement palm; /* world from palm */
  double flexion_rad[15];
  double abduction_rad[5];
} palmar_pose;

typedef struct palmar_sample {
  uint32_t size;
  uint32_t tracked; /* 0: the device had lost the hand */
  double time_s;
  palmar_pose haptic;
  uint32_t has_object_pose;
  uint32_t reserved;
  palmar_placement object; /* world from object; ignored unless has_object_pose */
} palmar_sample;

typedef struct palmar_contact {
  uint32_t link;
  uint32_t object_sphere; /* leaf index */
  uint32_t palm_sphere;   /* 4294967295 for a phalanx */
  uint32_t reserved;
  double gap_m;
  double force_n;
  double point_m[3]; /* world, on the hand's surface */
  double normal[3];  /* world, from the object to the hand */
} palmar_contact;

typedef struct palmar_result {
  uint32_t size;
  uint32_t status;
  double time_s;
  palmar_pose graphic;
  double palm_force_n[3]; /* on the user: G (graphic - haptic) */
  double palm_torque_n_m[3];
  double joint_torque_n_m[15];
  double fingertip_force_n[15]; /* 5 x 3 */
  uint32_t contacts;
  uint32_t operations;
  uint64_t state_hash;
} palmar_result;

typedef struct palmar_session palmar_session;

/* "major.minor.patch" */
PALMAR_API const char* palmar_version(void);

/* Opens a pack's hand and one object (NULL or "" for the only one) with settings as JSON text (NULL for the defaults;
 * unknown keys are errors). On success *session is for palmar_close. Allocates all that stepping needs. */
PALMAR_API palmar_code palmar_open(const char* pack_path, const char* object, const char* settings_json,
                                   palmar_session** session, char* message, size_t message_size);

/* One step. Does not allocate, lock or call the system. A sample that cannot be used leaves the hand where it is. */
PALMAR_API palmar_code palmar_step(palmar_session* session, const palmar_sample* sample, palmar_result* result);

/* Contacts of the last step: copies at most `capacity`, returns how many there are. */
PALMAR_API uint32_t palmar_contacts(const palmar_session* session, palmar_contact* contacts, uint32_t capacity);

PALMAR_API void palmar_close(palmar_session* session);

/* What a trace says of itself. Texts are UTF-8. */
typedef struct palmar_recording {
  uint32_t size;
  uint32_t ring_samples; /* how many may wait for the disk: 16 to 1048576, 0 for 4096; each takes 320 bytes */
  const char* device;    /* what measured the hand */
  const char* hand;      /* name of the hand model that the angles are of */
  const char* side;      /* "right" or "left" */
  const char* object;    /* NULL if there is none */
  double rate_hz;        /* nominal; 0 if there is none */
} palmar_recording;

typedef struct palmar_recorder_counts {
  uint32_t size;
  uint32_t failed;  /* 1: the disk does not take more; palmar_recorder_close says why */
  uint64_t taken;   /* by palmar_recorder_append */
  uint64_t written; /* of those, in the file, where they survive the death of the host */
  uint64_t dropped; /* there was no room: the disk was slower than the ring is long, or has failed */
  uint64_t refused; /* not finite, not a rotation, or the time did not rise */
} palmar_recorder_counts;

typedef struct palmar_recorder palmar_recorder;

/* Begins a trace at `path`, which must not exist, and a thread that writes it. Whatever happens to the host, the file
 * holds all samples but those of the last 0.25 s. */
PALMAR_API palmar_code palmar_recorder_open(const char* path, const palmar_recording* recording,
                                            palmar_recorder** recorder, char* message, size_t message_size);

/* Takes one sample, from one thread. Does not wait, allocate, lock or call the system. PALMAR_LOSS: dropped;
 * PALMAR_BAD_INPUT: refused. Of a sample that is not tracked no pose is kept. */
PALMAR_API palmar_code palmar_recorder_append(palmar_recorder* recorder, const palmar_sample* sample);

/* From any thread, at any time before palmar_recorder_close. */
PALMAR_API palmar_code palmar_recorder_count(const palmar_recorder* recorder, palmar_recorder_counts* counts);

/* Writes what waits, ends the file and frees the recorder, whatever the answer. `counts` may be NULL. PALMAR_LOSS if
 * any sample was dropped or refused; PALMAR_BAD_INPUT if the disk failed: the file then holds `written` samples. */
PALMAR_API palmar_code palmar_recorder_close(palmar_recorder* recorder, palmar_recorder_counts* counts, char* message,
                                             size_t message_size);

#ifdef __cplusplus
}
#endif

#endif /* PALMAR_H */
