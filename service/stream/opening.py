"""Reads the message that opens a stream, or changes an open one, and writes the answer."""

from __future__ import annotations

import asyncio
import json
import time
from typing import TYPE_CHECKING, Any

from fastapi import WebSocket, WebSocketDisconnect

from drape.contact.projection import CLEARANCE_M
from drape.errors import InputError
from drape.stages.batch import shape_array
from drape.stages.encode import coordinate_bits
from drape.stages.plan import Plan
from drape.stages.scene import Outfit, layer_list
from drape.wire import messages as wire
from service.errors import TooSlow
from service.guard.limits import PACE_BYTES_S
from service.http.json_body import read_document, validate_document
from service.http.problems import JsonSource
from service.http.schemas import OpenRequest
from service.state import State
from service.stream.session import CREDIT, Opening

OPEN_S = 5.0  # the time for the opening message
MESSAGE = JsonSource("open message", 'Send {"type": "open", "garment": ...} first.')

if TYPE_CHECKING:
    from drape.avatar.wearer import Wearer
    from service.guard.key_file import Client
    from service.replicas.handover import Incoming


async def first_text(socket: WebSocket, pieces: Incoming) -> str:
    """Returns the text of the first message of ``socket`` that is no STATE message; STATE messages go to ``pieces``.

    Refuses (``TooSlow``) a client that sends none in time, and (``InputError``) bytes in place of text. Raises
    ``WebSocketDisconnect`` where the client leaves.
    """
    begun_s = time.monotonic()
    while True:
        until_s = begun_s + OPEN_S + pieces.size / PACE_BYTES_S
        try:
            message = await asyncio.wait_for(socket.receive(), max(0.0, until_s - time.monotonic()))
        except TimeoutError:
            raise TooSlow(
                MESSAGE.name,
                expected=f"an open message within {OPEN_S:g} s",
                got="nothing" if not pieces.messages else f"{pieces.size} bytes of a state",
                cure=MESSAGE.cure,
            ) from None
        payload = message.get("bytes")
        if payload is None or payload[5:6] != bytes([wire.STATE]):
            return text_of(message)
        pieces.take(payload)


def text_of(message: Any) -> str:
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1005))
    text = message.get("text")
    if text is None:
        raise InputError(MESSAGE.name, expected="JSON text", got="bytes", cure=MESSAGE.cure)
    return text


async def read_opening(text: str, state: State, client: Client) -> Opening:
    """Returns the opening that ``text``, the JSON of an ``OpenRequest``, asks for, after making all constants that its
    frames need. Refuses what the request or its scene and options refuse."""
    request = validate_document(OpenRequest, read_document(text.encode(), source=MESSAGE), source=MESSAGE)
    runtime = state.runtime
    scene = await state.requested_scene(request, client)
    plan = runtime.plan(scene, request, messages=True)
    betas = shape_array(request.betas, runtime.on(scene).body)
    steps = runtime.steps(plan)
    for step in {plan, *steps}:
        await runtime.prepare(step)
    wearer = None if request.avatar is None else await state.wearer(request.avatar, client)
    return Opening(plan, betas, steps, request.moves, request.same, wearer)


def opening_answer(plan: Plan, state: State, wearer: Wearer | None, **more: bool) -> str:
    """Returns the JSON of the ``opened`` message (docs/reference/wire.md) for a stream of ``plan`` on ``wearer``, or on
    the standard body where that is None. ``more`` are further fields."""
    scene, options, numbers = plan.shown, plan.options, plan.options.advanced
    jets = options.geometry == "jets"
    worn = {"garments": layer_list(scene, patches=jets)} if isinstance(scene, Outfit) else {"garment": scene.id}
    if jets:  # clients of vertices expect none of these fields
        worn |= {"geometry": "jets", "patches": scene.patch_count}
    if wearer is not None:
        worn |= {"nodes": len(wearer.nodes)}
    if options.resolution == "fine":
        worn |= {"resolution": "fine"}
    if options.folds_by == "client":
        clearance_m = CLEARANCE_M if numbers.push_out else 0.0
        how = {"settle": numbers.settle, "cloth_contact": numbers.cloth_contact, "clearance_m": clearance_m}
        worn |= {"folds_by": "client", "inertia": numbers.inertia, "coarse": bool(numbers.coarse)}
        worn |= how if plan.folds else {}
    return json.dumps(
        {
            "type": "opened",
            **worn,
            "vertices": scene.vertex_count,
            "model": state.runtime.engine.manifest.digest,
            "body": state.runtime.on(plan.scene).body.name,
            "credit": CREDIT,
            "push_out": numbers.push_out,
            "motion": options.knob,
            "tier": state.runtime.tier_of(plan),
            "passes": state.runtime.engine.pass_count if numbers.passes is None else numbers.passes,
            "folds": numbers.folds,
            "safe_folds": numbers.safe_folds or 0,
            "bits": coordinate_bits(options),
            **more,
        }
    )
