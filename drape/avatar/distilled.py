"""A garment's drape as skinning, on a few more joints below those of a character's rig, which any player shows.

Draped frames become weights and rigid motions (``drape.avatar.skin_decomposition``). Each own joint e hangs below the
joint j of the rig that it moves with most. Seen from there, S = (W_j B_j)^-1 T_e, it hardly moves. So a file's own
clips, which do not animate it, still carry the garment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import dijkstra

from drape.avatar import skin_decomposition as decomposition
from drape.avatar.affine_maps import affine_inverse, compose, rigid_fit
from drape.avatar.file_skeleton import FileRig
from drape.avatar.rig_motion import RigMotion
from drape.avatar.rig_weights import HEAVIEST, garment_weights, heaviest
from drape.avatar.wearer import Wearer
from drape.garment.cache import Garment
from drape.garment.skin import smoothing_matrix
from drape.geometry.mesh_graphs import edge_graph
from drape.wanted import go_on

JOINTS = 32  # Joints of a garment, by default.
FRAMES = 300  # Weights are fitted to at most so many frames.
ROUNDS = 8  # Rounds of fitting weights and then motions.
TRACK_ROUNDS = 6
NEAR, NEAR_RIG = 6, 3  # A vertex may have the nearest of the garment's own joints, and its heaviest joints of the rig.
NEARNESS = 0.02  # ``nearness`` of ``rigid_clusters``.
SMOOTH_M = 5e-3  # In the fit of weights a difference of one from smooth weights costs as much as this distance.
ENOUGH = 2500  # Motions are fitted to at least so many vertices, where a garment has them.
STEADINESS = 1e-3  # ``steadiness`` of ``fit_moves``.
PIVOT_SHARE = 0.02  # The cost of a pivot's distance from the joint's middle, where its squared displacement costs 1.


@dataclass(frozen=True, eq=False)
class DrapedClip:
    """A garment that was draped over a clip: its ``vertices`` [m] (F, V, 3) in the world, and the ``motion`` of the rig
    in these F frames."""

    vertices: np.ndarray
    motion: RigMotion


@dataclass(frozen=True, eq=False)
class Distilled:
    """A garment skinned to n joints of a character's rig and to E joints of its own. Lengths are in the unit of the
    character's file. A joint's motion in a frame is the affine map (3, 4) of points from the bind pose.

    ``rest`` (V, 3) are the vertices in the bind pose and ``weights`` (V, n + E) their skinning weights, the rig's
    joints first. ``joints`` (n,) are the rig's joints as nodes of the skeleton, and ``binds`` (n, 3, 4) their inverse
    bind matrices. The own joints lie at ``pivots`` (E, 3) in the bind pose; ``parents`` (E,) are their parents as
    indices of ``joints``, and ``still`` (E, 3, 4) their motions seen from these while nothing moves them. ``on_rig``
    (V, n) are the skinning weights of the mesh without joints of its own.
    """

    rest: np.ndarray
    weights: np.ndarray
    joints: np.ndarray
    binds: np.ndarray
    parents: np.ndarray
    pivots: np.ndarray
    still: np.ndarray
    on_rig: np.ndarray

    @property
    def count(self) -> int:
        """The number E of the garment's own joints."""
        return len(self.parents)

    def above(self, motion: RigMotion) -> np.ndarray:
        """Returns the motions (F, n, 3, 4) of the rig's joints in the F frames of ``motion``, in the frame of the
        pelvis."""
        seen = compose(affine_inverse(pelvis_places(motion))[:, None], motion.world[1:, self.joints, :3, :])
        return compose(seen, self.binds)

    def carried(self, motion: RigMotion) -> np.ndarray:
        """Returns the motions (F, E, 3, 4) of the own joints where they only follow their parents, in the frame of the
        pelvis."""
        return compose(self.above(motion)[:, self.parents], self.still)

    def fitted(self, draped: DrapedClip, scale: float) -> np.ndarray:
        """Returns the motions (F, E, 3, 4) of the own joints, in the frame of the pelvis, that bring the mesh nearest
        to the clip ``draped``. ``scale``: metres per unit of the file."""
        some = slice(None, None, max(1, len(self.rest) // ENOUGH))
        rest, weights, above = self.rest[some], self.weights[some], self.above(draped.motion)
        frames = seen_from_pelvis(DrapedClip(draped.vertices[:, some], draped.motion), scale)
        own = slice(above.shape[1], None)
        moves = np.concatenate([above, self.carried(draped.motion)], axis=1)
        strongest = weights[:, own].argmax(axis=1)
        for joint in range(self.count):
            rows = np.flatnonzero((strongest == joint) & (weights[:, own].max(axis=1) > 0.0))
            if len(rows) >= 3:
                moves[:, above.shape[1] + joint] = rigid_fit(rest[rows], frames[:, rows])
        free = np.arange(above.shape[1], moves.shape[1])
        more = {"rounds": TRACK_ROUNDS, "steadiness": STEADINESS}
        return decomposition.fit_moves(weights, rest, frames, moves, free, **more)[:, own]

    def placed(self, motion: RigMotion, moves: np.ndarray) -> np.ndarray:
        """Returns the vertices (F, V, 3) of the mesh, in the frame of the pelvis and the unit of the file, where its
        own joints have the motions ``moves`` (F, E, 3, 4) in the frame of the pelvis."""
        return decomposition.blend_vertices(
            self.weights, self.rest, np.concatenate([self.above(motion), moves], axis=1)
        )

    def error_m(self, draped: DrapedClip, moves: np.ndarray, scale: float) -> float:
        """Returns the root mean square distance [m] between the vertices of ``draped`` and those of the mesh whose own
        joints have the motions ``moves`` (F, E, 3, 4) in the frame of the pelvis. ``scale``: metres per unit of the
        file."""
        off = self.placed(draped.motion, moves) - seen_from_pelvis(draped, scale)
        return float(scale * np.sqrt((off**2).sum(axis=-1).mean()))

    def local(self, motion: RigMotion, moves: np.ndarray) -> np.ndarray:
        """Returns the motions (F, E, 3, 4) of the garment's E own joints from the bind pose, as seen from their
        parents; translations are in the unit of the file. ``moves`` (F, E, 3, 4) are these motions in the frame of the
        pelvis."""
        return compose(affine_inverse(self.above(motion)[:, self.parents]), moves)


def distil(
    garment: Garment,
    clips: Sequence[DrapedClip],
    wearer: Wearer,
    rig: FileRig,
    *,
    count: int = JOINTS,
    poses: Sequence[DrapedClip] = (),
) -> Distilled:
    """Returns ``garment`` skinned to the rig of ``wearer`` and to ``count`` joints of its own, fitted to draped frames.

    The joints hang where they move least in the frames of ``clips``. The weights are fitted to ``clips`` and to
    ``poses`` together. ``rig`` is that of the wearer's file.
    """
    hung = _on_rig(garment, clips[0].motion, wearer, rig)
    rest, rig_weights = hung.rest, hung.weights
    frames, above, usual = _chosen_frames([*clips, *poses], wearer.scale, hung, len(clips))
    faces, some = garment.surface.faces.astype(np.int64), slice(None, None, 4)
    cluster, _ = decomposition.rigid_clusters(rest, frames[some], count, nearness=NEARNESS)
    moves = [rigid_fit(rest[cluster == one], frames[:, cluster == one]) for one in range(count)]
    moves = np.concatenate([above, np.stack(moves, axis=1)], axis=1)
    candidates = _candidates(rest, faces, cluster, rig_weights)
    smooth, few = smoothing_matrix(faces, len(rest)), slice(None, None, max(1, len(rest) // ENOUGH))
    stiffness, free = (SMOOTH_M / wearer.scale) ** 2, np.arange(above.shape[1], moves.shape[1])
    weights = np.pad(rig_weights, ((0, 0), (0, count)))
    for _ in range(ROUNDS):
        go_on()
        weights = decomposition.fit_weights(
            rest, frames, moves, candidates, most=HEAVIEST, past=weights, pull=smooth @ weights, stiffness=stiffness
        )
        moves = decomposition.fit_moves(weights[few], rest[few], frames[:, few], moves, free)
    parents, pivots, still = _hung(rest, weights[:, free], above[:usual], moves[:usual, free])
    return replace(hung, weights=weights, parents=parents, pivots=pivots, still=still)


def _on_rig(garment: Garment, motion: RigMotion, wearer: Wearer, rig: FileRig) -> Distilled:
    """The garment without joints of its own, its mesh in the bind pose in the unit of the world."""
    weights, skeleton = garment_weights(garment, wearer, rig), rig.skeleton
    at = garment.drawn_at_rest() / wearer.scale
    bones, kept = heaviest(weights, np.zeros(len(at), dtype=bool))
    used = np.unique(bones[kept > 0.0])
    # One unit of the skin is so many of the world.
    unit = np.cbrt(np.abs(np.linalg.det(motion.blends[0, used, :3, :3]))).mean()
    joints, binds = skeleton.joints[used], skeleton.binds[used, :3, :] / [unit, unit, unit, 1.0]
    dense = np.zeros((len(bones), len(used)))
    np.add.at(dense, (np.arange(len(bones))[:, None], np.searchsorted(used, bones) % len(used)), kept)
    blend = np.tensordot(dense, compose(motion.world[0, joints, :3, :], binds), axes=1)
    rest = np.linalg.solve(blend[:, :, :3], (at - blend[:, :, 3])[..., None])[..., 0]
    none = np.zeros((0, 3, 4))
    return Distilled(rest, dense, joints, binds, np.zeros(0, dtype=np.int64), none[..., 3], none, dense)


def _chosen_frames(
    clips: Sequence[DrapedClip], scale: float, hung: Distilled, first: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """Some frames (F, V, 3) of all ``clips``, evenly, and motions (F, n, 3, 4) of the rig, seen from the pelvis; how
    many of them are of the ``first`` clips."""
    step = max(1.0, sum(len(clip.vertices) for clip in clips) / FRAMES)
    frames, above = [], []
    for clip in clips:
        rows = np.arange(0.0, len(clip.vertices), step).astype(int)
        part = DrapedClip(clip.vertices[rows], clip.motion.part(rows))
        frames.append(seen_from_pelvis(part, scale))
        above.append(hung.above(part.motion))
    return np.concatenate(frames), np.concatenate(above), sum(map(len, frames[:first]))


def seen_from_pelvis(draped: DrapedClip, scale: float) -> np.ndarray:
    """Returns the vertices (F, V, 3) of ``draped`` in the frame of the pelvis's node, in the unit of the file.
    ``scale``: metres per unit."""
    at = pelvis_places(draped.motion)
    return (draped.vertices / scale - at[:, None, :, 3]) @ at[:, :, :3]


def pelvis_places(motion: RigMotion) -> np.ndarray:
    """Returns the transforms (F, 3, 4) of the pelvis's node to the world in the F frames of ``motion``, without its
    scale: rotations, and translations in the unit of the file."""
    at = motion.world[1:, motion.pelvis, :3, :].copy()
    at[:, :, :3] /= np.linalg.norm(at[:, :, :3], axis=1, keepdims=True)
    return at


def _candidates(rest: np.ndarray, faces: np.ndarray, cluster: np.ndarray, rig_weights: np.ndarray) -> np.ndarray:
    """The joints (V, C) that a vertex may have: some of the rig, then those of clusters near along the cloth."""
    count, bones = cluster.max() + 1, rig_weights.shape[1]
    middles = [rest[cluster == one].mean(axis=0) for one in range(count)]
    away = np.stack([np.linalg.norm(rest - middle, axis=1) for middle in middles])
    seeds = np.where(cluster == np.arange(count)[:, None], away, np.inf).argmin(axis=1)
    along = dijkstra(edge_graph(rest, faces), directed=False, indices=seeds)
    nearest = np.where(np.isfinite(along), along, 3.0 * away).T.argsort(axis=1)[:, :NEAR]
    return np.concatenate([rig_weights.argsort(axis=1)[:, ::-1][:, :NEAR_RIG], bones + nearest], axis=1)


def _hung(
    rest: np.ndarray, weights: np.ndarray, above: np.ndarray, moves: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parents (E,) of joints with ``weights`` (V, E) at ``moves`` (F, E, 3, 4): those of ``above`` (F, n, 3, 4) in
    whose frames they move least. And their pivots (E, 3), and where they are in these frames while still (E, 3, 4)."""
    inverse, parents, pivots, stills = affine_inverse(above), [], [], []
    for joint in range(moves.shape[1]):
        share = weights[:, joint]
        share = share / max(share.sum(), 1e-12)
        middle = share @ rest
        reach = np.linalg.cholesky((rest - middle).T @ (share[:, None] * (rest - middle)) + 1e-12 * np.eye(3))
        corners = np.concatenate([[middle], middle + reach.T, middle - reach.T])
        seen = compose(inverse, moves[:, joint, None])  # (F, n, 3, 4)
        at = seen[..., :3] @ corners.T + seen[..., 3:]
        parent = int(((at - at.mean(axis=0)) ** 2).sum(axis=(0, 2, 3)).argmin())
        still = rigid_fit(corners, at[:, parent].mean(axis=0).T[None])[0]
        parents.append(parent)
        stills.append(still)
        pivots.append(_pivot(seen[:, parent], still, middle))
    return np.array(parents), np.stack(pivots), np.stack(stills)


def _pivot(moves: np.ndarray, still: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """The point (3,) that ``moves`` (F, 3, 4) bring least away from where ``still`` (3, 4) has it: the least sum of
    |(R - R0) h + t - t0|^2 + s |h - m|^2, s so small that it only counts where the motions do not tell."""
    off = moves - still
    turns, ways = off[:, :, :3], off[:, :, 3]
    square = np.einsum("fab,fac->bc", turns, turns)
    hold = PIVOT_SHARE * max(np.trace(square), 1e-12) * np.eye(3)
    return np.linalg.solve(square + hold, hold @ middle - np.einsum("fab,fa->b", turns, ways))
