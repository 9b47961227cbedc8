"""The naive twin of the stream: everything on the event loop, every pose in its turn, nothing dropped.

    python -m benchmarks.speed.twin --port 0

It drapes with the stages of the service, so that what differs is the serving alone. Load tests speak to both.
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np
import uvicorn
from fastapi import FastAPI, WebSocket, WebSocketDisconnect

from benchmarks.served import Stream
from drape.wire import messages as wire
from service.compute.drape_runtime import DrapeRuntime
from service.http.json_body import document_of, validated
from service.http.schemas import OpenRequest
from service.server import bind
from service.settings import Settings
from service.stages.batch import PoseInput

CREDIT = 2  # of poses that a client keeps, as the service says


def create_twin(drapery: DrapeRuntime) -> FastAPI:
    """An application with ``/stream`` alone."""
    app = FastAPI()

    @app.websocket("/stream")
    async def stream(socket: WebSocket) -> None:
        await socket.accept(subprotocol=wire.SUBPROTOCOL)
        opening = validated(OpenRequest, document_of((await socket.receive_text()).encode()))
        plan = drapery.plan(drapery.garments.scene(opening.garment, opening.garments), opening, messages=True)
        one = Stream(plan, drapery.body.shape_count)
        await socket.send_text(json.dumps({"type": "opened", "vertices": plan.shown.vertex_count, "credit": CREDIT}))
        try:
            while True:
                payload = await socket.receive_bytes()
                if wire.message_kind(payload) == wire.ACK:
                    continue
                pose = wire.unpack_pose(payload)
                times_s, betas = np.array([pose.client_time_s]), np.zeros(drapery.body.shape_count)
                asked = PoseInput(pose.pose[None], pose.trans[None], betas, times_s, sequence=pose.sequence)
                await socket.send_bytes(one.frame(asked).messages[0])
        except WebSocketDisconnect:
            return

    return app


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed.twin", description="The naive twin.")
    parser.add_argument("--port", type=int, default=0)
    options = parser.parse_args()
    listener = bind("127.0.0.1", options.port)
    app = create_twin(DrapeRuntime(Settings()))
    print(f"drape on http://127.0.0.1:{listener.getsockname()[1]}", flush=True)
    uvicorn.Server(uvicorn.Config(app, log_level="warning", ws_per_message_deflate=False)).run(sockets=[listener])
    return 0


if __name__ == "__main__":
    sys.exit(main())
