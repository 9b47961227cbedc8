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
from drape.wire.options import FIRST_ONLY, DrapeOptions, FabricNumbers, Identifier, TierName, Worn
from service.compute.tiers import Tier
from service.http.size_schemas import SizeInfo

if TYPE_CHECKING:
    from drape.stages.scene import Entry
    from service.compute.sizes import Sizes


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
    """Base of what clients send: unknown fields are refused, so that a typing mistake is not ignored."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class PosedOptions(Request):
    """All but the poses of a body in motion: its shape, and the origin of the answer."""

    betas: Betas | None = Field(default=None, description="Body shape; zeros if left out.")
    fps: Annotated[float, Field(ge=0.001, le=1000.0, allow_inf_nan=False)] = 30.0
    origin: Origin = Field(
        default="world",
        description="What positions count from: the world's origin, or each frame's root joint, whose place the answer "
        "then holds in float64. Far from the origin only the latter keeps the shape.",
    )


class PosedRequest(PosedOptions):
    """A body in motion: rotation vectors [rad] relative to the parent, root translation [m], shape."""

    poses: Annotated[list[PoseRows], Len(1), FIRST_ONLY]
    trans: Annotated[list[Place], FIRST_ONLY] | None = Field(
        default=None, description="Root translation [m] per frame; zeros if left out."
    )


class OnAvatar(BaseModel):
    """Whose body garments are worn on."""

    avatar: Identifier | None = Field(
        default=None,
        description="A character from POST /avatars that wears the garments; the standard body if left out.",
    )


class ClipOptions(DrapeOptions, Worn, OnAvatar, PosedOptions):
    """All but the poses of a garment, or several over each other, on a body in motion."""

    body: bool = Field(default=False, description="In a GLB, include the body as a second, skinned mesh.")
    rig: bool = Field(
        default=False,
        description="In a GLB, of an avatar: the garments skinned to the nodes of its own file, with morphs, in the "
        "unit of that file.",
    )
    streamed: bool = Field(
        default=False,
        description="Of a binary answer: frames leave as they are ready, of any number of bytes; no header tells what "
        "is known at the end alone.",
    )
    keep: bool = Field(default=False, description="Keep what the cloth remembers: X-Drape-Past names it.")
    past: Annotated[str, Field(max_length=120)] | None = Field(
        default=None,
        description="The X-Drape-Past of the frames that came before these: the clip goes on from there.",
    )
    quantised: bool = Field(
        default=True,
        description="In a GLB, positions in steps of 16 bits and normals of 8 (KHR_mesh_quantization), half as large; "
        "false: float32.",
    )


class DrapeRequest(ClipOptions, PosedRequest):
    """A garment, or several over each other, on a body in motion."""


class RigDrapeRequest(ClipOptions):
    """The same on an avatar in poses of its own rig: the local rotation of each of its nodes, as x, y, z, w."""

    avatar: Identifier = Field()  # which must be named here
    rig_poses: Annotated[list[RigRows], Len(1), FIRST_ONLY]
    trans: Annotated[list[Place], FIRST_ONLY] | None = Field(
        default=None, description="Where the node of the pelvis is [m], per frame; at its rest place if left out."
    )


class OpenRequest(DrapeOptions, Worn, OnAvatar, Request):
    """The first message of a stream."""

    type: Literal["open"]
    betas: Betas | None = None
    moves: bool = Field(default=False, description="Whether the client can go on at another process, with its state.")
    same: bool = Field(default=False, description="Whether the client takes a SAME for a frame that it shows already.")


class Problem(BaseModel):
    """A refusal (RFC 9457): what was wrong, what was expected, what came, and what cures it."""

    type: str
    title: str
    status: int
    detail: str = Field(description="One sentence of name, expected, got and cure.")
    name: str
    expected: str
    got: str
    cure: str


class Health(BaseModel):
    """Whether the service works, and with what."""

    model_config = ConfigDict(protected_namespaces=())

    status: Literal["ok"]
    version: str
    model: str
    model_digest: str
    dynamic: bool
    provider: str
    compiled: bool = Field(description="Whether our own engine computes the network, in place of an inference engine.")
    half: bool = Field(description="Whether the network's matrices are multiplied in float16.")
    elsewhere: int = Field(description="Operations that do not run on the provider; on a GPU each waits for a copy.")
    device_bytes: int = Field(description="Memory of the garments' constants and of buckets where the graphs compute.")
    buckets: int = Field(description="Sets of shapes with memory of their own; on a GPU each a captured graph.")
    body: str
    garments: int
    passes: int = Field(description="Corrections of the network of which a request may choose how many; 0: no choice.")
    fabrics: bool = Field(description="Whether the model drapes by what garments are made of.")
    layers: int = Field(description="Garments that an outfit may have.")
    max_frames: int = Field(description="Frames that a request may have; longer clips go in pieces.")
    max_body_bytes: int = Field(description="Bytes that its body may have.")
    sessions: int
    refused_garments: list[str] = Field(description="Stored garments that could not be loaded, with the reason.")


class FabricInfo(FabricNumbers):
    """A fabric that a request may name, its numbers and where they come from."""

    id: str
    thickness_m: float
    friction: float
    source: str


class TierInfo(BaseModel):
    """A tier: passes of the network under steps of folds, and the passes that jets, which have no folds, get."""

    id: TierName
    default: bool = Field(description="Whether a request that names none gets it.")
    passes: int
    folds: int
    coarse: bool = Field(
        description="Whether a coarse cloth takes the steps; without steps cloth is lifted off the skin."
    )
    alone: int = Field(description="Passes where there are no folds: with jets, or folds 0.")
    figures: dict[str, Any] = Field(description="What benchmarks.tradeoff measured of it, and on which machine.")

    @classmethod
    def of(cls, tier: Tier, pass_count: int, *, default: TierName) -> TierInfo:
        """``tier`` of a model that leaves ``pass_count`` passes to choose."""
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
    """One garment that can be draped."""

    id: str
    name: str
    digest: str
    vertices: int
    faces: int
    fine_vertices: int = Field(description="Of the mesh of resolution fine; as many where delivered is fine enough.")
    patches: int
    source: Literal["shipped", "user"]
    published: bool = Field(description="Whether keys besides its owner's see it.")
    materials: list[str]
    fabric: str | dict[str, Any] = Field(description="What it is made of where a request names nothing else.")
    sizes: list[SizeInfo] = Field(description="The sizes that it comes in, the smallest first; none where it is one.")
    manifest: dict[str, Any]

    @staticmethod
    def of(entry: Entry, sizes: Sizes) -> GarmentInfo:
        """The answer about ``entry``."""
        garment = entry.garment
        return GarmentInfo(
            id=entry.id,
            name=entry.name,
            digest=garment.digest,
            vertices=garment.vertex_count,
            faces=len(garment.faces),
            fine_vertices=len(garment.vertices),
            patches=garment.patch_count,
            source=entry.source,
            published=entry.owner is None or entry.published,
            materials=list(garment.material_names),
            fabric=garment.fabric if isinstance(garment.fabric, str) else dict(garment.fabric),
            sizes=[
                SizeInfo(size=size, cut_for=sizes.cut_for(entry, size), **told)
                for size, told in sizes.measures(entry).items()
            ],
            manifest=garment.manifest,
        )


class FrameTold(BaseModel):
    """What is told of a frame of tier exact."""

    frame: int
    force_share: float = Field(description="The norm of the forces left at all vertices, over the cloth's weight.")
    depth_m: float = Field(description="How deep the cloth lies in the skin where it lies deepest [m].")
    energy_j: float = Field(description="Of cloth and body [J]; heights count from the root.")
    start_j: float = Field(description="That of the drape of tier accurate, which the frame is given.")
    crossings: int = Field(description="Pairs of triangles of the cloth that cross.")
    start_crossings: int = Field(description="Those of the drape of tier accurate.")
    steps: int = Field(description="Steps of Newton's method.")


class JobInfo(BaseModel):
    """The state of an upload, or of a clip of tier exact. ``problem`` is the refusal where it failed, ``garment`` or
    ``avatar`` the id where an upload is done; while it runs, ``stage`` is what its process does now and ``share`` how
    much lies behind it. Of a clip, ``told`` has the frames that are there."""

    id: str
    name: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    stage: str | None = None
    share: float = Field(default=0.0, description="By what the stages take of usual garments; 0 to 1.")
    garment: str | None = None
    avatar: str | None = None
    problem: dict[str, Any] | None = None
    notes: list[str] = Field(default=[], description="Of one that is done: what was left out or looks wrong, in words.")
    frames: int | None = Field(default=None, description="Of a clip: how many it has.")
    told: list[FrameTold] = Field(default=[], description="Of a clip: its frames that are there, in order.")


class BodyInfo(BaseModel):
    """One body."""

    id: str
    digest: str
    vertices: int
    faces: int
    shapes: int


class BodyDocument(BodyInfo):
    """A body of some shape: rest joints [m] and the height of its soles, to place a clip on the ground."""

    joints: list[list[float]]
    floor_m: float


class MotionInfo(BaseModel):
    """One shipped clip."""

    id: str
    name: str
    frames: int
    fps: float


class MotionDocument(MotionInfo):
    """A clip with its numbers."""

    poses: list[list[list[float]]]
    trans: list[list[float]]


class MeshDocument(BaseModel):
    """A mesh at rest: positions [m], triangles, texture coordinates (empty where there are none)."""

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
    """Positions [m], frame by frame, in the world's axes."""

    fps: float
    frames: int
    vertices: int
    origin: Origin = Field(description="What positions count from: the world's origin, or each frame's root.")
    roots: list[list[float]] | None = Field(default=None, description="With origin root: where it is [m], float64.")
    garments: list[LayerInfo] | None = Field(default=None, description="Of an outfit: whose vertices follow whose.")
    positions: list[list[list[float]]]
