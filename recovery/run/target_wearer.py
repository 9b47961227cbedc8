"""The wearer of a target: a named body, a file in SMPL's schema, a surface, or a body fitted inside the garment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.errors import BodyError, MeshError
from drape.files.formats import MESH_SUFFIXES
from drape.garment.avatars import Avatar
from drape.garment.files.mesh import AVATAR_VERTEX_LIMIT, GarmentMesh, read_mesh, weld
from drape.garment.inside import InsideFit, check_inside, fit_inside
from drape.garment.mesh_checks import UNITS_M
from drape.garment.registration import body_units, fit_body
from drape.geometry import meshes
from recovery import progress
from recovery.pattern.model import Pattern
from recovery.run.upright import facing, turned_about, up_axis

SIZE_SLACK = 2.0  # by which a target's height may differ from its base's
RIVAL_SLACK = 1.3  # by which the next unit must fit worse
# Logarithms of the ratio by which a body has to fit worse the one way: an upper opening that is lower there weighs as
# much, that the file looks the other way as much. Of 14 garments the right way fits better by 1.26 to 7.8, one by 0.96.
LOWER_IN_FRONT, KEPT, UNSURE = 0.15, 0.1, 0.1
Front = Literal["auto", "kept", "turned"]


@dataclass(frozen=True, eq=False)
class Wearer:
    """The body ``standard`` in the shape ``betas`` and in ``pose`` (24, 3), None for the T-pose.

    ``trans`` [m] (3,) is added to everything in the target's frame; ``residual_mm`` is the mean distance of a fitted
    body from the surface that it was fitted to.
    """

    standard: BodyModel
    betas: np.ndarray
    pose: np.ndarray | None
    trans: np.ndarray
    source: str
    residual_mm: float = 0.0

    @cached_property
    def shaped(self) -> BodyModel:
        """The body with its shape in the template."""
        return shaped_body(self.standard, self.betas)

    @property
    def skin(self) -> Avatar:
        """Its surface in its pose, in the target's frame."""
        pose = np.zeros((JOINT_COUNT, 3)) if self.pose is None else self.pose
        vertices = self.shaped.posed_vertices(pose[None])[0] + self.trans
        return Avatar(vertices, self.shaped.faces, self.residual_mm, self.source)


def shaped_body(body: BodyModel, betas: np.ndarray) -> BodyModel:
    """``body`` whose template has the shape ``betas``; itself where they are zero."""
    betas = body.check_betas(betas)
    if not betas.any():
        return body
    return replace(body, name=f"{body.name}_shaped", v_template=body.rest_vertices(betas))


def read_wearer(source: str, *, betas: np.ndarray | None = None, pose: np.ndarray | None = None) -> Wearer:
    """The wearer at ``source``: a shipped name, a file .npz or .pkl, or a surface that the shipped body is fitted to.

    ``betas`` and ``pose`` (24, 3) are those of a body in SMPL's schema; a surface brings its own.
    """
    path = Path(source)
    if path.suffix.lower() in MESH_SUFFIXES:
        if betas is not None or pose is not None:
            raise BodyError(
                "--body",
                expected="a surface alone, which has its own shape and pose",
                got=f"{path.name} with --betas or --pose",
                cure="Leave them out.",
            )
        return fitted_wearer(path, load_body())
    body = load_body(source)
    check_closed(body.faces, body.name)
    betas = body.check_betas(np.zeros(0) if betas is None else betas)
    return Wearer(body, betas, pose, np.zeros(3), f"body {body.name}")


def fitted_wearer(path: Path, body: BodyModel) -> Wearer:
    """The shipped body fitted to the closed surface in ``path``."""
    mesh = weld(read_mesh(path, vertex_limit=AVATAR_VERTEX_LIMIT))
    check_closed(mesh.faces, path.name)
    scale, vertices = body_units(mesh.vertices, name=path.name)
    found = fit_body(vertices, mesh.faces, body, name=path.name)
    unit = "" if scale == 1.0 else f", scaled by {scale:g}"
    source = f"body {body.name} fitted to {path.name}{unit}, {found.residual_mm:.1f} mm from it on average"
    return Wearer(body, found.betas, found.pose, found.trans, source, found.residual_mm)


def check_closed(faces: np.ndarray, name: str) -> None:
    """Refuses a body with holes, which has no inside."""
    loops = meshes.boundary_loops(faces)
    if loops:
        raise BodyError(
            f"body {name}",
            expected="a closed surface",
            got=f"{len(loops)} open borders, the longest of {len(loops[0])} vertices",
            cure="Close its holes (neck, wrists, eyes), join copies of vertices, or take a body that ships (--body).",
        )


def inside_wearer(
    mesh: GarmentMesh,
    bases: Sequence[Pattern],
    *,
    unit: str = "auto",
    up: str = "auto",
    front: Front = "auto",
    wanted: dict[str, int] | None = None,
) -> tuple[GarmentMesh, Wearer]:
    """Returns ``mesh`` in metres, y up, and the shipped body fitted inside it.

    ``bases`` are patterns of its kind, all drafted for that body; the one in which the body fits best tells size and
    place. ``wanted``: the openings that its kind has. With ``up`` "auto" the openings tell the axis. The wearer looks
    along +z as in the file or, with ``front`` "auto", the other way if the body and the upper opening say so.
    """
    if (up_axis(mesh) if up == "auto" else up) == "z":
        turned = np.stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]], axis=1)
        mesh = replace(mesh, vertices=turned).noted("turned from z up to y up")
    sideways, cue = facing(mesh)
    kept = KEPT if sideways is mesh else 0.0
    vertices, notes = sideways.vertices, []
    placed = [np.concatenate([one.placement.apply(one.vertices)[:, 1] for one in base.panels]) for base in bases]
    heights, height = [float(np.ptp(one)) for one in placed], float(np.ptp(vertices[:, 1]))
    misfit = {
        name: min(abs(np.log(max(height * scale, 1e-9) / one)) for one in heights) for name, scale in UNITS_M.items()
    }
    name = min(misfit, key=lambda one: misfit[one]) if unit == "auto" else unit
    second = sorted(misfit.values())[1]
    unsure = misfit[name] > np.log(SIZE_SLACK) or second - misfit[name] < np.log(RIVAL_SLACK)
    if unit == "auto" and unsure:
        raise MeshError(
            "target unit",
            expected=f"a garment about {heights[0]:.2f} m high, as its base, in m, dm, cm, mm or inch",
            got=f"a height of {height:.4g}",
            cure="Say the unit (--unit) and the up axis (--up), or take a base of the target's kind (--base).",
        )
    if name != "m":
        notes.append(f"converted from {name} to m")
    mesh = replace(sideways, vertices=UNITS_M[name] * vertices).noted(*notes)
    body, about = load_body(), turned_about(mesh, np.pi)

    def fitted(one: GarmentMesh) -> InsideFit:
        fits = [fit_inside(one, body, top_m=float(base.max()), wanted=wanted, tick=progress.tick) for base in placed]
        return min(fits, key=lambda fit: fit.cost_m2)

    with progress.stage("a body is fitted inside"):
        if front == "auto" and cue:
            ways = [fitted(mesh), fitted(about)]
            score = float(np.log(ways[0].cost_m2 / ways[1].cost_m2)) - LOWER_IN_FRONT * cue - kept
            turn = score > 0.0
            inside, doubt = ways[turn], abs(score) < UNSURE or (cue < 0) != turn
            other = "kept" if turn else "turned"
            words = f"front and back are not plain: pass --front {other} if it is worn back to front"
            mesh = (about if turn else mesh).noted(*[words] * doubt)
        else:
            mesh = about if front == "turned" else mesh
            inside = fitted(mesh)
        check_inside(inside)
    source = (
        f"body {body.name} fitted inside the target: cloth {inside.mean_mm:.0f} mm from the skin on average "
        f"and {inside.band_mm:.0f} mm where it hangs, "
        f"{inside.inside_pct:.1f} % of it inside by up to {inside.depth_mm:.0f} mm"
    )
    return mesh, Wearer(body, inside.betas, inside.pose, inside.trans, source, inside.mean_mm)
