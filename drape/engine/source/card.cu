// The library of a card: its memory, and frames of folds in one launch. What returns a whole number returns 0, or CUDA's
// number of a fault.
#include <stddef.h>
#include <stdint.h>

#define ONE_LANE
#include "tasks_one.hpp"

constexpr int MOST_THREADS = 1024;

static __global__ void __launch_bounds__(MOST_THREADS) fold(const FoldTask* tasks) { draw(tasks[blockIdx.x]); }

extern "C" {
uint64_t drape_records_hash() { return RECORDS_HASH; }

const char* card_fault(int fault) { return cudaGetErrorString(cudaError_t(fault)); }

int card_name(char* name, int64_t size) {
  cudaDeviceProp found;
  const int fault = cudaGetDeviceProperties(&found, 0);
  for (int64_t i = 0; i < size; ++i) name[i] = fault ? 0 : found.name[i];
  return fault;
}

int card_take(uint64_t* address, int64_t bytes) { return cudaMalloc((void**)address, size_t(bytes)); }
int card_return(uint64_t address) { return cudaFree((void*)address); }
int card_write(uint64_t to, const void* from, int64_t bytes) {
  return cudaMemcpy((void*)to, from, size_t(bytes), cudaMemcpyHostToDevice);
}
int card_read(void* to, uint64_t from, int64_t bytes) {
  return cudaMemcpy(to, (const void*)from, size_t(bytes), cudaMemcpyDeviceToHost);
}

// Draws the frames of count tasks, rounds times over, and writes how long that took [ms].
int card_folds(uint64_t tasks, int64_t count, int64_t threads, int64_t rounds, float* took_ms) {
  cudaEvent_t begin, end;
  int fault = cudaEventCreate(&begin);
  if (!fault) fault = cudaEventCreate(&end);
  if (!fault) fault = cudaEventRecord(begin);
  for (int64_t round = 0; round < rounds && !fault; ++round) {
    fold<<<int(count), int(threads)>>>((const FoldTask*)tasks);
    fault = cudaGetLastError();
  }
  if (!fault) fault = cudaEventRecord(end);
  if (!fault) fault = cudaEventSynchronize(end);
  if (!fault) fault = cudaEventElapsedTime(took_ms, begin, end);
  cudaEventDestroy(begin);
  cudaEventDestroy(end);
  return fault;
}
}
