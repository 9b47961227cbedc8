"""The JSON of requests and answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Len
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from drape.body.skeleton import JOINT_COUNT
from drape.files.gltf_json import MOST_NODES
from drape.graph.feeds import BETA_COUNT
from drape.stages.batch import ANGLE_LIMIT_RAD, BETA_LIMIT, PLACE_LIMIT_M
from drape.stages.placing import Origin
from drape.stages.tiers import Tier
from drape.wire.options import FIRST_ONLY, DrapeOptions, FabricNumbers, Identifier, TierName, WornGarments
from service.http.garment_schemas import SizeInfo

if TYPE_CHECKING:
    from drape.stages.scene import Entry
    from drape.stages.sizes import Sizes


def _number(limit: float) -> Any:
    """A finite number; of ``limit`` the schema tells, and ``drape.stages.batch`` refuses what is beyond it."""
    told: dict[str, Any] = {"minimum": -limit, "maximum": limit}
    return Annotated[float, Field(allow_inf_nan=False, strict=True, json_schema_extra=told)]


Angles = Annotated[list[_number(ANGLE_LIMIT_RAD)], Len(3, 3), FIRST_ONLY]
Place = Annotated[list[_number(PLACE_LIMIT_M)], Len(3, 3), FIRST_ONLY]
PoseRows = Annotated[list[Angles], Len(JOINT_COUNT, JOINT_COUNT), FIRST_ONLY]
Quaternion = Annotated[list[_number(1.01)], Len(4, 4), FIRST_ONLY]
RigRows = Annotated[list[Quaternion], Len(1, MOST_NODES), FIRST_ONLY]
Betas = Annotated[list[_number(BETA_LIMIT)], Len(0, BETA_COUNT), FIRST_ONLY]


class Request(BaseModel):
    """Base of what clients send. Unknown fields are refused, so that a typing mistake is not ignored."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class PosedOptions(Request):
    """The shape of a body in motion and the origin of the answer: all but its poses."""

    betas: Betas | None = Field(default=None, description="The shape coefficients of the body. Left out: zeros.")
    fps: Annotated[float, Field(ge=0.001, le=1000.0, allow_inf_nan=False)] = 30.0
    origin: Origin = Field(
        default="world",
        description="What positions count from. world: the world's origin. root: each frame's root joint, whose "
        "position the answer holds in float64. Far from the origin only root keeps the garment's shape.",
    )


class PosedRequest(PosedOptions):
    """A body in motion: its poses as rotation vectors [rad] relative to the parent joint, its root translations [m],
    and its shape.
    """

    poses: Annotated[list[PoseRows], Len(1), FIRST_ONLY]
    trans: Annotated[list[Place], FIRST_ONLY] | None = Field(
        default=None, description="The translation of the root [m] in each frame. Left out: zeros."
    )


class OnAvatar(BaseModel):
    """The body that wears the garments."""

    avatar: Identifier | None = Field(
        default=None,
        description="The id of an avatar (POST /avatars) that wears the garments. Left out: the standard body.",
    )
    alive: bool = Field(
        default=False,
        description="Whether the avatar also wears its own clothes as cloth (`alive` of GET /avatars/{id}), but for "
        "those that the garments replace. Then no garment needs to be named.",
    )


class ClipOptions(DrapeOptions, WornGarments, OnAvatar, PosedOptions):
    """The options of a garment, or of several over each other, on a body in motion: all but the poses."""

    body: bool = Field(default=False, description="Whether a GLB also holds the body, as a skinned mesh.")
    rig: bool = Field(
        default=False,
        description="Whether a GLB of an avatar has the garments skinned to the nodes of the avatar's own file, with "
        "morph targets, in the unit of that file.",
    )
    joints: int | None = Field(
        default=None,
        ge=1,
        le=64,
        strict=True,
        description="With rig: how many joints of its own each garment gets in place of morph targets. They hang below "
        "the rig's and are fitted to the clip, so the GLB is small and near the drape, and not the drape.",
    )
    streamed: bool = Field(
        default=False,
        description="Whether the frames of a binary answer leave as soon as they are ready. Its size may then exceed "
        "the limit of an answer, and no header tells figures that are known only at the end.",
    )
    keep: bool = Field(
        default=False,
        description="Whether the service keeps the state of the cloth after the last frame. X-Drape-Past names it.",
    )
    past: Annotated[str, Field(max_length=120)] | None = Field(
        default=None, description="The X-Drape-Past of the piece before this one. The clip goes on from its last frame."
    )
    quantised: bool = Field(
        default=True,
        description="Whether a GLB has positions of 16 bits and normals of 8 (KHR_mesh_quantization), which halves "
        "its size. false: float32.",
    )


class DrapeRequest(ClipOptions, PosedRequest):
    """A garment, or several worn over each other, on a body in motion."""


class RigDrapeRequest(ClipOptions):
    """A garment, or several worn over each other, on an avatar in poses of its own rig: the local rotation of each of
    its nodes, as x, y, z, w.
    """

    avatar: Identifier = Field()  # which must be named here
    rig_poses: Annotated[list[RigRows], Len(1), FIRST_ONLY]
    trans: Annotated[list[Place], FIRST_ONLY] | None = Field(
        default=None,
        description="The position of the node of the pelvis [m] in each frame. Left out: its position at rest.",
    )


class OpenRequest(DrapeOptions, WornGarments, OnAvatar, Request):
    """The first message of a stream."""

    type: Literal["open"]
    betas: Betas | None = None
    moves: bool = Field(
        default=False, description="Whether the client can move to another process with the stream's state."
    )
    same: bool = Field(
        default=False, description="Whether the client takes a SAME message in place of a frame that it already shows."
    )


class Problem(BaseModel):
    """A refusal (RFC 9457): what was wrong, what was expected, what came, and what cures it."""

    type: str
    title: str
    status: int
    detail: str = Field(description="One sentence made of name, expected, got and cure.")
    name: str
    expected: str
    got: str
    cure: str


class CardHealth(BaseModel):
    """The state of a graphics card that computes folds, or why it does not."""

    name: str
    fault: str = Field(description="Why frames are the processor's, in a sentence. Empty while the card draws.")
    occupied: float = Field(description="The share of its memory that is taken.")
    busy: float = Field(description="The share of its time that launches took since the start.")
    queue_s: float = Field(description="The age [s] of the oldest frame that waits for it.")
    frames: int
    launches: int
    frames_a_launch: float


class Health(BaseModel):
    """Says that the service works, and with which model, provider and limits."""

    model_config = ConfigDict(protected_namespaces=())

    status: Literal["ok"]
    version: str
    model: str
    model_digest: str
    dynamic: bool
    provider: str
    compiled: bool = Field(description="Whether the product's own engine computes the network, and not ONNX Runtime.")
    elsewhere: int = Field(
        description="The number of operations that do not run on the provider. On a GPU each of them waits for a copy."
    )
    device_bytes: int = Field(description="The bytes that the garments' constants take on the device that computes.")
    card: CardHealth | None = Field(description="The card that draws folds. Null without the extra cuda.")
    body: str
    garments: int
    passes: int = Field(
        description="The most corrections of the network that a request may ask for. 0: there is no choice."
    )
    fabrics: bool = Field(description="Whether the network reads a garment's fabric.")
    layers: int = Field(description="The most garments of an outfit.")
    max_frames: int = Field(description="The most frames of a request. Longer clips go in pieces.")
    max_body_bytes: int = Field(description="The most bytes of a request's body.")
    sessions: int
    refused_garments: list[str] = Field(
        description="The stored garments that could not be loaded, each with the reason."
    )


class FabricInfo(FabricNumbers):
    """A fabric that a request may name, with its numbers and their source."""

    id: str
    thickness_m: float
    friction: float
    source: str


class TierInfo(BaseModel):
    """A tier: how many passes the network takes and how many steps of folds follow."""

    id: TierName
    default: bool = Field(description="Whether a request that names no tier gets this one.")
    passes: int
    folds: int
    coarse: bool = Field(
        description="Whether a coarse cloth takes the steps of folds. With folds 0 it takes one step, which eases the "
        "stretch of the network's drape."
    )
    alone: int = Field(description="The passes of a drape without folds: of jets, or with folds 0.")
    figures: dict[str, Any] = Field(
        description="The figures that benchmarks.tradeoff measured of this tier, and the machine."
    )

    @classmethod
    def of(cls, tier: Tier, pass_count: int, *, default: TierName) -> TierInfo:
        """Returns the answer about ``tier``, of a model that leaves ``pass_count`` passes to choose."""
        passes, alone = (min(pass_count, pass_count if p is None else p) for p in (tier.passes, tier.alone))
        named = TypeAdapter(TierName).validate_python(tier.name)
        return cls(
            id=named,
            default=named == default,
            passes=passes,
            folds=tier.folds,
            coarse=tier.coarse,
            alone=alone,
            figures=dict(tier.figures),
        )


class GarmentInfo(BaseModel):
    """A garment that can be draped."""

    id: str
    name: str
    digest: str
    vertices: int
    faces: int
    fine_vertices: int = Field(
        description="The number of vertices of the mesh of resolution fine. It equals "
        "vertices where the delivered mesh is fine enough."
    )
    hung: bool = Field(
        default=False, description="Whether what is drawn hangs on a cloth of other triangles, that of resolution fine."
    )
    patches: int
    source: Literal["shipped", "user"]
    published: bool = Field(description="Whether other keys than its owner's may use it.")
    materials: list[str]
    fabric: str | dict[str, Any] = Field(description="The fabric of the garment, unless a request names another.")
    sizes: list[SizeInfo] = Field(description="The sizes of the garment, the smallest first. Empty if it has one size.")
    manifest: dict[str, Any]

    @staticmethod
    def of(entry: Entry, sizes: Sizes) -> GarmentInfo:
        """The answer about ``entry``."""
        garment = entry.garment
        return GarmentInfo(
            id=entry.id,
            name=entry.name,
            digest=garment.digest,
            vertices=entry.vertex_count,
            faces=len(garment.surface.faces),
            fine_vertices=len(garment.vertices),
            hung=garment.drawn is not None and not garment.carriers,
            patches=garment.patch_count,
            source=entry.source,
            published=entry.owner is None or entry.published,
            materials=list(garment.surface.material_names),
            fabric=garment.fabric if isinstance(garment.fabric, str) else dict(garment.fabric),
            sizes=[
                SizeInfo(size=size, cut_for=sizes.cut_for(entry, size), **told)
                for size, told in sizes.measures(entry).items()
            ],
            manifest=garment.manifest,
        )


class BodyInfo(BaseModel):
    """A body."""

    id: str
    digest: str
    vertices: int
    faces: int
    shapes: int


class BodyDocument(BodyInfo):
    """A body in a shape: its joints at rest [m] and the height of its soles [m], which place a clip on the ground."""

    joints: list[list[float]]
    floor_m: float


class MotionInfo(BaseModel):
    """A sample clip."""

    id: str
    name: str
    frames: int
    fps: float


class MotionDocument(MotionInfo):
    """A sample clip with its poses and translations."""

    poses: list[list[list[float]]]
    trans: list[list[float]]


class MeshDocument(BaseModel):
    """A mesh at rest: positions [m], triangles, and texture coordinates, which are empty if the file has none."""

    id: str
    vertices: list[list[float]]
    faces: list[list[int]]
    uv: list[list[float]]
    uv_faces: list[list[int]]
    materials: list[str]
    face_material: list[int]


class LayerInfo(BaseModel):
    """One garment of an outfit."""

    id: str
    vertices: int


class VerticesDocument(BaseModel):
    """The positions of vertices [m], frame by frame, in the world's axes."""

    fps: float
    frames: int
    vertices: int
    origin: Origin = Field(description="What positions count from: the world's origin, or each frame's root joint.")
    roots: list[list[float]] | None = Field(
        default=None, description="With origin root: the position of the root joint in each frame [m], float64."
    )
    garments: list[LayerInfo] | None = Field(
        default=None, description="Of an outfit: its garments in the order of their vertices."
    )
    positions: list[list[list[float]]]
