"""Routes for measures of bodies, and for how garments fit."""

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
# A fit is read from the network's smooth drape of each pose by itself. Folds would take up the strain that is to be
# measured, and the push-out would add to it.
SMOOTH: dict[str, Any] = {"motion": 0.0, "resolution": "fine", "advanced": Advanced(folds=0, push_out=False)}


@router.get("/bodies/{body_id}/measures", responses=responses(InputError, NotFound, BodyError))
async def body_measures(body_id: str, state: StateHere, betas: Betas = None) -> MeasuresDocument:
    """Returns the measures of the body in the shape ``betas``, the heights at which its girths are measured, and the
    range that each measure can have on this body.
    """
    runtime = state.runtime
    runtime.check_body_id(body_id)
    shape = queried_shape(betas, runtime.body)
    return MeasuresDocument.model_validate(await asyncio.to_thread(_measured, runtime.body, shape))


def _measured(body: BodyModel, shape: np.ndarray) -> dict[str, Any]:
    """Returns the fields of a ``MeasuresDocument``."""
    levels = landmarks(body).levels(body.rest_vertices(shape))
    ranges = {name: {"least": least, "most": most} for name, (least, most) in measure_ranges(body).items()}
    numbers = {"betas": shape.tolist(), "measures": measures(body, shape)._asdict()}
    return numbers | {"levels": levels._asdict(), "ranges": ranges}


@router.post(
    "/bodies/{body_id}/shapes",
    openapi_extra=body_schema(ShapeRequest),
    responses=responses(InputError, NotFound, BodyError, TooSlow, TooLarge),
)
async def body_shape(body_id: str, request: Request, state: StateHere, client: ClientHere) -> ShapeDocument:
    """Returns the likeliest shape of the body with the given measures."""
    runtime = state.runtime
    runtime.check_body_id(body_id)
    state.check_slot()
    given = validate_document(ShapeRequest, read_document(await json_text(request))).model_dump(exclude_none=True)
    with state.access.using(client, "clips"), state.slot():
        shape = await runtime.call_apart(shape_of_measures, runtime.body, given)
    reached = Measures._asdict(shape.reached)
    return ShapeDocument.model_validate({"betas": shape.betas.tolist(), "measures": reached, "missed": shape.missed})


@router.post(
    "/garments/{garment_id}/fit",
    response_model=FitDocument,
    openapi_extra=body_schema(FitRequest),
    responses=responses(
        *(InputError, NotFound, NotAcceptable, BodyError, MotionError, TooSlow, TooLarge), kinds=(JSON, BINARY)
    ),
)
async def garment_fit(garment_id: str, request: Request, state: StateHere, client: ClientHere) -> Response:
    """Returns how a garment fits: in words, as ease at chest, waist and hip, and as strain and pressure by region.

    The fit is measured on the network's smooth drape, without folds. Ease is that of the rest pose. Strain and pressure
    are those of ``pose``. With ``Accept: application/octet-stream`` the answer is binary, float32 (vertices, 3): strain
    along the warp, strain along the weft, pressure [N/m2].
    """
    runtime = state.runtime
    state.check_slot()
    fit = validate_document(FitRequest, read_document(await json_text(request)))
    kind = choose(request.headers.get("accept"), (JSON, BINARY))
    (entry,) = (await state.scene(garment_id, None, client, size=fit.size)).layers
    plan = runtime.plan(entry, DrapeOptions(**SMOOTH, fabric=fit.fabric))
    clip = _clip(fit, runtime.body)
    with state.access.using(client, "clips"), state.slot():
        draped = await runtime.drape(plan, clip)
        garment, fabric = plan.scene.layers[0].garment, plan.fabrics[0]
        report = await runtime.call_apart(fit_report, garment, runtime.body, _worn(clip, draped), fabric=fabric)
    if kind == BINARY:
        rows = np.stack(_of_delivered(report, entry), axis=1)
        return binary_answer(rows, state.sliced_thread, {"X-Drape-Vertices": str(len(rows))})
    return json_answer(_document(report, entry, vertices=fit.vertices), state.sliced_thread)


@router.get("/garments/{garment_id}/size", responses=responses(InputError, NotFound, BodyError))
async def garment_size(garment_id: str, state: StateHere, client: ClientHere, betas: Betas = None) -> SizeAdvice:
    """Returns the size of a garment that fits the body in the shape ``betas``, and why."""
    runtime = state.runtime
    entry = await state.garment(garment_id, client)
    shape = queried_shape(betas, runtime.body)
    advice = await asyncio.to_thread(runtime.sizes.advice, entry, shape)
    return SizeAdvice(size=advice.size, words=advice.words)


def _clip(fit: FitRequest, body: BodyModel) -> PoseInput:
    """Returns a clip of the rest pose, and after it the pose of the request if it has one."""
    poses = np.zeros((1 if fit.pose is None else 2, JOINT_COUNT, 3))
    if fit.pose is not None:
        poses[1] = fit.pose
    poses, trans = motion_arrays(poses, None, max_frames=len(poses))
    return PoseInput(poses, trans, shape_array(fit.betas, body), np.arange(float(len(poses))))


def _worn(clip: PoseInput, draped: Batch) -> JudgedDrape:
    """Returns the drapes of the frames of ``clip``, in the world, float64."""
    vertices = draped.vertices.astype(np.float64) + draped.root[:, None]
    posed = (clip.poses[1], vertices[1]) if len(vertices) > 1 else (None, None)
    return JudgedDrape(clip.betas, vertices[0], *posed)


def _of_delivered(report: FitReport, entry: Entry) -> list[np.ndarray]:
    """Returns strain along warp, strain along weft and pressure [N/m2] at each vertex that is drawn, (V,) float32
    each."""
    count, drawn = entry.garment.vertex_count, entry.garment.drawn
    if drawn is None:
        return [values[:count].astype(np.float32) for values in report.tension]
    return [(drawn.shares(count) @ values[:count]).astype(np.float32) for values in report.tension]


def _document(report: FitReport, entry: Entry, *, vertices: bool) -> dict[str, Any]:
    """Returns the fields of a ``FitDocument``; with ``vertices`` also those of each vertex."""
    ease = {name: {**girths._asdict(), "ease_m": girths.ease_m} for name, girths in report.ease.items()}
    regions = {name: region._asdict() for name, region in report.regions.items()}
    document: dict[str, Any] = {"garment": entry.id, "words": report.words, "ease": ease, "regions": regions}
    if vertices:
        document |= dict(zip(report.tension._fields, _of_delivered(report, entry), strict=True))
    return document
