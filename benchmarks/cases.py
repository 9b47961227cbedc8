"""The cases of benchmarks: clips, garments in fabrics over them, and their drapes by skinning and by folds."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Option
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

MEASURED = 10  # frames of a clip that are looked at
FPS = 30.0
LIMBS = [n for n, name in enumerate(JOINT_NAMES) if name.split("_")[-1] in ("shoulder", "elbow", "hip", "knee")]


def fabrics_option(*names: str) -> Option:
    """Returns the option ``--fabrics`` of a benchmark; ``names`` is its default."""
    return Option("--fabrics", names, "what garments are made of", names[:1])


@dataclass(frozen=True, eq=False)
class CaseClip:
    """F ``poses`` [rad] of ``body`` at ``fps``, the root at ``trans`` [m] (F, 3).

    Figures are of the frames ``measured`` (n,), which ``labels`` name.
    """

    name: str
    fps: float
    poses: np.ndarray
    trans: np.ndarray
    body: BodyModel
    measured: np.ndarray
    labels: tuple[str, ...]

    @classmethod
    def of(
        cls, name: str, fps: float, poses: np.ndarray, body: BodyModel, *, trans: Any = None, looked_at: int = MEASURED
    ) -> CaseClip:
        """Returns a clip of ``poses`` (F, 24, 3) [rad] with the root at ``trans`` [m] (F, 3), zeros if left out.

        At most ``looked_at`` frames, spread evenly over the clip, are measured.
        """
        measured = np.unique(np.linspace(0, len(poses) - 1, looked_at).astype(int))
        places = np.zeros((len(poses), 3)) if trans is None else np.array(trans)
        return cls(name, fps, np.array(poses), places, body, measured, tuple(f"{name}:{frame}" for frame in measured))

    @classmethod
    def read(cls, path: Path, fps: float, frames: int, body: BodyModel, *, looked_at: int = MEASURED) -> CaseClip:
        """Returns a clip of the first ``frames`` of the motion at ``path``, resampled to ``fps``."""
        motion = at_rate(read_motion(path), fps)
        trans = motion.trans[:frames]
        return cls.of(motion.name, fps, motion.poses[:frames], body, trans=trans, looked_at=looked_at)

    @classmethod
    def hard(cls, chosen: HardPoses, body: BodyModel) -> CaseClip:
        """Returns a clip of the ``chosen`` poses, which do not follow each other. All of them are measured."""
        frames = np.arange(len(chosen.poses))
        return cls("poses", FPS, chosen.poses, np.zeros((len(frames), 3)), body, frames, chosen.labels)

    @cached_property
    def skin(self) -> np.ndarray:
        """Posed samples of the skin (F, S, 8), as folds take them."""
        table = shaped_skin(self.body).table(
            *self.body.bones(self.poses), np.zeros((len(self.poses), self.body.shape_count))
        )
        return table.reshape(len(self.poses), -1, table.shape[-1])

    @cached_property
    def body_vertices(self) -> np.ndarray:
        """Vertices [m] (n, Vb, 3) of the body in the measured frames."""
        return self.body.posed_vertices(self.poses[self.measured])


def at_rate(motion: MotionClip, fps: float) -> MotionClip:
    """Returns ``motion`` resampled to ``fps`` frames a second; itself where it has that rate."""
    return motion if abs(motion.fps - fps) < 1e-6 else motion.resampled(fps)


def skinned(garment: Garment, body: BodyModel, poses: np.ndarray) -> np.ndarray:
    """The subdivided mesh [m] (F, V, 3) by linear blend skinning with the garment's own weights."""
    rest = np.broadcast_to(garment.vertices.astype(np.float64), (len(poses), *garment.vertices.shape))
    return skin_points(rest, garment.skin_weights(body).astype(np.float64), *body.bones(poses))


def pushed(vertices: np.ndarray, body: BodyModel, poses: np.ndarray) -> np.ndarray:
    """Returns ``vertices`` [m] (F, V, 3), those in the skin moved out along the normal of the nearest body vertex."""
    posed = body.posed_vertices(poses)
    return nearest_vertex_push(vertices, posed, np.asarray(BodyContact(body.faces, body.vertex_count).normals(posed)))


@dataclass(frozen=True, eq=False)
class CaseScene:
    """A garment made of ``fabric`` over a clip."""

    garment: Garment
    fabric: Fabric
    clip: CaseClip

    @property
    def name(self) -> dict[str, Any]:
        """Returns the columns of a row that name the scene: garment, fabric and clip."""
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
        """Vertices [m] (F, V, 3) float32 of the network's drape, pose by pose."""
        return network.made_of(self.fabric).drape(self.garment, self.clip.poses).vertices.astype(np.float32)

    def starts(self, networks: dict[str, ModelDrape]) -> dict[str, np.ndarray]:
        """Vertices [m] (F, V, 3) float32 by "skinning", pushed off the skin, and by each of ``networks``."""
        poses = self.clip.poses
        plain = pushed(skinned(self.garment, self.body, poses), self.body, poses).astype(np.float32)
        return {"skinning": plain} | {name: self.network(made) for name, made in networks.items()}


def scenes(options: argparse.Namespace, clips: list[CaseClip], body: BodyModel) -> Iterator[CaseScene]:
    """Every garment, subdivided as the service folds it, in every fabric of the options over each of ``clips``."""
    for clip in clips:
        for path in find_garments(options.garments):
            garment = fine_garment(open_garment(path, body))
            for name in options.fabrics:
                yield CaseScene(garment, fabric(name), clip)


def read_case_clips(options: argparse.Namespace, body: BodyModel, fps: float = FPS) -> list[CaseClip]:
    """The first ``--frames`` of each of ``--motions``."""
    return [CaseClip.read(path, fps, options.frames, body) for path in find_motions(options.motions)]


def lively_clips(names: Sequence[str], frames: int, body: BodyModel, fps: float = FPS) -> list[CaseClip]:
    """Returns a clip for each of ``names``: the ``frames`` in a row (or all) through which limbs turn most. It is named
    ``CLIP@FIRST``.
    """
    clips = []
    for path in find_motions(names) if names else ():
        motion = at_rate(read_motion(path), fps)
        count = min(frames, motion.frame_count)
        turned = np.concatenate([[0.0], np.cumsum(joint_steps(motion)[:, LIMBS].sum(axis=1))])
        first = int(np.argmax(turned[count - 1 :] - turned[: len(turned) - count + 1]))
        one = motion.window(first, count)
        clips.append(CaseClip.of(f"{motion.name}@{first}", fps, one.poses, body, trans=one.trans))
    return clips


def folded_poses(constants: FoldConstants, start: np.ndarray, skin: np.ndarray, effort: FoldEffort) -> np.ndarray:
    """Returns vertices [m] (F, V, 3), float64: the drapes ``start`` (F, V, 3) over the skin samples ``skin`` (F, S, 8)
    after folds.

    Each frame is folded by itself, as a pose without a past.
    """
    frames = (Frame(vertices, samples, 0.0) for vertices, samples in zip(start, skin, strict=True))
    return np.stack([fold(constants, None, frame, effort)[0] for frame in frames]).astype(np.float64)
