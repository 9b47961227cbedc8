// The kernels of a card: frames of folds, a group of threads each.
#include <stddef.h>
#include <stdint.h>

#define ONE_LANE
#include "tasks_one.hpp"

constexpr int MOST_THREADS = 1024;

extern "C" {
__device__ uint64_t drape_records_hash = RECORDS_HASH;

__global__ void __launch_bounds__(MOST_THREADS) drape_folds(const FoldTask* tasks) { draw(tasks[blockIdx.x]); }
}
