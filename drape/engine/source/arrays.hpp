// Arrays that the caller owns, and scratch memory out of one piece that the caller gives: nothing here allocates.
#pragma once
#include "platform.hpp"

// The address at which numbers begin, in eight bytes on every processor, and how many they are.
template <class N> struct Array {
  union {
    N* begin;
    uint64_t word;
  };
  int64_t count;
  INLINE_MEMBER operator N*() const { return begin; }
};

// Memory for one call, handed out piece by piece. `mark` and `back_to` give pieces back in the opposite order.
struct Scratch {
  uint8_t* begin;
  int64_t size, used;
  bool overflowed;
  template <class N> INLINE_MEMBER N* take(int64_t count) {
    int64_t start = (used + 63) & ~int64_t(63), end = start + count * int64_t(sizeof(N)) + 64;
    if (end > size) {
      overflowed = true;
      return nullptr;
    }
    used = end;
    return (N*)(begin + start);
  }
};
