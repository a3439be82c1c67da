// Work that threads share.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace palmar {

// Threads that the machine runs at once, eight at most: more wait for memory.
inline int processors() { return int(std::clamp(std::thread::hardware_concurrency(), 1u, 8u)); }

// work(k) for every k below count, in any order and at once: each must write to what is its own alone, so that the
// result is the same for any number of threads.
template <class Work>
void in_parallel(int threads, std::size_t count, const Work& work) {
  std::atomic<std::size_t> next{0};
  const auto share = [&] {
    for (std::size_t k = next++; k < count; k = next++) work(k);
  };
  std::vector<std::thread> others;
  for (std::size_t thread = 1; thread < std::min(std::size_t(threads), count); ++thread) others.emplace_back(share);
  share();
  for (std::thread& other : others) other.join();
}

}  // namespace palmar
