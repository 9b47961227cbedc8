"""A model folder as the service runs it, as a function: a garment and poses in, vertices and posed charts out."""

from __future__ import annotations

import argparse
import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.graph.packing import pack_body
from service.graphs.engine import Engine
from service.graphs.onnx_runtime import Device
from service.graphs.packing import Packer, ScenePlan

FRAMES_PER_CALL = 8  # the vertex stage holds some megabytes per frame
PRECISIONS = ("int8", "float32")  # of the packed graph on a CPU; the first is served


@dataclass(frozen=True, eq=False)
class Draped:
    """What the packed graph returns for F poses, in float64 for the vertices.

    ``vertices`` (F, V, 3) world [m]; ``jet`` (F, K, 27 or 45) [patch scales], ``rotation`` (F, K, 3, 3) and ``centre``
    (F, K, 3) [m] relative to the root joint, whose world place is ``root`` (3,).
    """

    vertices: np.ndarray
    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    root: np.ndarray


def add_precision(parser: argparse.ArgumentParser) -> None:
    """Adds ``--precision``."""
    parser.add_argument(
        "--precision", choices=PRECISIONS, default=PRECISIONS[0], help="of the packed graph (default int8, as served)"
    )


class Network:
    """The packed graph of a model folder on the CPU, at rest (motion 0), in the fabric of ``made_of``.

    ``precision``: "int8" as served (``DRAPE_INT8``) where the model has that graph, or "float32". ``passes``: how many
    of the network's corrections run, None for all. Refuses (``ArtifactError``) a model of another body, and one without
    a packed graph; and (``InputError``) passes that the model cannot do.
    """

    def __init__(
        self,
        folder: Path,
        body: BodyModel,
        *,
        threads: int,
        precision: str = PRECISIONS[0],
        passes: int | None = None,
    ) -> None:
        self.engine = Engine(folder, device=Device(threads=threads), int8=precision == "int8")
        self.engine.check_body(body)
        self._packer = Packer(self.engine, body)
        self._shape = pack_body(body)
        self.manifest = self.engine.manifest
        self._plan = ScenePlan("both", passes=self.engine.check_passes(passes))
        self._fabric: Fabric | None = None

    def made_of(self, fabric: Fabric | None) -> Network:
        """The same network with garments of ``fabric``, where it knows fabrics; None: of its default."""
        other = copy.copy(self)
        other._fabric = fabric if self.engine.knows_fabrics else None
        return other

    @property
    def passes(self) -> int:
        """How many corrections run; 0 also where the model leaves no choice."""
        return self.engine.pass_count if self._plan.passes is None else self._plan.passes

    @property
    def graph(self) -> str:
        """Which graph drapes: "packed_int8" or "packed"."""
        return "packed_int8" if self.engine.int8 else "packed"

    def record(self) -> dict[str, str]:
        """What a benchmark's record says of the network: which graph of which model, by its digest."""
        return {"graph": self.graph, "model_digest": self.manifest.digest}

    def drape(self, garment: Garment, poses: np.ndarray) -> Draped:
        """The garment's subdivided mesh and its charts at ``poses`` (F, 24, 3) [rad], without root translation.

        Refuses (``ArtifactError``) numbers that are not finite.
        """
        fine = replace(garment, vertex_count=len(garment.vertices), faces=garment.fine_faces)
        self._packer.add(fine.name, fine)
        key = fine.name if self._fabric is None else self._packer.dressed(fine.name, self._fabric)
        results = []
        for start in range(0, len(poses), FRAMES_PER_CALL):
            part = poses[start : start + FRAMES_PER_CALL]
            items = [(key, row) for row in range(len(part))]
            results += self._packer.run(self._plan, self._shape.rows(part), items)
        self._packer.remove(fine.name)
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
        return Draped(vertices.astype(np.float64) + self._shape.root, jet, rotation, centre, self._shape.root)
