"""Names of a model's graphs, and of the tensors by which they are joined."""

from __future__ import annotations

ENCODER, PACKED, DYNAMIC = "garment_encoder", "packed", "dynamic_encoder"
DRAPE = "drape"  # the readable graph: run, whole, where neither the engine nor the packed graph is
PUSH, PUSH_OVER = "push_out", "push_over"
PUSHES = (PUSH, PUSH_OVER)
FIRST = "patch_first"  # output of the encoder that the packed graph reads
EMBEDDING = "patch_embedding"  # and that the readable graph reads
SKIN = "skin"  # output of the graphs that pose it
JETS = ("jet", "frame_rotation", "frame_centre")  # outputs of the graph that drapes
