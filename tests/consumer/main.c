/* A host in plain C: says the version, and gets one line for a pack that is not there. */
#include <palmar/palmar.h>
#include <stdio.h>

int main(void) {
  char message[256] = "";
  palmar_session* session = NULL;
  const palmar_code code = palmar_open("absent.pack", NULL, NULL, &session, message, sizeof message);
  printf("%s\n%d\n%s\n", palmar_version(), (int)code, message);
  return 0;
}
