"""What the faces of a character are: skin, face, hair, clothes, shoes, or things that it carries.

Names decide first (``drape.avatar.attire_words``). Faces whose names say nothing are cut into regions, pieces of one
colour. A region in a colour that head and hands share is skin; any other one is what is worn where it lies.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from drape.avatar.attire_words import CLOTH, DOLL, KINDS, kind_of_names
from drape.avatar.character import Character
from drape.avatar.parts import PARTS, parts_of, plain_part
from drape.avatar.t_pose import TPose
from drape.body.skeleton import JOINT_NAMES
from drape.errors import NotFound, did_you_mean
from drape.files.gltf import GltfFile
from drape.geometry import mesh_graphs, meshes

SAME_COLOUR = 0.11  # sRGB channels of faces of one region, and of two pieces of skin, differ by less.
LEAST_SHARE = 0.002  # A region with a smaller share of the surface goes with its largest neighbour.
BY_NAME, BY_COLOUR, BY_CLOTH = 0.95, 0.6, 0.8  # Values of ``AttirePart.sure``.
TOLD = 1.0


Names = tuple[str | None, ...]


class AttirePart(NamedTuple):
    """A part of a character: a number of ``faces`` of one ``kind``, one of ``KINDS``. ``sure`` in [0, 1] is how certain
    the kind is. A ``bulky`` part stands so far off the trunk that no cloth lies over it."""

    name: str
    kind: str
    faces: int
    sure: float
    bulky: bool = False


class Attire(NamedTuple):
    """The ``parts`` of a character, and for each of its F faces the index ``part`` (F,) of its part.

    ``colours`` (F, 3) are the faces' colours, sRGB in [0, 1], and ``skin_colour`` (3,) is the mean of those of the
    skin.
    """

    parts: tuple[AttirePart, ...]
    part: np.ndarray
    skin_colour: tuple[float, float, float]
    colours: np.ndarray

    def of_kinds(self, kinds: Collection[str]) -> np.ndarray:
        """Returns the mask (F,) bool of the faces whose part is of one of ``kinds``."""
        return np.array([part.kind in kinds for part in self.parts], dtype=bool)[self.part]


def attire_of(
    file: GltfFile,
    character: Character,
    pose: TPose,
    colours: np.ndarray,
    *,
    corrections: Mapping[str, str] | None = None,
) -> Attire:
    """Returns the parts of ``character``, which was read from ``file``, and the colours of its faces.

    ``pose`` is the character in T-pose. ``colours`` (F, 3), sRGB in [0, 1], are those of its faces. ``corrections`` are
    kinds that a client sets, by the names of the parts. Raises ``NotFound`` for a part or a kind that does not exist.
    """
    surface = _Surface(character, pose, colours)
    names = [_names(file, primitive.node, primitive.primitive) for primitive in character.primitives]
    kinds_named = list(map(kind_of_names, names))
    plain = len({kind for kind in kinds_named if kind not in (None, "face")}) <= 1
    kinds = np.full(len(pose.faces), -1)
    sure = np.full(len(pose.faces), BY_NAME)
    for number, kind in enumerate(kinds_named):
        rows = np.flatnonzero(surface.primitive == number)
        if kind == CLOTH:
            kinds[rows], sure[rows] = KINDS.index(surface.clothes(rows)), BY_CLOTH
        elif kind is not None and not (kind == "skin" and plain and surface.is_whole(rows)):
            kinds[rows] = KINDS.index("skin" if kind == DOLL else kind)
    left = np.flatnonzero(kinds < 0)
    if len(left):
        kinds[left], sure[left] = surface.by_colour(left, kinds), BY_COLOUR
    parts, part = _grouped(character, surface.primitive, kinds, sure, names)
    attire = Attire(_corrected(parts, corrections or {}, file.label), part, (0.0, 0.0, 0.0), colours)
    bare = attire.of_kinds(("skin",))
    bare = bare if bare.any() else attire.of_kinds(("face",))
    rows = bare if bare.any() else np.ones(len(bare), dtype=bool)
    red, green, blue = np.round(np.average(colours[rows], axis=0, weights=surface.area[rows]), 3).tolist()
    return attire._replace(skin_colour=(red, green, blue))


def _names(file: GltfFile, node: int, index: int) -> Names:
    """The names of a primitive's material, node, mesh and picture: what tells most comes first."""
    held = file.document.nodes[node]
    mesh = file.item("meshes", held.mesh)
    number = mesh.primitives[index].material
    material = {} if number is None else file.item("materials", number, "primitives.material")
    names = material.get("name"), held.name, mesh.name, _picture(file, material).get("name")
    return tuple(name[:120] if isinstance(name, str) else None for name in names)


def _picture(file: GltfFile, material: dict) -> dict:
    """The image of the base colour of ``material``, empty where it has none."""
    try:
        texture = material["pbrMetallicRoughness"]["baseColorTexture"]["index"]
        return file.document.images[file.document.textures[texture]["source"]]
    except (KeyError, IndexError, TypeError):
        return {}


class _Surface:
    """A character's faces: where on the body each is, and which touch."""

    def __init__(self, character: Character, pose: TPose, colours: np.ndarray) -> None:
        assert character.triangle is not None and character.hung is not None
        counts = [primitive.triangles for primitive in character.primitives]
        self.primitive = np.repeat(np.arange(len(counts)), counts)[character.triangle]
        self.pose, self.colours, self.hung = pose, colours, character.hung
        self.area = np.maximum(meshes.face_areas(pose.vertices, pose.faces), 1e-12)
        self.centre = pose.vertices[pose.faces].mean(axis=1)
        own = [plain_part(part) for part in PARTS]
        self.part = np.array(own)[parts_of(pose.weights)[pose.faces[:, 0]]]
        at = dict(zip(JOINT_NAMES, pose.joints, strict=True))
        self.hip, self.knee = (0.5 * (at[f"left_{one}"] + at[f"right_{one}"]) for one in ("hip", "knee"))
        self.shoulder = 0.5 * (at["left_shoulder"] + at["right_shoulder"])
        self.half_hips = 0.5 * abs(at["left_hip"][0] - at["right_hip"][0])
        self.pairs = meshes.hinge_faces(pose.faces)

    def share(self, rows: np.ndarray, *parts: str) -> float:
        """How much of the area of ``rows`` lies on ``parts``."""
        return float(self.area[rows][np.isin(self.part[rows], parts)].sum() / self.area[rows].sum())

    def regions(self, rows: np.ndarray) -> np.ndarray:
        """Which region (F,) each of the faces ``rows`` belongs to, -1 elsewhere: touching faces of one primitive and
        one colour; small ones go with the neighbour with which they share most edges."""
        inside = np.zeros(len(self.area), dtype=bool)
        inside[rows] = True
        a, b = self.pairs[inside[self.pairs].all(axis=1)].T
        joined = self.primitive[a] == self.primitive[b]
        like = joined & (np.abs(self.colours[a] - self.colours[b]).max(axis=1) < SAME_COLOUR)
        label = mesh_graphs.joined_parts(len(self.area), a[like], b[like])
        least = LEAST_SHARE * self.area[~self.hung].sum()
        for _ in range(4):
            size = np.bincount(label, self.area, label.max() + 1)
            ends = np.stack([label[a[joined]], label[b[joined]]], axis=1)
            ends = np.concatenate([ends, ends[:, ::-1]])
            ends = ends[(ends[:, 0] != ends[:, 1]) & (size[ends[:, 0]] < least)]
            if not len(ends):
                break
            pair, count = np.unique(ends, axis=0, return_counts=True)
            best = pair[np.lexsort((size[pair[:, 1]], count))]
            into = np.arange(len(size))
            into[best[:, 0]] = best[:, 1]  # Of several neighbours the last one, which is the best, counts.
            bigger = size[into] > size
            label = np.where(bigger, into, np.arange(len(size)))[label]
        return np.where(inside, label, -1)

    def is_whole(self, rows: np.ndarray) -> bool:
        """Whether ``rows`` reach from head to hands: where such a mesh is called skin, its picture is meant."""
        return all(self.share(rows, part) > 0.0 for part in ("head", "trunk", "palm"))

    def skin_colours(self, label: np.ndarray, skin: np.ndarray) -> np.ndarray:
        """The colours (n, 3) of skin: of faces that names call ``skin``, or those that face and hands share, or the
        face's."""
        if skin.any():
            return np.average(self.colours[skin], axis=0, weights=self.area[skin])[None]
        seen = (label >= 0) & ~self.hung
        face = self._means(label, np.flatnonzero(seen & self._face()), 0.35)
        palm = self._means(label, np.flatnonzero(seen & (self.part == "palm")), 0.2)
        if len(face) and len(palm):
            apart = np.abs(face[:, None] - palm).max(axis=2)
            shared = face[apart.min(axis=1) < SAME_COLOUR]
            if len(shared):
                return shared
        return face[:1]

    def _face(self) -> np.ndarray:
        """Which faces (F,) look ahead at the height of nose and mouth."""
        head = self.part == "head"
        if not head[~self.hung].any():
            return head
        low, high = np.quantile(self.centre[head & ~self.hung, 1], (0.0, 1.0))
        share = (self.centre[:, 1] - low) / max(high - low, 1e-9)
        ahead = meshes.face_normals(self.pose.vertices, self.pose.faces)[:, 2] > 0.3
        return head & ahead & (share > 0.1) & (share < 0.55)

    def _means(self, label: np.ndarray, rows: np.ndarray, least: float) -> np.ndarray:
        """The mean colours (n, 3) of regions that take the share ``least`` of ``rows`` or more, the largest first."""
        if not len(rows):
            return np.zeros((0, 3))
        index = np.unique(label[rows], return_inverse=True)[1]
        area = np.bincount(index, self.area[rows])
        mean = np.stack([np.bincount(index, self.area[rows] * column) for column in self.colours[rows].T], axis=1)
        order = np.argsort(-area)
        return (mean / area[:, None])[order[area[order] > least * area.sum()]]

    def by_colour(self, rows: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """The numbers of kinds (n,) of faces ``rows`` whose names tell none; ``kinds`` (F,) are known elsewhere."""
        label = self.regions(rows)
        named = np.isin(kinds, [KINDS.index("skin"), KINDS.index("face")])
        skin = self.skin_colours(label, named & (self.part != "head"))
        kind_of_face = np.zeros(len(label), dtype=np.int64)
        for number in np.unique(label[rows]):
            own = np.flatnonzero(label == number)
            colour = np.average(self.colours[own], axis=0, weights=self.area[own])
            bare = bool(len(skin)) and np.abs(skin - colour).max(axis=1).min() < SAME_COLOUR
            kind_of_face[own] = KINDS.index(self._worn_there(own, bare))
        return kind_of_face[rows]

    def _worn_there(self, rows: np.ndarray, bare: bool) -> str:
        """The kind of the faces ``rows`` of a region by where it lies; ``bare``: in a colour of skin."""
        head = self.share(rows, "head", "neck") > 0.6
        if self.hung[rows].all():
            return "hat" if head else "carried"
        if bare:
            return "face" if head else "skin"
        if head:
            ahead = np.average(self.centre[rows, 2], weights=self.area[rows])
            skull = np.flatnonzero((self.part == "head") & ~self.hung)
            front = np.quantile(self.centre[skull, 2], 0.7)
            small = self.area[rows].sum() < 0.08 * self.area[skull].sum()
            return "face" if small and ahead > front else "hair"
        if self._is_rigid(rows):
            return "carried"
        if self.share(rows, "palm") > 0.6:
            return "gloves"
        if self.share(rows, "sole") > 0.25 and self.share(rows, "sole", "shin") > 0.8:
            return "shoes"
        return self.clothes(rows)

    def _is_rigid(self, rows: np.ndarray) -> bool:
        """Whether one bone of the trunk moves all of ``rows``, which do not go round it: a bag, a quiver, a buckle."""
        weights = self.pose.weights[np.unique(self.pose.faces[rows])]
        if self.share(rows, "trunk") < 1.0 or (weights > 0.99).all(axis=0).sum() != 1:
            return False
        trunk = self.centre[(self.part == "trunk") & ~self.hung, 2]
        ahead = (self.centre[rows, 2] > np.median(trunk)).mean()
        return bool(max(ahead, 1.0 - ahead) > 0.98)

    def clothes(self, rows: np.ndarray) -> str:
        """Which clothes the faces ``rows`` are, by how far they reach up and down, and whether they part the legs."""
        if self.share(rows, "head", "neck") > 0.6:
            return "hat"
        if self.share(rows, "palm") > 0.6:
            return "gloves"
        if self.share(rows, "sole", "shin") > 0.8:
            return "shoes"
        height, area = self.centre[rows, 1], self.area[rows]
        order = np.argsort(height)
        share = np.cumsum(area[order]) / area.sum()
        low, high = (height[order][min(np.searchsorted(share, one), len(rows) - 1)] for one in (0.05, 0.95))
        chest = 0.5 * (self.hip[1] + self.shoulder[1])
        legs = low < self.hip[1] - 0.5 * (self.hip[1] - self.knee[1])
        if self.share(rows, "trunk") > 0.98:
            return "top"
        if high > chest:
            return "dress" if legs else "top"
        return "skirt" if self._one_tube(rows) else "trousers"

    def _one_tube(self, rows: np.ndarray) -> bool:
        """Whether cloth goes round both legs below the crotch: it then faces ahead or back between the legs."""
        below = rows[self.centre[rows, 1] < self.hip[1] - 0.3 * (self.hip[1] - self.knee[1])]
        middle = below[np.abs(self.centre[below, 0] - self.hip[0]) < 0.3 * self.half_hips]
        if not len(middle):
            return False
        facing = np.abs(meshes.face_normals(self.pose.vertices, self.pose.faces)[middle, 2]) > 0.7
        return bool(self.area[middle][facing].sum() > 0.05 * self.area[below].sum())


def _grouped(
    character: Character,
    primitive: np.ndarray,
    kinds: np.ndarray,
    sure: np.ndarray,
    names: list[tuple[str | None, ...]],
) -> tuple[tuple[AttirePart, ...], np.ndarray]:
    """Faces of one primitive and one kind as a part, and the part (F,) of each face; a part's name is the node's, with
    the material and the kind where these tell it from others."""
    nodes = [mesh_part.node for mesh_part in character.primitives]
    groups: list[AttirePart] = []
    part = np.zeros(len(kinds), dtype=np.int64)
    for number, mesh_part in enumerate(character.primitives):
        rows = np.flatnonzero(primitive == number)
        there, index = np.unique(kinds[rows], return_inverse=True)
        base = mesh_part.name or f"node {mesh_part.node}"
        if nodes.count(mesh_part.node) > 1:
            base = f"{base}/{names[number][0] or mesh_part.primitive}"
        for place, kind in enumerate(there):
            own = rows[index == place]
            name, known = f"{base} {KINDS[kind]}" if len(there) > 1 else base, {group.name for group in groups}
            name = name if name not in known else f"{name} {len(groups)}"
            part[own] = len(groups)
            groups.append(AttirePart(name, KINDS[kind], len(own), round(float(sure[own].mean()), 2)))
    return tuple(groups), part


def _corrected(parts: tuple[AttirePart, ...], corrections: Mapping[str, str], label: str) -> tuple[AttirePart, ...]:
    """``parts`` with the kinds that ``corrections`` has by their names."""
    names = [part.name for part in parts]
    for name, kind in corrections.items():
        if name not in names:
            known, cure = ", ".join(names[:40]), did_you_mean(name, names, "GET /avatars/ID lists the parts.")
            raise NotFound(f"{label}: part", expected=f"one of {known}", got=name[:60], cure=cure)
        if kind not in KINDS:
            cure = did_you_mean(kind, KINDS, "Correct the kind.")
            raise NotFound(f"{label}: {name}", expected=f"one of {', '.join(KINDS)}", got=kind[:40], cure=cure)
    return tuple(
        part._replace(kind=corrections[part.name], sure=TOLD) if part.name in corrections else part for part in parts
    )
