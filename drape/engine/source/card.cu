// The kernel of a card: frames, a group of threads each.
#include <stddef.h>
#include <stdint.h>

#define ONE_LANE
#include "tasks_one.hpp"

constexpr int MOST_THREADS = 1024;

extern "C" {
__device__ uint64_t drape_records_hash = RECORDS_HASH;

// There are as many groups as the card holds at once, and scratch for each.
__global__ void __launch_bounds__(MOST_THREADS) drape_frames(const FrameTask* tasks, int64_t count) {
  for (int64_t n = blockIdx.x; n < count; n += gridDim.x) draw(tasks + n, blockIdx.x);
}
}
