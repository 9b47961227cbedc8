"""The garment as the product keeps it: patches, charts and skin weights, content-addressed on disk.

A cache file is one npz of plain arrays (the fields of ``Garment``), packed by LZMA: a fifth smaller than numpy's own
packing, and ``numpy.load`` reads it too. The bytes of the array ``header`` are one JSON object of all text, the
manifest included. Where ``fine_faces`` equal ``faces`` they are left out, and the header says so. Where each row of
``uv`` is of one vertex, ``uv_vertex`` (T,) stands for ``faces``. The file's name is ``NAME-DIGEST16.npz``; the digest
covers the source mesh, the body, the intake options and ``FORMAT_VERSION``, not the file's name or time.
``python -m drape.garment.cache FILE`` prints what a file holds.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric_table import DEFAULT_FABRIC
from drape.cloth.rest_state import RestState
from drape.errors import ArtifactError, NotFound, Unavailable, refusing
from drape.files.atomic import whole_file
from drape.files.looks import NO_LOOKS, Looks, looks_of
from drape.files.notes import warnings_of
from drape.files.packed import UNREADABLE, pack, read_packed
from drape.folders import ASSETS, RUNS
from drape.garment.bound import ARRAYS as BOUND_ARRAYS
from drape.garment.bound import BoundMesh, Drawer
from drape.garment.skin import BodyBinding, bind_to_body
from drape.geometry import jets, meshes

FORMAT_VERSION = 1  # raised when a garment means something else; digests cover it
FILE_VERSION = 2  # raised when it is stored otherwise
READ_VERSIONS = (1, FILE_VERSION)  # files of the first version also hold arrays that follow from body and charts
GARMENTS_DIR = ASSETS / "garments"
OWN_GARMENTS_DIR = RUNS / "garments"  # garments of users, which the service reads too
CHARTS_PER_VERTEX = 4
SAME_M = 5e-7  # rounding of float32 for positions within a few metres


@dataclass(frozen=True, eq=False)
class Atlas:
    """One partition of a garment at rest into K patches, and the charts by which they cover its N vertices.

    Patches, in the body's frame: ``patch_rotation`` (K, 3, 3), columns u axis, v axis, normal; ``patch_centre`` [m] (K,
    3); ``patch_scale`` (K,) [m per unit of u, v]; ``patch_jet`` (K, 27), the jet at rest [patch scales];
    ``patch_weights`` (K, 24), bone weights; ``patch_shapedirs`` (K, 3, S), movement of the centre [m per unit of beta];
    ``patch_features`` (K, D), input of the garment encoder, as the function of that name returns it;
    ``patch_neighbours`` (E, 2), pairs of patches that share a boundary.

    Charts, four a vertex: ``chart_patch`` (N, 4), the patch; ``chart_uv`` (N, 4, 2), the place in it; ``chart_weight``
    (N, 4), rows summing to one, 0 for a chart that is not used; ``chart_residual`` (N, 4, 3) [m], rest position minus
    jet, in the patch's frame.
    """

    patch_rotation: np.ndarray
    patch_centre: np.ndarray
    patch_scale: np.ndarray
    patch_jet: np.ndarray
    patch_weights: np.ndarray
    patch_shapedirs: np.ndarray
    patch_features: np.ndarray
    patch_neighbours: np.ndarray
    chart_patch: np.ndarray
    chart_uv: np.ndarray
    chart_weight: np.ndarray
    chart_residual: np.ndarray

    @property
    def patch_count(self) -> int:
        return len(self.patch_centre)

    @property
    def heaviest_bone(self) -> np.ndarray:
        """Returns for each patch the joint number (K,) int64 of the bone with the largest weight."""
        return np.argmax(self.patch_weights, axis=1).astype(np.int64)

    def chart_local(self) -> np.ndarray:
        """Returns the rest positions [m] (N, 4, 3) of every vertex in the frames of its four patches, from the patches'
        centres."""
        jet = self.patch_jet[self.chart_patch].astype(np.float64)
        scale = self.patch_scale[self.chart_patch].astype(np.float64)[..., None]
        return scale * jets.evaluate_jet(jet, self.chart_uv.astype(np.float64)) + self.chart_residual


@dataclass(frozen=True, eq=False)
class Garment(Atlas):
    """A garment at rest on the standard body in the T-pose. Lengths are in metres, in the body's frame.

    Every array of vertices begins with the ``vertex_count`` delivered vertices, in the order of the file. The rows
    after them were added by subdivision; the network's fit and folds use them too.

    ``vertices`` (N, 3): positions at rest. ``faces`` (F, 3): the delivered triangles. ``fine_faces`` (G, 3): the
    triangles of the subdivided mesh. ``uv`` (T, 2) and ``uv_faces`` (F, 3): texture coordinates, empty if the file has
    none. ``material_names`` and ``face_material`` (F,): the materials, and the number of each triangle's.

    ``rest_edges`` (G, 2, 2), ``rest_angle`` (H,) and ``rest_stiffening`` (H,): the ``RestState`` of ``fine_faces``.
    They are None in files of older versions; ``rest_state`` returns one for every garment. ``fabric``: the name of a
    fabric, or its numbers as ``drape.cloth.fabric_table.fabric`` takes them. ``looks``: those of the materials.

    ``drawn``: the mesh of the file, bound to the cloth, where another mesh is draped in its place; None where the cloth
    is the mesh of the file. Only a mantle, which covers arms and has no sleeves, has ``arm_share`` (N,), how far each
    vertex follows its arm, and ``arm_ways`` [m] (N, 6, 3), displacements from rest for the arms along each of
    ``mantle_shapes.DIRECTIONS``.

    ``digest``: hex, of all that the garment was made of; ``body_digest``: that of its body. ``manifest``: the record of
    its making, for JSON. Intake writes "source" ("sha256" of the file, "vertex_count", "face_count"), "avatar"
    ("source", "residual_mm"), "options" (``IntakeOptions``), "notes", "intake" (``RestMesh.figures``), "fit"
    (``fit_error``, "patch_count", "area_m2") and "rest" (``RestFigures``). Some garments also have "carried_by", the
    bones of an accessory; "layers", the number of garments in the file; "wearer" (``pictured``); or "size".
    """

    name: str
    digest: str
    body_digest: str
    vertex_count: int
    vertices: np.ndarray
    faces: np.ndarray
    fine_faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    material_names: tuple[str, ...]
    face_material: np.ndarray
    manifest: dict[str, Any] = field(default_factory=dict)
    rest_edges: np.ndarray | None = None
    rest_angle: np.ndarray | None = None
    rest_stiffening: np.ndarray | None = None
    fabric: str | Mapping[str, Any] = DEFAULT_FABRIC
    looks: Looks = NO_LOOKS
    drawn: BoundMesh | None = None
    arm_share: np.ndarray | None = None
    arm_ways: np.ndarray | None = None

    @property
    def carriers(self) -> tuple[str, ...]:
        """Returns the names of the bones that carry the garment rigidly, as a hat or shoes; empty for cloth."""
        return tuple(self.manifest.get("carried_by", ()))

    @property
    def surface(self) -> Garment | BoundMesh:
        """Returns the mesh to draw: ``drawn``, or the garment itself with its delivered triangles if ``drawn`` is
        None."""
        return self if self.drawn is None else self.drawn

    def drawn_vertices(self, vertices: np.ndarray) -> np.ndarray:
        """Returns the vertices [m] (..., D, 3) of ``surface`` when the delivered vertices are at ``vertices`` [m] (...,
        V, 3), in the same frame."""
        if self.drawn is None:
            return vertices
        drawer = self.drawer
        flat = vertices.reshape(-1, *vertices.shape[-2:])
        return np.stack([drawer.draw(one) for one in flat]).reshape(*vertices.shape[:-2], -1, 3)

    def drawn_at_rest(self) -> np.ndarray:
        """Returns the vertices [m] (D, 3) float32 of ``surface`` at rest."""
        return self.drawn_vertices(self.vertices[: self.vertex_count].astype(np.float32, copy=False))

    @cached_property
    def drawer(self) -> Drawer:
        """Returns what computes the vertices of ``drawn`` from the delivered ones; ``drawn`` must not be None."""
        assert self.drawn is not None
        return Drawer(self.drawn, self.faces)

    def skin_weights(self, body: BodyModel) -> np.ndarray:
        """Returns the bone weights (N, 24) float32 of linear skinning, rows summing to one. ``body`` is the one that
        the garment was made for; they are computed once."""
        if "_skin_weights" not in self.__dict__:
            self.__dict__["_skin_weights"] = self.binding(body).weights.astype(np.float32)
        return self.__dict__["_skin_weights"]

    def binding(self, body: BodyModel) -> BodyBinding:
        """Returns the bone weights and the shape movement of all N vertices on ``body``, for which the garment was
        made."""
        return bind_to_body(self.vertices, self.fine_faces, body, arm=self.arm_share)

    def rest_state(self) -> RestState:
        """Returns the unstressed edges, hinge angles and stiffening of the triangles ``fine_faces``: the stored ones,
        or if there are none those that ``rest_detail.rest_of`` finds. Raises ``ArtifactError`` where the stored arrays
        do not fit the mesh."""
        return self._rest_state

    @cached_property
    def _rest_state(self) -> RestState:
        stored = (self.rest_edges, self.rest_angle, self.rest_stiffening)
        if all(array is None for array in stored):
            return self._rest_of_mesh(self.vertices, self.fine_faces)
        hinge_count = len(meshes.hinges(self.fine_faces))
        shapes = {"rest_edges": (len(self.fine_faces), 2, 2), "rest_angle": (hinge_count,)}
        shapes["rest_stiffening"] = (hinge_count,)
        for (name, shape), array in zip(shapes.items(), stored, strict=True):
            if array is None or array.shape != shape:
                got = "nothing" if array is None else f"shape {array.shape}"
                raise _refused(f"garment {self.name} {name}", f"shape {shape}", got)
        return RestState(*(np.asarray(array, dtype=np.float64) for array in stored))

    def delivered_rest(self) -> RestState:
        """Returns the unstressed edges, hinge angles and stiffening of the triangles ``faces``: the stored ones, or if
        the triangles were subdivided those that ``rest_detail.rest_of`` finds."""
        if len(self.vertices) == self.vertex_count:
            return self.rest_state()
        return self._rest_of_mesh(self.vertices[: self.vertex_count], self.faces)

    def _rest_of_mesh(self, vertices: np.ndarray, faces: np.ndarray) -> RestState:
        # Imported here because only simulation needs it, and the service starts without.
        from drape.garment.rest_detail import cloth_of, rest_of

        on_corners, materials = (self.uv, self.uv_faces), (self.material_names, self.face_material)
        return rest_of(cloth_of(vertices, faces, on_corners, materials))[0]

    def file_name(self) -> str:
        return f"{self.name}-{self.digest[:16]}.npz"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Returns the notes of intake for whoever sent the file: the warnings of its manifest."""
        return warnings_of(self.manifest.get("notes", ()))


_BY_COLUMNS = ("vertices", "uv", "chart_uv", "chart_weight", "chart_residual")
"""Arrays that pack a twentieth smaller where each coordinate stands by itself."""
_ONCE_STORED = ("skin_weights", "shapedirs")
_TEXT_KINDS = {"name": str, "digest": str, "body_digest": str, "vertex_count": int, "manifest": dict}
_TEXT_FIELDS = ("name", "digest", "body_digest", "vertex_count", "material_names", "manifest", "fabric")


def save_garment(garment: Garment, folder: Path, *, quick: bool = False) -> Path:
    """Writes ``garment`` into ``folder``, which is made if needed, and returns the path of the cache file. The file is
    written atomically; ``quick`` packs it faster and larger (``pack``). Raises ``Unavailable`` where the folder
    cannot be made or written."""
    left_out = (*_TEXT_FIELDS, "looks", "drawn")
    arrays, drawn = {f.name: getattr(garment, f.name) for f in fields(Garment) if f.name not in left_out}, garment.drawn
    arrays = {name: array for name, array in arrays.items() if array is not None}
    header = {key: getattr(garment, key) for key in _TEXT_FIELDS} | {"format_version": FILE_VERSION}
    looks = garment.surface.looks
    if any(looks.materials):
        header["looks"] = looks.to_json()
        arrays["pictures"] = np.frombuffer(b"".join(looks.pictures), dtype=np.uint8)
    if np.array_equal(garment.fine_faces, garment.faces):
        del arrays["fine_faces"]
        header["fine_faces"] = "faces"
    uv_vertex = np.zeros(len(garment.uv), dtype=garment.faces.dtype)
    uv_vertex[garment.uv_faces.reshape(-1)] = garment.faces[: len(garment.uv_faces)].reshape(-1)
    if np.array_equal(uv_vertex[garment.uv_faces], garment.faces):
        del arrays["faces"]
        arrays["uv_vertex"] = uv_vertex
    if _tells_residual(arrays):
        del arrays["chart_residual"]
    arrays |= {name: np.asfortranarray(arrays[name]) for name in _BY_COLUMNS if name in arrays}
    if drawn is not None:
        arrays |= {f"drawn_{name}": getattr(drawn, name) for name in BOUND_ARRAYS}
        header["drawn_materials"] = drawn.material_names
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    content, path = pack(arrays, quick=quick), folder / garment.file_name()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as file:
            file.write(content)
    except OSError as error:
        got = str(error.strerror or error)
        raise Unavailable(
            str(folder), expected="a folder that can be written", got=got, cure="Choose another folder."
        ) from error
    return path


def load_garment(path: Path) -> Garment:
    """Returns the garment stored at ``path``; raises ``ArtifactError`` if the file is damaged or of another format."""
    try:
        header, arrays = read_packed(path)
        version = header.pop("format_version", None)
    except UNREADABLE as error:
        raise _refused(f"garment cache {path.name}", "a garment npz", error) from error
    if version not in READ_VERSIONS:
        expected = f"one of {', '.join(map(str, READ_VERSIONS))}"
        raise _refused(f"garment cache {path.name} format_version", expected, version)
    try:
        if not all(isinstance(header[key], kind) for key, kind in _TEXT_KINDS.items()):
            raise TypeError("a field of another type")
        header["material_names"] = tuple(map(str, header["material_names"]))
        json.dumps(header, ensure_ascii=False, allow_nan=False).encode()  # the service sends it to clients
        if "uv_vertex" in arrays:
            arrays["faces"] = arrays.pop("uv_vertex")[arrays["uv_faces"]]
        if header.pop("fine_faces", None) == "faces":
            arrays["fine_faces"] = arrays["faces"]
        arrays = {name: array for name, array in arrays.items() if name not in _ONCE_STORED}
        if "chart_residual" not in arrays:
            arrays["chart_residual"] = _residual(arrays).astype(np.float32)
        arrays |= {name: np.ascontiguousarray(arrays[name]) for name in _BY_COLUMNS}
        stored = header.pop("looks", None)
        looks = NO_LOOKS if stored is None else looks_of(stored, arrays.pop("pictures"))
        if (materials := header.pop("drawn_materials", None)) is not None:
            own = [np.ascontiguousarray(arrays.pop(f"drawn_{name}")) for name in BOUND_ARRAYS]
            arrays["drawn"] = BoundMesh(header["name"], tuple(map(str, materials)), *own, looks=looks)
            looks = looks if arrays["drawn"].material_names == header["material_names"] else NO_LOOKS
        return Garment(**header, **arrays, looks=looks)
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise _refused(f"garment cache {path.name}", "the fields of Garment", error) from error


def _tells_residual(arrays: Mapping[str, np.ndarray]) -> bool:
    """Whether the other ``arrays`` of a garment tell its ``chart_residual``."""
    try:
        return bool((np.abs(_residual(arrays) - arrays["chart_residual"]) < SAME_M).all())
    except (IndexError, ValueError):  # load_garment refuses such arrays with a sentence
        return False


def _residual(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """What the rest jets leave over of each vertex [m] (N, 4, 3), float64, in the frames of its patches."""
    patch = arrays["chart_patch"]
    rotation, jet = (arrays[name][patch].astype(np.float64) for name in ("patch_rotation", "patch_jet"))
    from_centre = arrays["vertices"].astype(np.float64)[:, None] - arrays["patch_centre"][patch]
    on_jet = jets.evaluate_jet(jet, arrays["chart_uv"].astype(np.float64))
    return np.einsum("vkba,vkb->vka", rotation, from_centre) - arrays["patch_scale"][patch][..., None] * on_jet


def _refused(name: str, expected: str, got: object) -> ArtifactError:
    return ArtifactError(name, expected=expected, got=str(got), cure="Run the intake again.")


@refusing
def main(arguments: list[str] | None = None) -> int:
    """Prints the names, types and shapes of a cache file's arrays and its manifest. Returns the exit status: 0, or 2 if
    the file cannot be read."""
    parser = argparse.ArgumentParser(prog="python -m drape.garment.cache", description="What a garment's file holds.")
    parser.add_argument("file", type=Path, help="NAME-DIGEST.npz, as the intake stores it")
    path = parser.parse_args(arguments).file
    if not path.is_file():
        raise NotFound("garment cache", expected="an existing file", got=str(path), cure="Check the path.")
    garment = load_garment(path)
    print(f"{garment.name}  {garment.digest}")
    for f in fields(Garment):
        value = getattr(garment, f.name)
        if isinstance(value, np.ndarray):
            print(f"  {f.name:18s} {value.dtype!s:8s} {value.shape}")
    print(json.dumps(garment.manifest, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
