// Who computes what. A loop whose turns may come in any order runs over one of these ranges: a processor takes its
// turns one after the other, and a card gives them to threads, all of which come to its end before any goes on
// (threads_one.hpp). Every thread runs what is around such a loop, and has the same numbers there.
#pragma once
#ifdef ONE_LANE
#include "threads_one.hpp"
#else
#include "platform.hpp"

struct Range {
  struct Place {
    int64_t at;
    INLINE_MEMBER int64_t operator*() const { return at; }
    INLINE_MEMBER void operator++() { ++at; }
    INLINE_MEMBER bool operator!=(Place other) const { return at != other.at; }
  };
  int64_t first, last;
  INLINE_MEMBER Place begin() const { return {first}; }
  INLINE_MEMBER Place end() const { return {last > first ? last : first}; }
};

// The range of the whole numbers below a count; and below, that of the blocks of sixteen from first to the one before
// last.
INLINE Range each(int64_t count) { return {0, count}; }
INLINE Range each_block(int64_t first, int64_t last) { return {first, last}; }
INLINE Range each_block(int64_t count) { return {0, count}; }

// Calls visit(block, part) for so many parts of each block. Where parts of a second kind read what those of a first
// kind write, the first are visited before the second: on a processor block by block, so that one piece of memory
// serves all blocks (piece_of is its number, pieces_of(blocks) how many there are), and on a card for all blocks.
template <class Visit> INLINE void visit_parts(int64_t blocks, int64_t parts, Visit visit) {
  for (int64_t block = 0; block < blocks; ++block)
    for (int64_t part = 0; part < parts; ++part) visit(block, part);
}
template <class First, class Second>
INLINE void visit_twice(int64_t blocks, int64_t parts, First first, int64_t others, Second second) {
  for (int64_t block = 0; block < blocks; ++block) {
    for (int64_t part = 0; part < parts; ++part) first(block, part);
    for (int64_t part = 0; part < others; ++part) second(block, part);
  }
}
INLINE int64_t piece_of(int64_t) { return 0; }
INLINE int64_t pieces_of(int64_t) { return 1; }

// Returns the sum of what all threads have, and below it the largest.
template <class N> INLINE N sum_of_all(N own) { return own; }
template <class N> INLINE N most_of_all(N own) { return own; }

INLINE bool is_first_thread() { return true; }

// Raises a number that is not below zero to at least this value; other threads may raise it at the same time.
template <class N> INLINE void raise_to(N* number, N to) { *number = to > *number ? to : *number; }

// The lowest of the values below a limit that threads offer, and who offered it; among equal ones the first.
template <class N> struct Lowest {
  N least;
  int32_t from;
  INLINE_MEMBER void clear(N limit) { least = limit, from = -1; }
  INLINE_MEMBER void offer(N value, int32_t who) {
    if (value < least) least = value, from = who;
  }
  INLINE_MEMBER N value() const { return least; }
  INLINE_MEMBER int32_t who() const { return from; }  // -1: nobody
};

// Returns the sum of visit(i) for the numbers below a count, in their order; room has place for as many numbers.
template <class N, class Visit> INLINE N sum_in_order(int64_t count, N*, Visit visit) {
  N sum = 0;
  for (int64_t i = 0; i < count; ++i) sum += visit(i);
  return sum;
}

// Collects the results of visit(i, to, room) for the numbers below a count, in their order, at most `most` of them, and
// returns how many there are. visit returns how many it has, and writes as many of these as there is room for.
template <class N, class Visit> INLINE int64_t collect(int64_t count, N* found, int64_t most, Visit visit) {
  int64_t at = 0;
  for (int64_t i = 0; i < count; ++i) at += visit(i, found + at, most - at);
  return at < most ? at : most;
}

template <class N> INLINE void copy(N* to, const N* from, int64_t count) {
  __builtin_memcpy(to, from, size_t(count) * sizeof(N));
}
#endif
