"""The recovered garment on other bodies and in other poses (figure 6 of Yu, Cordier and Seo 2024)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.material import OrthotropicMaterial
from drape.errors import InputError
from drape.garment.contours import lost_parts
from recovery.drape.pattern_drape import Draped, DrapeOptions, drape_in_pose, drape_pattern
from recovery.drape.posing import posed_joints, read_pose
from recovery.pattern.model import Pattern
from recovery.run.target_wearer import shaped_body

# Shapes of the shipped body: its first component is height, its second how narrow the chest is over the hips.
BODIES: dict[str, tuple[float, ...]] = {"a smaller body": (-0.7,), "a narrower chest": (0.0, 2.0)}
POSES = ("reach:110", "stretch:60")


@dataclass(frozen=True, eq=False)
class WornElsewhere:
    """A garment on another body or in another pose: ``nodes`` [m] (N, 3) and ``faces`` on ``skin`` [m] (V, 3), or the
    ``refusal`` that says why not.

    ``lost``: parts of the body that should go through an opening and do not, such as an arm beside its sleeve.
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
) -> Iterator[WornElsewhere]:
    """``pattern`` sewn and draped on two other shapes of ``standard``, and taken to two poses of ``body``.

    ``sewn`` is its drape on ``body`` in the T-pose; ``parts`` of the body should go through its openings;
    ``cloth`` is what it is made of. A drape that is refused becomes a ``WornElsewhere`` that says why.
    """
    wearers = [(what, shaped_body(standard, np.array(betas)), None) for what, betas in BODIES.items()]
    wearers += [(f"pose {text}", body, read_pose(text)) for text in POSES]
    for what, wearer, pose in wearers:
        skin = wearer.v_template if pose is None else wearer.posed_vertices(pose[None])[0]
        try:
            if pose is None:
                draped = drape_pattern(pattern, wearer, options, cloth=cloth)
                nodes, faces, figures = draped.rest.nodes, draped.mesh.faces, draped.figures["rest"]
            else:
                posed, figures = drape_in_pose(sewn.mesh, sewn.rest, wearer, pose, options, cloth=cloth)
                nodes, faces = posed.nodes, sewn.mesh.faces
        except InputError as error:
            nothing = np.zeros((0, 3))
            yield WornElsewhere(what, skin, wearer.faces, nothing, nothing.astype(np.int64), {}, refusal=str(error))
            continue
        lost = lost_parts(nodes, faces, posed_joints(wearer, pose), parts)
        yield WornElsewhere(what, skin, wearer.faces, nodes, faces, figures, lost=lost)
