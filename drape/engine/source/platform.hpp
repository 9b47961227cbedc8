// What the engine takes from its compiler: Clang, without a standard library.
//
// Products are fused with sums only where a formula writes them in one expression (-ffp-contract=on), so the compiler's
// front end decides it, the same way for every processor. Nothing else is reordered: equal bits follow wherever a
// processor has fused products (x86-64-v3 and later, arm64).
#pragma once
#include <stddef.h>
#include <stdint.h>

#if defined(__CUDACC__)  // which has a function of its own for what Clang has built in
#define INLINE static __device__ __forceinline__
#define INLINE_MEMBER __device__ __forceinline__
#define DEVICE static __device__ __noinline__
#define TABLE static __device__ const
#define __builtin_sqrtf sqrtf
#define __builtin_sqrt sqrt
#define __builtin_floor floor
#define __builtin_fabs fabs
#define __builtin_memcpy memcpy
#else
#define INLINE static inline __attribute__((always_inline))
#define INLINE_MEMBER inline __attribute__((always_inline))
#define DEVICE  // code of a card, too
#define TABLE constexpr
#endif
#if defined(_WIN32)
#define EXPORT extern "C" __attribute__((dllexport))
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif

// Returns the processor's clock, in steps of no known length: it serves for shares of a time.
INLINE uint64_t ticks() {
#if defined(__CUDACC__)
  return uint64_t(clock64());
#elif defined(__x86_64__)
  return __builtin_ia32_rdtsc();
#elif defined(__aarch64__)
  uint64_t now;
  asm volatile("mrs %0, cntvct_el0" : "=r"(now));
  return now;
#else
  return 0;
#endif
}

// While one exists, its thread takes subnormal numbers for zero: an operation on those takes a hundred times as long.
struct Flushed {
#if defined(__x86_64__)
  uint32_t before = __builtin_ia32_stmxcsr();
  Flushed() { __builtin_ia32_ldmxcsr(before | 0x8040); }
  ~Flushed() { __builtin_ia32_ldmxcsr(before); }
#elif defined(__aarch64__)
  uint64_t before;
  Flushed() {
    asm volatile("mrs %0, fpcr" : "=r"(before));
    asm volatile("msr fpcr, %0" : : "r"(before | 1 << 24));
  }
  ~Flushed() { asm volatile("msr fpcr, %0" : : "r"(before)); }
#else
  Flushed() {}  // WebAssembly keeps them
#endif
};
