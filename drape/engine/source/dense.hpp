// Layers of the network: sums over the inputs of all rows of patches, and of one body.
//
// Every sum runs over the inputs in their order, whatever is summed at once: a processor with more registers gives the
// same bits.
#pragma once
#include "tiles.hpp"

constexpr int OUTPUTS = 8;  // that a layer's weights have side by side
// Blocks of patches and outputs that are summed at once: as many sums as registers hold.
#if defined(ONE_LANE)
constexpr int BLOCKS_AT_ONCE = 1, OUTPUTS_AT_ONCE = 8;
#elif defined(__AVX512F__)
constexpr int BLOCKS_AT_ONCE = 3, OUTPUTS_AT_ONCE = 8;
#elif defined(__wasm__)
constexpr int BLOCKS_AT_ONCE = 1, OUTPUTS_AT_ONCE = 2;
#else
constexpr int BLOCKS_AT_ONCE = 3, OUTPUTS_AT_ONCE = 2;
#endif

// Computes a layer's outputs from n on for BLOCKS blocks of inputs, from block on.
template <int BLOCKS, class T>
INLINE void sum_outputs(const Layer<T>& layer, const Rows<T>& inputs, const Rows<T>& added, const Rows<T>& outputs,
    int64_t block, int64_t n) {
  const int64_t count = layer.weight.count / layer.bias.count;
  const T slope = T(layer.slope);
  Row<T> sum[BLOCKS][OUTPUTS_AT_ONCE];
#pragma clang loop unroll(full)
  for (int b = 0; b < BLOCKS; ++b)
#pragma clang loop unroll(full)
    for (int i = 0; i < OUTPUTS_AT_ONCE; ++i) {
      sum[b][i] = row_of(layer.bias[n + i]);
      if (added.values) sum[b][i] = row_at(added.at(block + b) + LANES * (n + i)) + sum[b][i];
    }
  const T* weight = layer.weight + OUTPUTS * count * (n / OUTPUTS) + n % OUTPUTS;
  for (int64_t k = 0; k < count; ++k, weight += OUTPUTS) {
    Row<T> x[BLOCKS];
#pragma clang loop unroll(full)
    for (int b = 0; b < BLOCKS; ++b) x[b] = row_at(inputs.at(block + b) + LANES * k);
#pragma clang loop unroll(full)
    for (int i = 0; i < OUTPUTS_AT_ONCE; ++i)
#pragma clang loop unroll(full)
      for (int b = 0; b < BLOCKS; ++b) sum[b][i] = sum[b][i] + x[b] * weight[i];
  }
#pragma clang loop unroll(full)
  for (int b = 0; b < BLOCKS; ++b)
#pragma clang loop unroll(full)
    for (int i = 0; i < OUTPUTS_AT_ONCE; ++i)
      put(outputs.at(block + b) + LANES * (n + i), most<T>(sum[b][i], sum[b][i] * slope));
}
template <int BLOCKS, class T>
INLINE void sum_blocks(const Layer<T>& layer, const Rows<T>& inputs, const Rows<T>& added, const Rows<T>& outputs,
    int64_t block) {
  for (int64_t n = 0; n < layer.bias.count; n += OUTPUTS_AT_ONCE)
    sum_outputs<BLOCKS>(layer, inputs, added, outputs, block, n);
}

INLINE bool run_by_tiles(const Layer<float>& layer, const Rows<float>& inputs, const Rows<float>& added,
    const Rows<float>& outputs, int64_t blocks, Scratch& scratch) {
#ifdef WITH_TILES
  if (layer.tiles.count == 0) return false;
  run_tiles(layer, inputs, added, outputs, blocks, scratch);
  return true;
#else
  (void)layer, (void)inputs, (void)added, (void)outputs, (void)blocks, (void)scratch;
  return false;
#endif
}
INLINE bool run_by_tiles(const Layer<double>&, const Rows<double>&, const Rows<double>&, const Rows<double>&, int64_t,
    Scratch&) {
  return false;
}

// Writes to outputs the layer applied to the inputs of so many blocks of patches, plus added where that has values. A
// negative sum is multiplied by the layer's slope.
template <class T>
DEVICE void run_layer(const Layer<T>& layer, const Rows<T>& inputs, const Rows<T>& added, const Rows<T>& outputs,
    int64_t blocks, Scratch& scratch) {
#ifdef ONE_LANE
  (void)scratch;
  visit_parts(blocks, layer.bias.count / OUTPUTS_AT_ONCE, [&](int64_t block, int64_t part) {
    sum_outputs<1>(layer, inputs, added, outputs, block, OUTPUTS_AT_ONCE * part);
  });
#else
  if (run_by_tiles(layer, inputs, added, outputs, blocks, scratch)) return;
  int64_t block = 0;
  if constexpr (BLOCKS_AT_ONCE > 1) {
    // The last four go two by two: three and one would read an input for fewer products.
    for (; blocks - block >= BLOCKS_AT_ONCE && blocks - block != 4; block += BLOCKS_AT_ONCE)
      sum_blocks<BLOCKS_AT_ONCE>(layer, inputs, added, outputs, block);
    for (; blocks - block >= 2; block += 2) sum_blocks<2>(layer, inputs, added, outputs, block);
  }
  for (; block < blocks; ++block) sum_blocks<1>(layer, inputs, added, outputs, block);
#endif
}

// Writes to outputs the layer applied to the numbers inputs of one body. Its weights have sixteen outputs side by side,
// so that memory is read from end to end.
template <class T> DEVICE void run_body_layer(const Layer<T>& layer, const T* inputs, T* outputs) {
  const int64_t count = layer.weight.count / layer.bias.count;
  const T slope = T(layer.slope);
  for (int64_t block : each_block(layer.bias.count / LANES)) {
    const int64_t n = LANES * block;
    const T* weight = layer.weight + n * count;
    Row<T> total = row_at(layer.bias + n), other = row_of(T(0));
    int64_t k = 0;
    for (; k + 1 < count; k += 2) {  // two sums, since each addition waits for the one before
      total = total + row_at(weight + LANES * k) * inputs[k];
      other = other + row_at(weight + LANES * (k + 1)) * inputs[k + 1];
    }
    if (k < count) total = total + row_at(weight + LANES * k) * inputs[k];
    total = total + other;
    put(outputs + n, most<T>(total, total * slope));
  }
}
