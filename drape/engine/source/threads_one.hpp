// Ranges of a card: a group of threads computes a frame together, a thread one lane of a block.
//
// CUDA runs a group as one block of its threads. Elsewhere they are emulated: a range takes the turns of one thread
// after the other, from the first or from the last, so that two threads of which one needs what the other writes in the
// same range give other numbers.
#pragma once
#include "platform.hpp"

constexpr int ROW_THREADS = 16;  // that share the blocks of a row

#ifdef __CUDACC__
struct Group {
  INLINE_MEMBER static int thread() { return int(threadIdx.x); }
  INLINE_MEMBER static int threads() { return int(blockDim.x); }
};
INLINE int lane() { return int(threadIdx.x) % ROW_THREADS; }
INLINE bool is_first_thread() { return threadIdx.x == 0; }
#else
static struct {
  int threads, thread;
  bool backwards;
} group = {256, 0, false};
INLINE int lane() { return group.thread % ROW_THREADS; }
INLINE bool is_first_thread() { return true; }  // what is around a range is run once
#endif

// The range of the numbers from first to the one before last; each is taken by so many threads side by side.
struct Range {
  int64_t first, last;
  int sharing;
#ifdef __CUDACC__
  struct Place {
    int64_t at, step;
    INLINE_MEMBER int64_t operator*() const { return at; }
    INLINE_MEMBER void operator++() { at += step; }
    INLINE_MEMBER bool operator!=(int64_t last) const { return at < last; }
  };
  INLINE_MEMBER Place begin() const {
    return {first + Group::thread() / sharing, Group::threads() / sharing};
  }
  INLINE_MEMBER int64_t end() const { return last; }
  INLINE_MEMBER ~Range() { __syncthreads(); }
#else
  struct Place {
    int64_t first, last;
    int sharing, turn;  // of the threads
    int64_t at;
    INLINE_MEMBER int64_t operator*() const { return at; }
    INLINE_MEMBER void operator++() {
      at += group.threads / sharing;
      seek();
    }
    INLINE_MEMBER bool operator!=(int64_t) const { return turn < group.threads; }
    INLINE_MEMBER void begin_turn() {
      group.thread = group.backwards ? group.threads - 1 - turn : turn;
      at = first + group.thread / sharing;
    }
    INLINE_MEMBER void seek() {
      while (at >= last && ++turn < group.threads) begin_turn();
    }
  };
  INLINE_MEMBER Place begin() const {
    Place place = {first, last, sharing, 0, 0};
    place.begin_turn();
    place.seek();
    return place;
  }
  INLINE_MEMBER int64_t end() const { return last; }
#endif
};

INLINE Range each(int64_t count) { return {0, count, 1}; }
INLINE Range each_block(int64_t first, int64_t last) { return {first, last, ROW_THREADS}; }
INLINE Range each_block(int64_t count) { return {0, count, ROW_THREADS}; }

template <class Visit> INLINE void visit_parts(int64_t blocks, int64_t parts, Visit visit) {
  for (int64_t each_part : each_block(blocks * parts)) visit(each_part / parts, each_part % parts);
}
template <class First, class Second>
INLINE void visit_twice(int64_t blocks, int64_t parts, First first, int64_t others, Second second) {
  visit_parts(blocks, parts, first);
  visit_parts(blocks, others, second);
}
INLINE int64_t piece_of(int64_t block) { return block; }
INLINE int64_t pieces_of(int64_t blocks) { return blocks; }

#ifdef __CUDACC__
// Returns the numbers of all threads joined, in one order that is the same in every run.
template <class N, class Join> INLINE N joined_of_all(N own, Join join) {
  __shared__ N part[32];
  const int warps = Group::threads() / 32;
  for (int way = 16; way; way /= 2) own = join(own, __shfl_xor_sync(~0u, own, way));
  if (Group::thread() % 32 == 0) part[Group::thread() / 32] = own;
  __syncthreads();
  own = part[0];
  for (int warp = 1; warp < warps; ++warp) own = join(own, part[warp]);
  __syncthreads();
  return own;
}
template <class N> INLINE N sum_of_all(N own) {
  return joined_of_all(own, [](N a, N b) { return a + b; });
}
template <class N> INLINE N most_of_all(N own) {
  return joined_of_all(own, [](N a, N b) { return b > a || b != b ? b : a; });
}
#else
template <class N> INLINE N sum_of_all(N own) { return own; }
template <class N> INLINE N most_of_all(N own) { return own; }
#endif

// Returns the sum of visit(i) for the numbers below a count, in their order; room has place for as many numbers.
template <class N, class Visit> INLINE N sum_in_order(int64_t count, N* room, Visit visit) {
  for (int64_t i : each(count)) room[i] = visit(i);
  N sum = 0;
  for (int64_t i = 0; i < count; ++i) sum += room[i];
  for (int64_t none : each(0)) (void)none;  // nobody writes room again before all have read it
  return sum;
}

template <class N> INLINE void copy(N* to, const N* from, int64_t count) {
  for (int64_t i : each(count)) to[i] = from[i];
}

#ifdef __CUDACC__
INLINE int thread_count() { return Group::threads(); }
INLINE int32_t* thread_parts() {
  __shared__ int32_t parts[1025];
  return parts;
}
// Adds one to a number that other threads add to as well, and returns what it was.
INLINE int32_t count_up(int32_t* number) { return atomicAdd(number, 1); }
INLINE void raise_to(float* number, float to) {
  if (to > 0) atomicMax((int32_t*)number, __float_as_int(to));
}
INLINE void lower_key(uint64_t* key, uint64_t to) { atomicMin((unsigned long long*)key, (unsigned long long)to); }
#else
INLINE int thread_count() { return group.threads; }
INLINE int32_t* thread_parts() {
  static int32_t parts[1025];
  return parts;
}
INLINE int32_t count_up(int32_t* number) { return (*number)++; }
INLINE void raise_to(float* number, float to) { *number = to > *number ? to : *number; }
INLINE void lower_key(uint64_t* key, uint64_t to) { *key = to < *key ? to : *key; }
#endif

// The lowest of the values below a limit that threads offer, and who offered it; among equal ones the first. A key has
// the bits of the value, changed so that they rise with it, and behind them the number of who offers it, from 1 on.
template <class N> struct Lowest;
template <> struct Lowest<float> {
  uint64_t key;
  INLINE_MEMBER static uint64_t key_of(float value, int32_t who) {
    const float plain = value + 0.f;  // there is one zero
    uint32_t bits;
    __builtin_memcpy(&bits, &plain, sizeof bits);
    bits ^= bits >> 31 ? ~0u : 0x80000000u;
    return uint64_t(bits) << 32 | uint32_t(who + 1);
  }
  INLINE_MEMBER void clear(float limit) { key = key_of(limit, -1); }
  INLINE_MEMBER void offer(float value, int32_t who) {
    if (value == value) lower_key(&key, key_of(value, who));
  }
  INLINE_MEMBER float value() const {
    uint32_t bits = uint32_t(key >> 32);
    bits ^= bits >> 31 ? 0x80000000u : ~0u;
    float found;
    __builtin_memcpy(&found, &bits, sizeof found);
    return found;
  }
  INLINE_MEMBER int32_t who() const { return int32_t(uint32_t(key)) - 1; }  // -1: nobody
};

// Collects the results of visit(i, to, room) for the numbers below a count, in their order, at most `most` of them, and
// returns how many there are. visit returns how many it has, and writes as many of these as there is room for.
template <class N, class Visit> INLINE int64_t collect(int64_t count, N* found, int64_t most, Visit visit) {
  const int threads = thread_count();
  const int64_t share = (count + threads - 1) / threads;
  int32_t* parts = thread_parts();
  for (int64_t t : each(threads)) {
    int64_t own = 0;
    for (int64_t i = share * t; i < share * (t + 1) && i < count; ++i) own += visit(i, found, int64_t(0));
    parts[t] = int32_t(own);
  }
  for (int64_t t : each(threads)) {
    int64_t at = 0;
    for (int64_t before = 0; before < t; ++before) at += parts[before];
    for (int64_t i = share * t; i < share * (t + 1) && i < count; ++i) at += visit(i, found + at, most - at);
    if (t == threads - 1) parts[threads] = int32_t(at);
  }
  return parts[threads] < most ? parts[threads] : most;
}

// Replaces counts (n + 1,) by the sum of those before each; the last one becomes the sum of all.
INLINE void sum_up(int32_t* counts, int64_t n) {
  const int threads = thread_count();
  const int64_t share = (n + threads - 1) / threads;
  int32_t* parts = thread_parts();
  for (int64_t t : each(threads)) {
    parts[t] = 0;
    for (int64_t i = share * t; i < share * (t + 1) && i < n; ++i) parts[t] += counts[i];
  }
  for (int64_t t : each(threads)) {
    int32_t at = 0;
    for (int64_t before = 0; before < t; ++before) at += parts[before];
    for (int64_t i = share * t; i < share * (t + 1) && i < n; ++i) {
      const int32_t own = counts[i];
      counts[i] = at;
      at += own;
    }
    if (t == threads - 1) counts[n] = at;
  }
}
