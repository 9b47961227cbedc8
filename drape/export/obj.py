"""OBJ of a garment in one frame: the delivered vertices in their order, as a point cache needs them beside itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drape.export.surface import Surface


def obj_text(surfaces: Sequence[Surface], vertices: Sequence[np.ndarray]) -> str:
    """Returns the text of an OBJ file with the ``surfaces``, one after the other, with texture coordinates and names of
    materials. ``vertices`` [m] (V, 3) are those of each surface."""
    lines, first, first_uv = ["# metres, y up"], 1, 1
    for surface, places in zip(surfaces, vertices, strict=True):
        lines += [f"o {surface.name}", *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in places.tolist())]
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in surface.uv.tolist()]
        faces = surface.faces + first
        corners = np.stack([faces, surface.uv_faces + first_uv], axis=2).tolist() if surface.uv_faces.size else None
        for number, name in enumerate(surface.material_names or (surface.name,)):
            own = np.flatnonzero(surface.face_material == number) if surface.material_names else range(len(faces))
            lines.append(f"usemtl {'_'.join(name.split())}")
            if corners is None:
                lines += ["f " + " ".join(map(str, faces[face].tolist())) for face in own]
            else:
                lines += ["f " + " ".join(f"{vertex}/{uv}" for vertex, uv in corners[face]) for face in own]
        first, first_uv = first + len(places), first_uv + len(surface.uv)
    return "\n".join(lines) + "\n"
