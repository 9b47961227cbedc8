// Numbers of patches, count for each: sixteen patches a row, the rows of a block of patches one after the other. A layer
// reads or writes them from row first of a block on.
#pragma once
#include "records.hpp"
#include "rows.hpp"

template <class T> struct Rows {
  T* values;
  int64_t count, first;
  INLINE_MEMBER T* at(int64_t block) const { return values + LANES * (count * block + first); }
};
