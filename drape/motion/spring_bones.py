"""Spring bones as players of VRM move them: the law of VRMC_springBone 1.0 (and of VRM 0), for many springs at once.

A spring turns about its head; its tail is at distance l of it. A step of t seconds moves the tail by

    x' = x + (1 - drag) (x - x_before) + t stiffness a + t gravity g,    a: where the tail points at rest, g: downwards

and back to distance l from the head, then out of each collider in turn and back to l again. Lengths are in the unit of
the file, which in VRM is the metre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RATE_HZ = 60.0  # Players take one step a picture, and the law depends on the rate.
DOWN = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Springs:
    """The constants of E springs, each an array that broadcasts to (..., E): VRM's stiffness, gravityPower, dragForce
    and hitRadius, in the file's unit."""

    stiffness: np.ndarray
    gravity: np.ndarray
    drag: np.ndarray
    radius: np.ndarray


@dataclass(frozen=True, eq=False)
class Capsules:
    """C capsules that springs collide with, in F frames: axes from ``starts`` (F, C, 3) to ``ends`` (F, C, 3), and
    ``radii`` (C,). ``felt`` (E, C) bool says which of them each of E springs feels."""

    starts: np.ndarray
    ends: np.ndarray
    radii: np.ndarray
    felt: np.ndarray


def tails(springs: Springs, heads: np.ndarray, rest_tails: np.ndarray, fps: float, capsules: Capsules) -> np.ndarray:
    """Returns the tails (F, ..., E, 3) of springs with ``heads`` (F, E, 3) in F frames at ``fps`` frames a second.

    ``rest_tails`` (F, E, 3) are where the tails would be if the springs were stiff; in the first frame they are there,
    at rest. All positions are in one frame and unit.
    """
    steps = max(1, round(RATE_HZ / fps))
    step_s, shape = 1.0 / (fps * steps), np.broadcast_shapes(*map(np.shape, vars(springs).values()))
    now = np.broadcast_to(rest_tails[0], (*shape[:-1], *rest_tails[0].shape)).copy()
    before, frames = now.copy(), [now]
    for frame in range(1, len(heads)):
        for part in np.arange(1, steps + 1) / steps:
            head, rest, starts, ends = (
                row[frame - 1] + part * (row[frame] - row[frame - 1])
                for row in (heads, rest_tails, capsules.starts, capsules.ends)
            )
            after = step(springs, now, before, head, rest, step_s)
            for number, radius in enumerate(capsules.radii):
                out = push_out_of_line(after, starts[number], ends[number], radius + np.asarray(springs.radius))
                after = np.where(capsules.felt[:, number, None], on_sphere(out, head, rest), after)
            now, before = after, now
        frames.append(now)
    return np.stack(frames)


def step(
    springs: Springs, now: np.ndarray, before: np.ndarray, head: np.ndarray, rest: np.ndarray, step_s: float
) -> np.ndarray:
    """Returns the tails (..., E, 3) of springs after a step of ``step_s`` [s], without colliders.

    ``now`` and ``before`` (..., E, 3) are the tails now and a step ago. ``head`` (E, 3) and ``rest`` (E, 3), the tails
    of stiff springs, are those after the step.
    """
    axis = (rest - head) / np.linalg.norm(rest - head, axis=-1, keepdims=True)
    stiffness, gravity, drag = (
        np.asarray(one)[..., None] for one in (springs.stiffness, springs.gravity, springs.drag)
    )
    return on_sphere(now + (1.0 - drag) * (now - before) + step_s * (stiffness * axis + gravity * DOWN), head, rest)


def on_sphere(points: np.ndarray, head: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Returns ``points`` (..., E, 3) moved along the line from ``head`` (..., E, 3) until they are as far from it as
    ``rest`` (..., E, 3) is."""
    way, length = points - head, np.linalg.norm(rest - head, axis=-1, keepdims=True)
    return head + way * (length / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-12))


def push_out_of_line(points: np.ndarray, start: np.ndarray, end: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Returns ``points`` (..., 3), of which those nearer than ``reach`` (...) to the line segment from ``start`` to
    ``end`` (..., 3) are moved straight away from it, to that distance."""
    way, off = nearest_off(points, start, end)
    return points + np.maximum(reach - off, 0.0)[..., None] * way


def nearest_off(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the unit vectors (..., 3) to ``points`` (..., 3) from the nearest points of the line segment from
    ``start`` to ``end`` (..., 3), and the distances (...) from these."""
    line = end - start
    along = np.clip(((points - start) * line).sum(axis=-1) / np.maximum((line * line).sum(axis=-1), 1e-12), 0.0, 1.0)
    way = points - start - along[..., None] * line
    off = np.linalg.norm(way, axis=-1)
    return way / np.maximum(off, 1e-12)[..., None], off


def shortest_turns(heads: np.ndarray, rest_tails: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Returns the rotation matrices (..., 3, 3) of the shortest turns about ``heads`` (..., 3) that point what points
    to ``rest_tails`` (..., 3) to ``at`` (..., 3)."""
    a, b = (
        one / np.maximum(np.linalg.norm(one, axis=-1, keepdims=True), 1e-12) for one in (rest_tails - heads, at - heads)
    )
    cosine, v = (a * b).sum(axis=-1)[..., None, None], np.cross(a, b)
    none = np.zeros(v.shape[:-1])
    cross = np.stack([none, -v[..., 2], v[..., 1], v[..., 2], none, -v[..., 0], -v[..., 1], v[..., 0], none], axis=-1)
    cross = cross.reshape(*v.shape[:-1], 3, 3)
    return np.eye(3) + cross + cross @ cross / np.maximum(1.0 + cosine, 1e-9)
