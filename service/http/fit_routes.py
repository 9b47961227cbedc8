"""REST: bodies by their measures, and how garments fit them."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import numpy as np
from fastapi import APIRouter, Request, Response

from drape.body.measures import Measures, landmarks, measures
from drape.body.model import BodyModel
from drape.body.shape_of_measures import measure_ranges, shape_of_measures
from drape.body.skeleton import JOINT_COUNT
from drape.errors import BodyError, InputError, MotionError, NotFound, TooLarge
from drape.garment.fit_report import FitReport, JudgedDrape, fit_report
from drape.stages.batch import Batch, PoseInput, motion_arrays, shape_array
from drape.wire.options import Advanced, DrapeOptions
from service.errors import NotAcceptable, TooSlow
from service.http.answers import BINARY, JSON, binary_answer, choose, json_answer
from service.http.fit_schemas import FitDocument, FitRequest, MeasuresDocument, ShapeDocument, ShapeRequest
from service.http.garment_schemas import SizeAdvice
from service.http.json_body import json_text, read_document, validate_document
from service.http.openapi import body_schema, responses
from service.http.query import Betas, queried_shape
from service.state import ClientHere, StateHere

if TYPE_CHECKING:
    from drape.stages.scene import Entry

router = APIRouter()
# The network's smooth drape of every pose by itself: folds would take up the strain that is looked for, and the
# push-out adds some of its own.
SMOOTH: dict[str, Any] = {"motion": 0.0, "resolution": "fine", "advanced": Advanced(folds=0, push_out=False)}


@router.get("/bodies/{body_id}/measures", responses=responses(InputError, NotFound, BodyError))
async def body_measures(body_id: str, state: StateHere, betas: Betas = None) -> MeasuresDocument:
    """Returns the measures of a body in the shape ``betas``, the heights of the girths, and each measure's range."""
    runtime = state.runtime
    runtime.check_body_id(body_id)
    shape = queried_shape(betas, runtime.body)
    return MeasuresDocument.model_validate(await asyncio.to_thread(_measured, runtime.body, shape))


def _measured(body: BodyModel, shape: np.ndarray) -> dict[str, Any]:
    """The fields of a ``MeasuresDocument``."""
    levels = landmarks(body).levels(body.rest_vertices(shape))
    ranges = {name: {"least": least, "most": most} for name, (least, most) in measure_ranges(body).items()}
    found = {"betas": shape.tolist(), "measures": measures(body, shape)._asdict()}
    return found | {"levels": levels._asdict(), "ranges": ranges}


@router.post(
    "/bodies/{body_id}/shapes",
    openapi_extra=body_schema(ShapeRequest),
    responses=responses(InputError, NotFound, BodyError, TooSlow, TooLarge),
)
async def body_shape(body_id: str, request: Request, state: StateHere, client: ClientHere) -> ShapeDocument:
    """Finds the likeliest shape of a body with the given measures."""
    runtime = state.runtime
    runtime.check_body_id(body_id)
    state.check_slot()
    asked = validate_document(ShapeRequest, read_document(await json_text(request))).model_dump(exclude_none=True)
    with state.access.using(client, "clips"), state.slot():
        found = await runtime.call_apart(shape_of_measures, runtime.body, asked)
    reached = Measures._asdict(found.reached)
    return ShapeDocument.model_validate({"betas": found.betas.tolist(), "measures": reached, "missed": found.missed})


@router.post(
    "/garments/{garment_id}/fit",
    response_model=FitDocument,
    openapi_extra=body_schema(FitRequest),
    responses=responses(
        *(InputError, NotFound, NotAcceptable, BodyError, MotionError, TooSlow, TooLarge), kinds=(JSON, BINARY)
    ),
)
async def garment_fit(garment_id: str, request: Request, state: StateHere, client: ClientHere) -> Response:
    """Says how a garment fits: in words, as ease at chest, waist and hip, and as strain and pressure by region.

    The fit is read from the network's smooth drape, without folds. Ease is that of the rest pose. Strain and pressure
    are those of ``pose``. With the right Accept header the answer is binary, float32 (vertices, 3): strain along the
    warp, strain along the weft, pressure [N/m2].
    """
    runtime = state.runtime
    state.check_slot()
    asked = validate_document(FitRequest, read_document(await json_text(request)))
    kind = choose(request.headers.get("accept"), (JSON, BINARY))
    (entry,) = (await state.scene(garment_id, None, client, size=asked.size)).layers
    plan = runtime.plan(entry, DrapeOptions(**SMOOTH, fabric=asked.fabric))
    clip = _clip(asked, runtime.body)
    with state.access.using(client, "clips"), state.slot():
        draped = await runtime.drape(plan, clip)
        garment, fabric = plan.scene.layers[0].garment, plan.fabrics[0]
        report = await runtime.call_apart(fit_report, garment, runtime.body, _worn(clip, draped), fabric=fabric)
    if kind == BINARY:
        rows = np.stack(_of_delivered(report, entry), axis=1)
        return binary_answer(rows, state.sliced_thread, {"X-Drape-Vertices": str(len(rows))})
    return json_answer(_document(report, entry, vertices=asked.vertices), state.sliced_thread)


@router.get("/garments/{garment_id}/size", responses=responses(InputError, NotFound, BodyError))
async def garment_size(garment_id: str, state: StateHere, client: ClientHere, betas: Betas = None) -> SizeAdvice:
    """Says which size of a garment fits the body in the shape ``betas``, and why."""
    runtime = state.runtime
    entry = await state.garment(garment_id, client)
    shape = queried_shape(betas, runtime.body)
    found = await asyncio.to_thread(runtime.sizes.advice, entry, shape)
    return SizeAdvice(size=found.size, words=found.words)


def _clip(asked: FitRequest, body: BodyModel) -> PoseInput:
    """The rest pose, and after it the pose that is ``asked`` about, if any."""
    poses = np.zeros((1 if asked.pose is None else 2, JOINT_COUNT, 3))
    if asked.pose is not None:
        poses[1] = asked.pose
    poses, trans = motion_arrays(poses, None, max_frames=len(poses))
    return PoseInput(poses, trans, shape_array(asked.betas, body), np.arange(float(len(poses))))


def _worn(clip: PoseInput, draped: Batch) -> JudgedDrape:
    """The frames of ``draped`` in the world, float64."""
    vertices = draped.vertices.astype(np.float64) + draped.root[:, None]
    posed = (clip.poses[1], vertices[1]) if len(vertices) > 1 else (None, None)
    return JudgedDrape(clip.betas, vertices[0], *posed)


def _of_delivered(report: FitReport, entry: Entry) -> list[np.ndarray]:
    """Strain along warp and weft and pressure of the vertices that are drawn, float32."""
    count, drawn = entry.garment.vertex_count, entry.garment.drawn
    if drawn is None:
        return [values[:count].astype(np.float32) for values in report.tension]
    return [(drawn.shares(count) @ values[:count]).astype(np.float32) for values in report.tension]


def _document(report: FitReport, entry: Entry, *, vertices: bool) -> dict[str, Any]:
    """The fields of a ``FitDocument``."""
    ease = {name: {**girths._asdict(), "ease_m": girths.ease_m} for name, girths in report.ease.items()}
    regions = {name: region._asdict() for name, region in report.regions.items()}
    document: dict[str, Any] = {"garment": entry.id, "words": report.words, "ease": ease, "regions": regions}
    if vertices:
        document |= dict(zip(report.tension._fields, _of_delivered(report, entry), strict=True))
    return document
