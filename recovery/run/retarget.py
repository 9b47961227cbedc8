"""The recovered garment on other bodies and in other poses (figure 6 of Yu, Cordier and Seo 2024)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.orthotropic import OrthotropicMaterial
from drape.errors import InputError
from recovery.drape.pipeline import Draped, DrapeOptions, drape_in_pose, drape_pattern
from recovery.drape.posing import posed_joints, read_pose
from recovery.fit.contours import bone_chains, encircles, open_contours
from recovery.pattern.model import Pattern
from recovery.run.wearer import shaped_body

# Shapes of the shipped body: its first component is height, its second how narrow the chest is over the hips.
BODIES: dict[str, tuple[float, ...]] = {"a smaller body": (-0.7,), "a narrower chest": (0.0, 2.0)}
POSES = ("reach:110", "stretch:60")


@dataclass(frozen=True, eq=False)
class Worn:
    """A garment somewhere else: ``nodes`` [m] (N, 3) and ``faces`` on ``skin`` [m] (V, 3); or why not (``refusal``).

    ``lost`` are the parts of the body that should go through an opening and do not: an arm beside its sleeve.
    """

    what: str
    skin: np.ndarray
    skin_faces: np.ndarray
    nodes: np.ndarray
    faces: np.ndarray
    figures: dict[str, Any]
    refusal: str = ""
    lost: tuple[str, ...] = ()


def retargeted(
    pattern: Pattern,
    sewn: Draped,
    body: BodyModel,
    standard: BodyModel,
    options: DrapeOptions,
    parts: Sequence[str] = (),
    *,
    cloth: OrthotropicMaterial,
) -> Iterator[Worn]:
    """``pattern`` sewn and draped on two other shapes of ``standard``, and taken to two poses of ``body``.

    ``sewn`` is its drape on ``body`` in the T-pose; ``parts`` of the body should go through its openings;
    ``cloth`` is what it is made of.
    What cannot be draped says so instead of ending the rest.
    """
    for what, betas in BODIES.items():
        other = shaped_body(standard, np.array(betas))

        def sew(wearer: BodyModel = other) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
            draped = drape_pattern(pattern, wearer, options, cloth=cloth)
            return draped.rest.nodes, draped.mesh.faces, draped.figures["rest"]

        worn = _worn(what, other.v_template, other.faces, sew)
        yield replace(worn, lost=lost_parts(worn.nodes, worn.faces, other.joints_template, parts))
    for text in POSES:
        pose = read_pose(text)

        def move(there: np.ndarray = pose) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
            posed, figures = drape_in_pose(sewn.mesh, sewn.rest, body, there, options, cloth=cloth)
            return posed.nodes, sewn.mesh.faces, figures

        worn = _worn(f"pose {text}", body.posed_vertices(pose[None])[0], body.faces, move)
        yield replace(worn, lost=lost_parts(worn.nodes, worn.faces, posed_joints(body, pose), parts))


def lost_parts(nodes: np.ndarray, faces: np.ndarray, joints: np.ndarray, parts: Sequence[str]) -> tuple[str, ...]:
    """Those of ``parts`` that do not go through an opening of a garment at ``nodes`` [m] (N, 3), one opening for each.

    ``joints`` [m] (24, 3) are those of the body in its pose. Empty for a garment without faces.
    """
    if not len(faces):
        return ()
    chains = bone_chains(joints)
    there = Counter(
        part
        for contour in open_contours(nodes, faces)
        for part in [next((name for name, (chain, _) in chains.items() if encircles(contour, chain)), None)]
        if part is not None
    )
    return tuple(sorted((Counter(parts) - there).elements()))


def _worn(
    what: str,
    skin: np.ndarray,
    skin_faces: np.ndarray,
    drape: Callable[[], tuple[np.ndarray, np.ndarray, dict[str, Any]]],
) -> Worn:
    try:
        nodes, faces, figures = drape()
    except InputError as error:
        empty = np.zeros((0, 3))
        return Worn(what, skin, skin_faces, empty, empty.astype(np.int64), {}, str(error))
    return Worn(what, skin, skin_faces, nodes, faces, figures)
