// Frames of many streams as a card is asked for them: a group of threads draws one (threads_one.hpp). All that a task
// points to lies where the card reads it (drape/engine/card_frames.py).
#pragma once
#include "parts_one.hpp"

#include "frame_steps.hpp"

// A frame from its pose on. What it returns is that of drape_frame_f32, -1 also where it was not begun.
struct FrameResult {
  FrameOutcome told;
  int64_t returned;
};
struct FrameTask {
  const FrameCall<float>* call;
  FrameResult* result;
  uint8_t* scratch;  // of the first group; those of others lie behind it
  int64_t scratch_size;
  int64_t chain;  // this task and so many less one behind it, which go on from each other; 0 for those
};

INLINE void draw(const FrameTask* tasks, int64_t group_number) {
  FrameOutcome told = {};
  int64_t returned = 1;
  for (int64_t n = 0; n < tasks[0].chain; ++n) {
    const FrameTask& task = tasks[n];
    for (int64_t first : each(n ? 1 : 0)) task.call->folded_before[first].turn = told.folds.turn;
    Scratch scratch = {task.scratch + task.scratch_size * group_number, task.scratch_size, 0, false};
    returned = returned == 1 ? draw_frame(*task.call, told, scratch) : -1;  // every thread hands out the same pieces
    if (is_first_thread()) *task.result = {told, returned};
  }
}

// Folds alone.
enum Step { ONE_LEVEL, TWO_LEVELS, LIFT_ALONE };

struct FoldTask {
  uint64_t step;
  const float* vertices;
  const FoldMemory<float>* past;
  const Surroundings<float>* around;
  const void* cloth;  // FoldConstants for one level, or Levels
  const FoldEffort<float>* effort;
  FoldMemory<float>* after;
  float* folded;
  FoldOutcome* outcome;
  Scratch* scratch;
};

template <class Frame, class Cloth> INLINE void draw(const FoldTask& task, Frame frame, const Cloth* cloth) {
  Scratch scratch = *task.scratch;  // every thread hands out the same pieces
  const FoldOutcome found =
      frame(task.vertices, *task.past, *task.around, *cloth, *task.effort, *task.after, task.folded, scratch);
  if (!is_first_thread()) return;
  *task.outcome = found;
  task.scratch->overflowed = scratch.overflowed;
}

INLINE void draw(const FoldTask& task) {
  if (task.step == ONE_LEVEL)
    draw(task, fold_one_level<float>, (const FoldConstants<float>*)task.cloth);
  else if (task.step == TWO_LEVELS)
    draw(task, fold_two_levels<float>, (const Levels<float>*)task.cloth);
  else
    draw(task, lift_alone<float>, (const Levels<float>*)task.cloth);
}
