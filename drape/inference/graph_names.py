"""Names of a model's graphs, and of the tensors by which they are joined."""

from __future__ import annotations

ENCODER, PACKED, DYNAMIC = "garment_encoder", "packed", "dynamic_encoder"
DRAPE = "drape"  # the readable graph
PUSH, PUSH_OVER = "push_out", "push_over"
PUSHES = (PUSH, PUSH_OVER)
FIRST = "patch_first"  # the encoder's output that the packed graph reads
EMBEDDING = "patch_embedding"  # the encoder's output that the readable graph reads
SKIN = "skin"  # the posed skin samples
JETS = ("jet", "frame_rotation", "frame_centre")  # the posed jets
