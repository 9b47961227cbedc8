"""A model folder, run as the service runs it, as a function of a garment and poses."""

from __future__ import annotations

import argparse
import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drape.artifacts import model_folder
from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.graph.feeds import kinematics
from drape.graph.packing import pack_body
from drape.inference.engine import Engine
from drape.inference.onnx_runtime import Device
from drape.inference.packing import Packer, ScenePlan
from drape.stages.motion import Memory, Moment, advance

FRAMES_PER_CALL = 8  # the vertex stage holds some megabytes per frame


@dataclass(frozen=True, eq=False)
class NetworkDrape:
    """The network's drape in F poses: ``vertices`` [m] (F, V, 3) in the world, float64, and the posed patches.

    ``jet`` (F, K, 45) [patch scales] is the change of the patches' full rest jets (``drape.geometry.jets``). The
    patches' frames are ``rotation`` (F, K, 3, 3) and ``centre`` (F, K, 3) [m], relative to the root joint, which is at
    ``root`` (3,) [m] in the world.
    """

    vertices: np.ndarray
    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    root: np.ndarray


class ModelDrape:
    """The network of a model ``folder`` on the processor, as the service computes it; garments are of its default
    fabric.

    ``passes`` of the network's corrections run, None for all. Raises ``ArtifactError`` for a model of another body and
    for one that the service cannot compute, and ``InputError`` for passes that the model does not have.
    """

    def __init__(self, folder: Path, body: BodyModel, *, threads: int, passes: int | None = None) -> None:
        self.engine = Engine(folder, device=Device(threads=threads))
        self.engine.check_body(body)
        self._body, self._packer, self._shape = body, Packer(self.engine, body), pack_body(body)
        self.manifest = self.engine.manifest
        self._plan = ScenePlan("both", passes=self.engine.check_passes(passes))
        self._fabric: Fabric | None = None

    @classmethod
    def asked(cls, options: argparse.Namespace, body: BodyModel, *, passes: int | None = None) -> ModelDrape:
        """Returns the network of the model that the options ``--model`` and ``--threads`` ask for, on ``body``."""
        return cls(model_folder(options.model), body, threads=options.threads, passes=passes)

    def made_of(self, fabric: Fabric | None) -> ModelDrape:
        """Returns the same network for garments of ``fabric``, if it knows fabrics; None means its default fabric."""
        other = copy.copy(self)
        other._fabric = fabric if self.engine.knows_fabrics else None
        return other

    @property
    def passes(self) -> int:
        """How many corrections run; 0 if the model does not let one choose."""
        return self.engine.pass_count if self._plan.passes is None else self._plan.passes

    def record(self) -> dict[str, str]:
        """Returns what a benchmark's record holds of the network: "graph", what computes it ("packed" or "compiled"),
        and "model_digest"."""
        graph = "packed" if self.engine.compiled is None else "compiled"
        return {"graph": graph, "model_digest": self.manifest.digest}

    def drape(self, garment: Garment, poses: np.ndarray) -> NetworkDrape:
        """Returns the drape of the subdivided mesh of ``garment`` and of its patches at ``poses`` (F, 24, 3) [rad].

        The body stands still in each pose, its root in its rest place. Raises ``ArtifactError`` where numbers are not
        finite.
        """
        results = []
        with self._stored(garment) as key:
            for start in range(0, len(poses), FRAMES_PER_CALL):
                part = poses[start : start + FRAMES_PER_CALL]
                items = [(key, row) for row in range(len(part))]
                results += self._packer.run(self._plan, self._shape.rows(part), items)
        if not all(result.finite for result in results):
            raise ArtifactError(
                f"{self.manifest.name} vertices",
                expected="finite numbers",
                got="NaN or infinity",
                cure="Use another model; this one fails on the pose.",
            )
        vertices, jet, rotation, centre = (
            np.stack([result.arrays[name] for result in results])
            for name in ("vertices", "jet", "frame_rotation", "frame_centre")
        )
        return NetworkDrape(vertices.astype(np.float64) + self._shape.root, jet, rotation, centre, self._shape.root)

    def moving(
        self, garment: Garment, poses: np.ndarray, trans: np.ndarray, fps: float, *, motion: float = 1.0
    ) -> np.ndarray:
        """Returns the vertices [m] (F, V, 3) float32, relative to the root joint, of the network's drape of ``garment``
        on a moving body, frame by frame as a stream gets them.

        The body moves by ``poses`` (F, 24, 3) [rad] and ``trans`` (F, 3) [m] at ``fps``; the code that a dynamic model
        computes of that motion is multiplied by ``motion``, from 0 to 1.
        """
        rows, at, memory = self._shape.rows(poses), kinematics(self._body, poses, trans), Memory.empty(self.engine)
        drapes, plan = [], replace(self._plan, shape="vertices")
        with self._stored(garment) as key:
            for i in range(len(poses)):
                arrays = {name: value[i : i + 1] for name, value in rows.items()}
                if self.engine.dynamic:
                    if motion > 0.0:
                        (memory,) = advance(self.engine, [memory], [Moment(i / fps, at[i])])
                    arrays["dynamic_code"] = np.float32(motion) * memory.code[None]
                drapes.append(self._packer.run(plan, arrays, [(key, 0)])[0].arrays["vertices"])
        return np.stack(drapes)

    @contextmanager
    def _stored(self, garment: Garment) -> Iterator[str]:
        """The key of the garment's subdivided mesh, made of the fabric, while it is in the graph's store."""
        fine = replace(garment, vertex_count=len(garment.vertices), faces=garment.fine_faces)
        self._packer.add(fine.name, fine)
        try:
            yield fine.name if self._fabric is None else self._packer.dressed(fine.name, self._fabric)
        finally:
            self._packer.remove(fine.name)
