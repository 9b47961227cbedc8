// A driver of NVIDIA's that has no card: its entry points over this machine's memory. Launches are given to frames,
// which tests set to the engine's emulation of threads. A call fails, or stops for a while, on command.
// It needs no library of C++, which the compiler would first have to compile for a minute.
#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

namespace {
struct State {
  int version = 13000, cards = 1, major = 9, minor = 0;
  uint64_t free_bytes = uint64_t(8) << 30, hash = 0;
  void (*frames)(uint64_t tasks, int64_t count, int64_t threads, int64_t backwards) = nullptr;
  int64_t backwards = 0, after = 0, launches = 0;
  int code = 0;
  double stops_s = 0;
  char failing[40] = "";
  int device = -1;  // that fails; any
} state;
thread_local int current = 0;
pthread_mutex_t emulating = PTHREAD_MUTEX_INITIALIZER;  // one launch at a time: emulated threads have one number

int called(const char* name) {
  if (strcmp(state.failing, name) || (state.device >= 0 && state.device != current) || state.after-- > 0) return 0;
  const timespec stop{time_t(state.stops_s), long(1e9 * (state.stops_s - double(time_t(state.stops_s))))};
  nanosleep(&stop, nullptr);
  state.after = 0;  // and from now on
  return state.code;
}
}  // namespace

#define CALL(name) \
  if (const int fault = called(#name)) return fault;

extern "C" {
void shim_reset() { state = State(); }
void shim_set(int version, int cards, int major, uint64_t free_bytes, uint64_t hash) {
  state.version = version, state.cards = cards, state.major = major, state.free_bytes = free_bytes, state.hash = hash;
}
void shim_draws_by(void (*frames)(uint64_t, int64_t, int64_t, int64_t), int64_t backwards) {
  state.frames = frames, state.backwards = backwards;
}
// The call of this name returns the code once it has been made so often, after so many seconds.
void shim_fails(const char* name, int code, int64_t after, double stops_s, int device) {
  strncpy(state.failing, name, sizeof state.failing - 1);
  state.code = code, state.after = after, state.stops_s = stops_s, state.device = device;
}
int64_t shim_launches() { return state.launches; }

int cuInit(unsigned) { CALL(cuInit) return 0; }
int cuDriverGetVersion(int* version) { *version = state.version; return 0; }
int cuDeviceGetCount(int* count) { *count = state.cards; return 0; }
int cuDeviceGet(int* device, int number) { *device = number; return 0; }
int cuDeviceGetName(char* name, int size, int) { strncpy(name, "Card of paper", size_t(size)); return 0; }
int cuDeviceGetAttribute(int* value, int which, int) {
  *value = which == 75 ? state.major : which == 76 ? state.minor : 4;
  return 0;
}
int cuDevicePrimaryCtxRetain(void** context, int device) { *context = (void*)(uint64_t(device) + 1); return 0; }
int cuCtxSetCurrent(void* context) { current = int(uint64_t(context)) - 1; return 0; }
int cuMemGetInfo_v2(size_t* free_bytes, size_t* whole) { *free_bytes = *whole = state.free_bytes; return 0; }
int cuMemAlloc_v2(uint64_t* address, size_t bytes) {
  CALL(cuMemAlloc_v2)
  *address = uint64_t(calloc(bytes, 1));
  return 0;
}
int cuMemcpyHtoD_v2(uint64_t to, const void* from, size_t bytes) {
  CALL(cuMemcpyHtoD_v2)
  memcpy((void*)to, from, bytes);
  return 0;
}
int cuMemcpyDtoH_v2(void* to, uint64_t from, size_t bytes) {
  CALL(cuMemcpyDtoH_v2)
  memcpy(to, (const void*)from, bytes);
  return 0;
}
int cuModuleLoadData(void** module, const void*) { CALL(cuModuleLoadData) *module = &state; return 0; }
int cuModuleGetGlobal_v2(uint64_t* address, size_t* bytes, void*, const char*) {
  *address = uint64_t(&state.hash), *bytes = 8;
  return 0;
}
int cuModuleGetFunction(void** function, void*, const char*) { *function = &state.frames; return 0; }
int cuLaunchKernel(void*, unsigned, unsigned, unsigned, unsigned threads, unsigned, unsigned, unsigned, void*,
                   void** given, void**) {
  CALL(cuLaunchKernel)
  pthread_mutex_lock(&emulating);
  ++state.launches;
  state.frames(*(const uint64_t*)given[0], *(const int64_t*)given[1], threads, state.backwards);
  pthread_mutex_unlock(&emulating);
  return 0;
}
int cuEventCreate(void** event, unsigned) { *event = &state; return 0; }
int cuEventRecord(void*, void*) { return 0; }
int cuEventSynchronize(void*) { CALL(cuEventSynchronize) return 0; }
int cuEventElapsedTime(float* ms, void*, void*) { *ms = 1; return 0; }
int cuEventDestroy_v2(void*) { return 0; }
int cuGetErrorString(int fault, const char** told) {
  *told = fault == 719 ? "unspecified launch failure" : fault == 2 ? "out of memory" : "a fault of the shim's";
  return 0;
}
}
