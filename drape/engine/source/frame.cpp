// One frame in one call (frame_steps.hpp).
#include "parts.hpp"

#ifndef FOR_TESTS
#include "frame_steps.hpp"

EXPORT int64_t drape_frame_f32(const FrameCall<float>* call, FrameOutcome* told, Scratch* scratch) {
  return draw_frame(*call, told, *scratch);
}
#endif
