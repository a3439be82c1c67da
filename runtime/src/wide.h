// How a loop over many numbers is compiled.
#pragma once

// One source, the instruction set chosen when the program starts. Element-wise IEEE operations in a fixed order, so
// each build gives the same bits; a test defines PALMAR_WIDE itself, for one set after the other, and compares.
#ifndef PALMAR_WIDE
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define PALMAR_WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define PALMAR_WIDE
#endif
#endif
