"""From a checkpoint to a model folder: ONNX graphs, their shared weights, and a manifest, written only if they compute
what torch does."""
