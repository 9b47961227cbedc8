// Frames of many streams as a card is asked for them: a group of threads draws one (threads_one.hpp).
#pragma once
#include "eased.hpp"

enum Step { ONE_LEVEL, TWO_LEVELS, LIFT_ALONE };

// A frame of folds; all of it lies where the card reads it (drape/engine/card.py).
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
