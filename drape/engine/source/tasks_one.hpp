// Frames of many streams as a card is asked for them: a group of threads draws one (threads_one.hpp).
#pragma once
#include "eased.hpp"
#include "quantise.hpp"
#include "swing.hpp"

enum Step { ONE_LEVEL, TWO_LEVELS, LIFT_ALONE, SWING, QUANTISE };

// A frame of folds; all of it lies where the card reads it (drape/engine/card_frames.py). For swing the records are
// those of swing, and for both that and quantising the effort is Sizes.
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

// So many vertices; the share of swing, or the last step of coordinates.
struct Sizes {
  int64_t vertices;
  double number;
};

INLINE void draw_swing(const FoldTask& task, const Sizes& sizes) {
  Scratch scratch = *task.scratch;
  const bool moved = swing::frame(task.vertices, sizes.vertices, *(const SwingMemory<float>*)task.past, *task.around,
                                  *(const SwingConstants<float>*)task.cloth, float(sizes.number),
                                  *(SwingMemory<float>*)task.after, task.folded, scratch);
  if (!is_first_thread()) return;
  *(int64_t*)task.outcome = moved;
  task.scratch->overflowed = scratch.overflowed;
}

INLINE void draw(const FoldTask& task) {
  const Sizes* sizes = (const Sizes*)task.effort;
  if (task.step == ONE_LEVEL)
    draw(task, fold_one_level<float>, (const FoldConstants<float>*)task.cloth);
  else if (task.step == TWO_LEVELS)
    draw(task, fold_two_levels<float>, (const Levels<float>*)task.cloth);
  else if (task.step == LIFT_ALONE)
    draw(task, lift_alone<float>, (const Levels<float>*)task.cloth);
  else if (task.step == SWING)
    draw_swing(task, *sizes);
  else
    quantise(task.vertices, sizes->vertices, float(sizes->number), (uint16_t*)task.folded, (float*)task.outcome);
}
