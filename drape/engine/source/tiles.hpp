// Layers of patches by a processor's tiles (AMX, for numbers of 16 bits): dense.hpp once more, in 0.4 of its time.
//
// A tile has sixteen rows of 64 bytes. A product of tiles adds to the float32 numbers of a third one
//
//     c[m, n] += sum over i of a[m, 2 i] b[i, 2 n] + a[m, 2 i + 1] b[i, 2 n + 1],
//
// of 32 numbers in each row of a and b, every one the upper half of a float32. Each number is split into two halves,
// x = high + low, and of the products of two numbers that of their low halves is left out:
//
//     w x ~ low high + high high + high low.
//
// Each half is off by 2^-8 of what it stands for at most, so that 3 x 2^-16 of w x may be missing. Over a whole network
// that moves vertices by less than a micrometre, as far as float32 rounds their places.
//
// These functions are compiled for a processor with tiles, and called only on one whose system lets the process keep
// their state.
#pragma once
#include "dense_rows.hpp"

#if defined(__x86_64__) && defined(__AVX512F__) && !defined(ONE_LANE)
#define WITH_TILES __attribute__((target("amx-tile,amx-bf16")))

constexpr int TILE = 256;                         // pairs of halves, or float32 numbers, of a tile
constexpr int TILE_INPUTS = 32, TILE_GROUP = 32;  // inputs of a tile; outputs that are summed at once, of two blocks

typedef uint32_t Words __attribute__((ext_vector_type(16)));

// Returns the upper half (bfloat16) nearest to each number, of two equally near the even one.
INLINE Words upper_half(Row<float> row) {
  Words bits;
  __builtin_memcpy(&bits, &row, sizeof bits);
  return (bits + ((bits >> 16) & 1) + 0x7FFF) & 0xFFFF0000;
}
INLINE Row<float> as_numbers(Words words) {
  Row<float> row;
  __builtin_memcpy(&row, &words, sizeof row);
  return row;
}

// Writes inputs as tiles, those of each block and each TILE_INPUTS, filled up with zeros: the upper halves of the
// numbers, and the rests.
WITH_TILES static inline void split_inputs(const Rows<float>& inputs, int64_t blocks, int64_t count, int64_t steps,
    uint32_t* given) {
  for (int64_t block = 0; block < blocks; ++block) {
    const float* from = inputs.at(block);
    for (int64_t k = 0; k < TILE_INPUTS * steps; k += 2) {
      Row<float> a = k < count ? row_at(from + LANES * k) : row_of(0.f);
      Row<float> b = k + 1 < count ? row_at(from + LANES * (k + 1)) : row_of(0.f);
      Words above_a = upper_half(a), above_b = upper_half(b);
      Words below_a = upper_half(a - as_numbers(above_a)), below_b = upper_half(b - as_numbers(above_b));
      uint32_t* to = given + 2 * TILE * (steps * block + k / TILE_INPUTS) + LANES * (k % TILE_INPUTS / 2);
      store(to, (above_a >> 16) | above_b);
      store(to + TILE, (below_a >> 16) | below_b);
    }
  }
}

// Writes a group's outputs of a block from its sums, which are the tiles at sums and two tiles behind it.
INLINE void finish_tiles(const Layer<float>& layer, const Rows<float>& added, const Rows<float>& outputs, int64_t block,
    int64_t n, const float* sums) {
  const int64_t last = layer.bias.count - n < TILE_GROUP ? layer.bias.count - n : TILE_GROUP;
  for (int64_t m = 0; m < last; ++m) {
    Row<float> row = row_at(sums + 2 * TILE * (m / LANES) + LANES * (m % LANES)) + layer.bias[n + m];
    if (added.values) row = row + row_at(added.at(block) + LANES * (n + m));
    put(outputs.at(block) + LANES * (n + m), most<float>(row, row * float(layer.slope)));
  }
}

// Writes the sums of a group's outputs for one block of inputs, or for TWO, to sums: four tiles, outputs by outputs,
// those of the second block behind those of the first.
template <bool TWO> WITH_TILES static void sum_tiles(const uint32_t* weight, const uint32_t* x, int64_t steps,
    float* sums) {
#define LOAD(tile, from) __builtin_ia32_tileloadd64(tile, from, 64)
#define STORE(tile, to) __builtin_ia32_tilestored64(tile, to, 64)
#define MULTIPLY                                 \
  __builtin_ia32_tdpbf16ps(0, 4, 6);             \
  if (TWO) __builtin_ia32_tdpbf16ps(1, 4, 7);    \
  __builtin_ia32_tdpbf16ps(2, 5, 6);             \
  if (TWO) __builtin_ia32_tdpbf16ps(3, 5, 7)
  const uint32_t* y = x + 2 * TILE * steps;
  __builtin_ia32_tilezero(0);
  __builtin_ia32_tilezero(1);
  __builtin_ia32_tilezero(2);
  __builtin_ia32_tilezero(3);
  for (int64_t k = 0; k < steps; ++k, weight += 4 * TILE, x += 2 * TILE, y += 2 * TILE) {
    LOAD(4, weight);
    LOAD(5, weight + TILE);
    LOAD(6, x);
    if (TWO) LOAD(7, y);
    MULTIPLY;
    LOAD(4, weight + 2 * TILE);
    LOAD(5, weight + 3 * TILE);
    MULTIPLY;
    LOAD(6, x + TILE);
    if (TWO) LOAD(7, y + TILE);
    MULTIPLY;
  }
  STORE(0, sums);
  STORE(2, sums + 2 * TILE);
  if (TWO) STORE(1, sums + TILE);
  if (TWO) STORE(3, sums + 3 * TILE);
#undef LOAD
#undef STORE
#undef MULTIPLY
}

WITH_TILES static void run_tiles(const Layer<float>& layer, const Rows<float>& inputs, const Rows<float>& added,
                                 const Rows<float>& outputs, int64_t blocks, Scratch& scratch) {
  const int64_t mark = scratch.used, count = layer.weight.count / layer.bias.count,
      steps = (count + TILE_INPUTS - 1) / TILE_INPUTS;
  uint32_t* given = scratch.take<uint32_t>(2 * TILE * steps * blocks);
  float* sums = scratch.take<float>(4 * TILE);
  if (scratch.overflowed) return;
  split_inputs(inputs, blocks, count, steps, given);
  struct __attribute__((aligned(64))) { uint8_t of[64]; } shapes = {};
  shapes.of[0] = 1;  // the palette; then bytes a row and rows of each of eight tiles
  for (int tile = 0; tile < 8; ++tile) shapes.of[16 + 2 * tile] = 64, shapes.of[48 + tile] = LANES;
  __builtin_ia32_tile_loadconfig(&shapes);
  for (int64_t n = 0; n < layer.bias.count; n += TILE_GROUP) {
    const uint32_t* weight = layer.tiles + 4 * TILE * steps * (n / TILE_GROUP);
    for (int64_t block = 0; block < blocks; block += 2) {
      const uint32_t* x = given + 2 * TILE * steps * block;
      const bool two = block + 1 < blocks;
      two ? sum_tiles<true>(weight, x, steps, sums) : sum_tiles<false>(weight, x, steps, sums);
      finish_tiles(layer, added, outputs, block, n, sums);
      if (two) finish_tiles(layer, added, outputs, block + 1, n, sums + TILE);
    }
  }
  __builtin_ia32_tilerelease();  // a thread that has tiles is slower to switch to
  scratch.used = mark;
}
#endif
