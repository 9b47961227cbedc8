"""An exported model as a function: a garment and poses in, vertices and posed charts out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime

from drape.artifacts import load_manifest
from drape.body.model import BodyModel
from drape.catalog import check_body
from drape.feeds import body_feed, garment_feed
from drape.garment.cache import Garment
from drape.subnormals import flushed

FRAMES_PER_CALL = 8  # the vertex stage holds some megabytes per frame


@dataclass(frozen=True, eq=False)
class Draped:
    """What the drape graph returns for F poses, in float64 for the vertices.

    ``vertices`` (F, V, 3) world [m]; ``jet`` (F, K, 27) [patch scales], ``rotation`` (F, K, 3, 3) and ``centre``
    (F, K, 3) [m] relative to the root joint, whose world place is ``root`` (F, 3).
    """

    vertices: np.ndarray
    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    root: np.ndarray


class Network:
    """A model folder by ONNX Runtime on the CPU; refused (``ArtifactError``) if trained on another body."""

    def __init__(self, folder: Path, body: BodyModel, *, threads: int) -> None:
        self.manifest = load_manifest(folder)
        self.body = body
        check_body(f"model {folder.name}", self.manifest.body_digest, body)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.add_session_config_entry("session.set_denormal_as_zero", "1")
        with flushed():
            self._sessions = {
                key: onnxruntime.InferenceSession(str(folder / spec.file), options, providers=["CPUExecutionProvider"])
                for key, spec in self.manifest.graphs.items()
            }

    def drape(self, garment: Garment, poses: np.ndarray) -> Draped:
        """The garment's subdivided mesh and its charts at ``poses`` (F, 24, 3) [rad], without root translation."""
        features = np.ascontiguousarray(garment.patch_features, dtype=np.float32)
        (embedding,) = self._run("garment_encoder", {"patch_features": features}, ["patch_embedding"])
        constants = {**garment_feed(garment, fine=True, body=self.body), "patch_embedding": embedding}
        feed = body_feed(self.body, poses, np.zeros((len(poses), 3)), skin=True)
        outputs = ["vertices", "jet", "frame_rotation", "frame_centre"]
        calls = []
        for start in range(0, len(poses), FRAMES_PER_CALL):
            arrays = {key: value[start : start + FRAMES_PER_CALL] for key, value in feed.arrays.items()}
            arrays |= self._at_rest(len(arrays["body_features"]))
            calls.append(self._run("drape", {**arrays, **constants}, outputs))
        vertices, jet, rotation, centre = (np.concatenate(parts) for parts in zip(*calls, strict=True))
        return Draped(vertices.astype(np.float64) + feed.root[:, None], jet, rotation, centre, feed.root)

    def _at_rest(self, frames: int) -> dict[str, np.ndarray]:
        """What the drape graph of a dynamic model takes besides: no motion."""
        motion = [spec for spec in self.manifest.graphs["drape"].inputs if spec.name == "dynamic_code"]
        return {spec.name: np.zeros((frames, int(spec.shape[-1])), np.float32) for spec in motion}

    def _run(self, graph: str, arrays: dict[str, np.ndarray], outputs: list[str]) -> list[np.ndarray]:
        feed = {spec.name: arrays[spec.name] for spec in self.manifest.graphs[graph].inputs}
        with flushed():
            return [np.asarray(output) for output in self._sessions[graph].run(outputs, feed)]
