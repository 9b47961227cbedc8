// A card's frames, emulated on a processor for tests: the same source with one lane a thread, and threads as loops
// (threads_one.hpp).
#include <stddef.h>
#include <stdint.h>

#define ONE_LANE
namespace one_lane {  // its templates are others than those of a processor
#include "exports.hpp"
#include "tasks_one.hpp"

EXPORT void drape_emulated_frames_f32(const FrameTask* tasks, int64_t count, int64_t threads, int64_t backwards) {
  const Flushed flushed;
  group.threads = int(threads), group.backwards = backwards;
  for (int64_t n = 0; n < count; ++n) draw(tasks + n, 0);
}
}  // namespace one_lane
