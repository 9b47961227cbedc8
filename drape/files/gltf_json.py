"""The JSON of a glTF file (2.0, section 5): the fields that are read, with their types and bounds; others are passed
over. What they index is compared with what is there where it is read (``drape.files.gltf``)."""

from __future__ import annotations

import json
import re
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from drape.errors import MeshError

# Commas, colons and brackets, as many as the parser makes objects: a character with 76 clips has 283,000.
MOST_MARKS = 2_000_000
MOST_NODES = 4096
FIRST_ONLY = Field(fail_fast=True)  # Only the first fault of a list is reported.
# Extensions that are read, and those of materials, lights and clips, which do not change meshes.
READ_WITHOUT = re.compile(
    r"(KHR_materials|KHR_texture|EXT_texture|MSFT_texture|KHR_lights|KHR_xmp|KHR_animation|VRMC)_\w+"
    r"|VRM|KHR_mesh_quantization|KHR_draco_mesh_compression|EXT_meshopt_compression"
)
EXPORT, SHRINK = "Export it again.", "Remove custom properties (extras) and clips."

Index = Annotated[int, Field(ge=0)]
Text = Annotated[str, Field(max_length=1000)]  # Without a length pydantic takes text that UTF-8 cannot encode.
Indices = Annotated[list[Index], FIRST_ONLY]
Objects = Annotated[list[dict[str, Any]], FIRST_ONLY]
Number = Annotated[float, Field(ge=-1e9, le=1e9)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3), FIRST_ONLY]
Four = Annotated[list[Number], Field(min_length=4, max_length=4), FIRST_ONLY]
Sixteen = Annotated[list[Number], Field(min_length=16, max_length=16), FIRST_ONLY]


class Part(BaseModel):
    """A part of a glTF document. Types are checked strictly, and fields that it does not name are passed over."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False, alias_generator=to_camel)


class Node(Part):
    """A node. Its transform is ``matrix``, column by column, or else made of ``translation``, ``rotation`` (a
    quaternion xyzw) and ``scale``. Other fields are indices."""

    name: Text | None = None
    children: Indices = []
    mesh: Index | None = None
    camera: Index | None = None
    skin: Index | None = None
    matrix: Sixteen | None = None
    translation: Three = [0.0, 0.0, 0.0]
    rotation: Four = [0.0, 0.0, 0.0, 1.0]
    scale: Three = [1.0, 1.0, 1.0]


class Primitive(Part):
    """A primitive of a mesh: the accessors of its ``attributes`` by their names, that of its ``indices``, and its
    material. ``mode`` 4 is triangles."""

    attributes: dict[Text, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: int = 4
    extensions: dict[str, Any] = {}


class Mesh(Part):
    """A mesh: its primitives."""

    name: Text | None = None
    primitives: Annotated[list[Primitive], FIRST_ONLY]


class GltfSkin(Part):
    """A skin: the nodes that are its joints, and the accessor of their inverse bind matrices."""

    joints: Indices
    inverse_bind_matrices: Index | None = None


class Scene(Part):
    """A scene: its nodes that have no parent."""

    nodes: Indices = []


class NamedBone(Part):
    """A bone of VRM 0 and its node, -1 where it has none."""

    bone: Text
    node: Annotated[int, Field(ge=-1)] = -1


class PlacedBone(Part):
    """The node of a bone of VRM 1."""

    node: Index


class NamedBones(Part):
    """The bones of VRM 0."""

    human_bones: Annotated[list[NamedBone], FIRST_ONLY]


class PlacedBones(Part):
    """The bones of VRM 1 by their names."""

    human_bones: dict[Text, PlacedBone]


class Vrm(Part):
    """The extension of a VRM 0."""

    humanoid: NamedBones


class VrmcVrm(Part):
    """The extension of a VRM 1 or a VRMA."""

    humanoid: PlacedBones


class Extensions(Part):
    """The extensions that say which node is which bone: of VRM 0, VRM 1 and VRMA."""

    vrm: Annotated[Vrm | None, Field(alias="VRM")] = None
    vrmc_vrm: Annotated[VrmcVrm | None, Field(alias="VRMC_vrm")] = None
    vrmc_vrm_animation: Annotated[VrmcVrm | None, Field(alias="VRMC_vrm_animation")] = None

    @property
    def humanoid(self) -> dict[str, int]:
        """The nodes of VRM's bones by the bones' names, empty where the file is no VRM and no VRMA."""
        if one := self.vrmc_vrm or self.vrmc_vrm_animation:
            return {name: bone.node for name, bone in one.humanoid.human_bones.items()}
        bones = [] if self.vrm is None else self.vrm.humanoid.human_bones
        return {bone.bone: bone.node for bone in bones if bone.node >= 0}


class Document(Part):
    """A whole glTF document. What it says of the binary chunk is checked where that is read."""

    extensions_required: Annotated[list[Text], FIRST_ONLY] = []
    extensions: Extensions = Extensions()
    scene: Index | None = None
    scenes: Annotated[list[Scene], FIRST_ONLY] = []
    nodes: Annotated[list[Node], Field(max_length=MOST_NODES), FIRST_ONLY] = []
    meshes: Annotated[list[Mesh], FIRST_ONLY] = []
    skins: Annotated[list[GltfSkin], FIRST_ONLY] = []
    animations: Objects = []
    materials: Objects = []
    images: Objects = []
    textures: Objects = []
    accessors: Objects = []
    buffer_views: Objects = []
    buffers: Objects = []


def document_of(text: bytes, label: str) -> Document:
    """Returns the checked document in the ``text`` of a file's JSON chunk.

    Raises ``MeshError`` where the text is no JSON, at the first field that is wrong, and for required extensions that
    change what is read.
    """
    marks = sum(text.count(mark) for mark in b",:[{")
    if marks > MOST_MARKS:
        expected = f"at most {MOST_MARKS:,} commas, colons and brackets"
        raise MeshError(f"{label}: JSON", expected=expected, got=f"{marks:,}", cure=SHRINK)
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise MeshError(f"{label}: JSON", expected="JSON that can be read", got=str(error)[:60], cure=EXPORT) from error
    try:
        checked = Document.model_validate(document)
    except ValidationError as error:
        raise _refusal(error, label) from error
    for name in checked.extensions_required:
        if not READ_WITHOUT.fullmatch(name):
            cure = "Export without extensions."
            expected = "no required extension that changes meshes"
            raise MeshError(f"{label}: extensionsRequired", expected=expected, got=name[:60], cure=cure)
    return checked


def _refusal(error: ValidationError, label: str) -> MeshError:
    """The first complaint of pydantic as a refusal that names the field."""
    first = error.errors(include_url=False)[0]
    field = "".join(f"[{part}]" if isinstance(part, int) else f".{part[:60]}" for part in first["loc"]).lstrip(".")
    wanted = re.sub(r"^([A-Z]\w+ should (be |have )?)| after validation.*| or instance of \w+", "", first["msg"])
    expected, got = ("a value", "nothing") if first["type"] == "missing" else (wanted, excerpt(first["input"]))
    return MeshError(f"{label}: {field or 'JSON'}", expected=expected, got=got, cure=EXPORT)


def excerpt(value: Any) -> str:
    """Returns at most 60 letters that show the ``value`` of a document, however deep it is."""
    return f"a {type(value).__name__} of {len(value)}" if isinstance(value, (dict, list)) else repr(value)[:60]
