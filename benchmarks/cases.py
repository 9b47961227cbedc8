"""The cases of benchmarks: clips, garments in fabrics over them, and their drapes by skinning and by folds."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.model_drape import ModelDrape
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.contact.skin import shaped_skin
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.geometry.skinning import skin_points
from drape.live.fold_constants import FoldConstants, fold_constants
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.motion.clip import MotionClip, joint_steps
from drape.motion.hard_poses import HardPoses
from drape.motion.readers import read_motion

MEASURED = 10  # so many frames of a clip are measured
FPS = 30.0
LIMBS = [n for n, name in enumerate(JOINT_NAMES) if name.split("_")[-1] in ("shoulder", "elbow", "hip", "knee")]


@dataclass(frozen=True, eq=False)
class CaseClip:
    """A clip of F frames that ``body`` moves through: ``poses`` (F, 24, 3) [rad] at ``fps``, translations of the root
    ``trans`` (F, 3) [m].

    Figures are measured in the frames ``measured`` (n,), whose names are ``labels``.
    """

    name: str
    fps: float
    poses: np.ndarray
    trans: np.ndarray
    body: BodyModel
    measured: np.ndarray
    labels: tuple[str, ...]

    @classmethod
    def of(cls, name: str, fps: float, poses: np.ndarray, body: BodyModel, *, trans: Any = None) -> CaseClip:
        """Returns a clip of ``poses`` (F, 24, 3) [rad] with the root at ``trans`` [m] (F, 3), zeros if left out.

        At most ``MEASURED`` frames, spread evenly over the clip, are measured.
        """
        measured = np.unique(np.linspace(0, len(poses) - 1, MEASURED).astype(int))
        places = np.zeros((len(poses), 3)) if trans is None else np.array(trans)
        return cls(name, fps, np.array(poses), places, body, measured, tuple(f"{name}:{frame}" for frame in measured))

    @classmethod
    def read(cls, path: Path, fps: float, frames: int, body: BodyModel) -> CaseClip:
        """Returns a clip of the first ``frames`` frames of the motion file ``path``, resampled to ``fps``."""
        motion = at_rate(read_motion(path), fps)
        return cls.of(motion.name, fps, motion.poses[:frames], body, trans=motion.trans[:frames])

    @classmethod
    def hard(cls, chosen: HardPoses, body: BodyModel) -> CaseClip:
        """Returns a clip of the ``chosen`` poses, which do not follow each other. All of them are measured."""
        frames = np.arange(len(chosen.poses))
        return cls("poses", FPS, chosen.poses, np.zeros((len(frames), 3)), body, frames, chosen.labels)

    @cached_property
    def skin(self) -> np.ndarray:
        """The posed samples of the body's skin (F, S, 8) as ``drape.contact.samples.sample_table`` has them, with the
        root in its rest place."""
        table = shaped_skin(self.body).table(
            *self.body.bones(self.poses), np.zeros((len(self.poses), self.body.shape_count))
        )
        return table.reshape(len(self.poses), -1, table.shape[-1])

    @cached_property
    def body_vertices(self) -> np.ndarray:
        """The vertices [m] (n, Vb, 3) of the body in the measured frames, with the root in its rest place."""
        return self.body.posed_vertices(self.poses[self.measured])


def at_rate(motion: MotionClip, fps: float) -> MotionClip:
    """Returns ``motion`` resampled to ``fps`` frames a second; itself where it has that rate."""
    return motion if abs(motion.fps - fps) < 1e-6 else motion.resampled(fps)


def skinned(garment: Garment, body: BodyModel, poses: np.ndarray) -> np.ndarray:
    """Returns the vertices [m] (F, V, 3) of the subdivided mesh of ``garment`` at ``poses`` (F, 24, 3) [rad], by linear
    blend skinning with the garment's own weights."""
    rest = np.broadcast_to(garment.vertices.astype(np.float64), (len(poses), *garment.vertices.shape))
    return skin_points(rest, garment.skin_weights(body).astype(np.float64), *body.bones(poses))


def pushed(vertices: np.ndarray, body: BodyModel, poses: np.ndarray) -> np.ndarray:
    """Returns ``vertices`` [m] (F, V, 3); those in the skin of ``body`` at ``poses`` (F, 24, 3) [rad] have been moved
    out along the normal of the nearest body vertex."""
    posed = body.posed_vertices(poses)
    return nearest_vertex_push(vertices, posed, np.asarray(BodyContact(body.faces, body.vertex_count).normals(posed)))


@dataclass(frozen=True, eq=False)
class CaseScene:
    """One case of a benchmark: a ``garment`` made of ``fabric``, worn through a ``clip``."""

    garment: Garment
    fabric: Fabric
    clip: CaseClip

    @property
    def name(self) -> dict[str, Any]:
        """The columns of a row that name the scene: garment, fabric and clip."""
        return {"garment": self.garment.name, "fabric": self.fabric.name, "clip": self.clip.name}

    @property
    def body(self) -> BodyModel:
        """The body of the clip."""
        return self.clip.body

    @cached_property
    def constants(self) -> FoldConstants:
        """The garment's constants for folds."""
        return fold_constants(self.garment, self.body, self.fabric)

    def network(self, network: ModelDrape) -> np.ndarray:
        """Returns the vertices [m] (F, V, 3) float32, in the world, of the drape of ``network`` in each pose of the
        clip."""
        return network.made_of(self.fabric).drape(self.garment, self.clip.poses).vertices.astype(np.float32)

    def starts(self, networks: dict[str, ModelDrape]) -> dict[str, np.ndarray]:
        """Returns vertices [m] (F, V, 3) float32, in the world, by method: "skinning" with the nearest-vertex push, and
        each of ``networks`` by its name."""
        poses = self.clip.poses
        plain = pushed(skinned(self.garment, self.body, poses), self.body, poses).astype(np.float32)
        return {"skinning": plain} | {name: self.network(network) for name, network in networks.items()}


def scenes(options: argparse.Namespace, clips: list[CaseClip], body: BodyModel) -> Iterator[CaseScene]:
    """Yields a scene for each of ``clips``, each garment of ``--garments`` on its fine mesh, and each of
    ``--fabrics``."""
    for clip in clips:
        for path in find_garments(options.garments):
            garment = fine_garment(open_garment(path, body))
            for name in options.fabrics:
                yield CaseScene(garment, fabric(name), clip)


def read_case_clips(options: argparse.Namespace, body: BodyModel, fps: float = FPS) -> list[CaseClip]:
    """Returns a clip of the first ``--frames`` frames of each of ``--motions``, resampled to ``fps``."""
    return [CaseClip.read(path, fps, options.frames, body) for path in find_motions(options.motions)]


def lively_clips(names: Sequence[str], frames: int, body: BodyModel, fps: float = FPS) -> list[CaseClip]:
    """Returns a clip, named ``CLIP@FIRST``, for each motion of ``names``: the ``frames`` frames in a row through which
    limbs turn most, or all if there are fewer."""
    clips = []
    for path in find_motions(names) if names else ():
        motion = at_rate(read_motion(path), fps)
        count = min(frames, motion.frame_count)
        turned = np.concatenate([[0.0], np.cumsum(joint_steps(motion)[:, LIMBS].sum(axis=1))])
        first = int(np.argmax(turned[count - 1 :] - turned[: len(turned) - count + 1]))
        window = motion.window(first, count)
        clips.append(CaseClip.of(f"{motion.name}@{first}", fps, window.poses, body, trans=window.trans))
    return clips


def folded_poses(constants: FoldConstants, start: np.ndarray, skin: np.ndarray, effort: FoldEffort) -> np.ndarray:
    """Returns the drapes ``start`` [m] (F, V, 3) over the posed skin samples ``skin`` (F, S, 8) after folds: vertices
    [m] (F, V, 3), float64. Each frame is folded by itself, as a pose without a past."""
    frames = (Frame(vertices, samples, 0.0) for vertices, samples in zip(start, skin, strict=True))
    return np.stack([fold(constants, None, frame, effort)[0] for frame in frames]).astype(np.float64)
