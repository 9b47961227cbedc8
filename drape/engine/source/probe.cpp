// What this processor has, asked of itself: compiled for any x86-64 and arm64, so that it can be loaded before an engine is
// chosen.
#include "platform.hpp"

#if defined(__x86_64__)
struct Registers { uint32_t a, b, c, d; };
static Registers asked(uint32_t leaf, uint32_t part) {
  Registers r;
  __asm__ volatile("cpuid" : "=a"(r.a), "=b"(r.b), "=c"(r.c), "=d"(r.d) : "a"(leaf), "c"(part));
  return r;
}
static bool has(uint32_t word, uint32_t bits) { return (word & bits) == bits; }

// The level of x86-64 that processor and system support, 1 to 4, and 16 more where there are tiles for numbers of 16 bits.
EXPORT int drape_processor() {
  if (asked(0, 0).a < 7) return 1;
  const Registers one = asked(1, 0), seven = asked(7, 0), more = asked(0x80000001, 0);
  const uint32_t sse42 = 1u << 20, ssse3 = 1u << 9, sse41 = 1u << 19, popcnt = 1u << 23, cx16 = 1u << 13;
  if (!has(one.c, sse42 | ssse3 | sse41 | popcnt | cx16)) return 1;
  const uint32_t osxsave = 1u << 27, avx = 1u << 28, fma = 1u << 12, f16c = 1u << 29, movbe = 1u << 22;
  if (!has(one.c, osxsave | avx | fma | f16c | movbe)) return 2;
  uint32_t kept, kept_high;  // what the system keeps of a thread's registers
  __asm__ volatile("xgetbv" : "=a"(kept), "=d"(kept_high) : "c"(0));
  const uint32_t avx2 = 1u << 5, bmi1 = 1u << 3, bmi2 = 1u << 8, lzcnt = 1u << 5;
  if (!has(kept, 0x6) || !has(seven.b, avx2 | bmi1 | bmi2) || !has(more.c, lzcnt)) return 2;
  const uint32_t f = 1u << 16, dq = 1u << 17, cd = 1u << 28, bw = 1u << 30, vl = 1u << 31;
  if (!has(kept, 0xE6) || !has(seven.b, f | dq | cd | bw | vl)) return 3;
  const uint32_t amx_bf16 = 1u << 22, amx_tile = 1u << 24;
  return has(seven.d, amx_bf16 | amx_tile) && has(kept, 3u << 17) ? 4 + 16 : 4;
}
#else
EXPORT int drape_processor() { return 0; }
#endif
