// Frames of many streams as a card is asked for them: a group of threads draws one (threads_one.hpp). All that a task
// points to lies where the card reads it (drape/engine/card_frames.py).
#pragma once
#include "parts_one.hpp"

#include "frame_steps.hpp"

struct FrameTask {
  const FrameCall<float>* call;
  FrameOutcome* told;  // of each garment; what is returned is -1 also where the frame was not begun
  uint8_t* scratch;    // of the first group; those of others lie behind it
  int64_t scratch_size;
  int64_t chain;  // this task and so many less one behind it, which go on from each other; 0 for those
};

INLINE void draw(const FrameTask* tasks, int64_t group_number) {
  int64_t returned = 1;
  for (int64_t n = 0; n < tasks[0].chain; ++n) {
    const FrameTask& task = tasks[n];
    const Array<LayerCall<float>>& layers = task.call->layers;
    for (int64_t layer : each(n ? layers.count : 0))
      layers[layer].folded_before[0].turn = tasks[n - 1].told[layer].folds.turn;
    Scratch scratch = {task.scratch + task.scratch_size * group_number, task.scratch_size, 0, false};
    returned = returned == 1 ? draw_frame(*task.call, task.told, scratch) : -1;  // all threads hand out the same pieces
    for (int64_t first : each(1)) task.told[first].returned = returned;
  }
}
