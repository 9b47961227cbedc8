"""Frames as messages of the wire, relative to their roots."""

from __future__ import annotations

import time
from dataclasses import replace

from drape.wire.jets import JetFrame, pack_jets
from drape.wire.messages import Frame, pack_frame
from service.stages.batch import Batch, Plan, Stage


class Encode(Stage):
    """Packs every frame as a FRAME or JETS message with its client's sequence and time."""

    name = "encode"

    def wanted(self, plan: Plan) -> bool:
        return plan.messages

    def run(self, batch: Batch) -> Batch:
        now = time.monotonic()
        messages = []
        as_jets = batch.plan.options.geometry == "jets"
        jets = batch.jets if as_jets else None
        vertices = None if as_jets else batch.vertices
        for one, rows in batch.rows():
            residence_s = 0.0 if one.arrived_s is None else now - one.arrived_s
            for i, row in enumerate(range(rows.start, rows.stop)):
                said = {
                    "sequence": one.sequence + i,
                    "client_time_s": float(one.times_s[i]),
                    "server_time_s": time.time(),
                    "root": batch.root[row],
                    "dropped": one.dropped,
                    "residence_us": int(1e6 * residence_s),
                    "pushed": bool(batch.plan.options.push_out),
                    "stepped": batch.plan.stepped,
                    "novelty": float(batch.quality.novelty[row]),
                    "pushed_share": float(batch.quality.pushed_share[row]),
                    "push_max_m": float(batch.quality.push_max_m[row]),
                }
                if jets is not None:
                    posed = {name: array[row] for name, array in vars(jets).items()}
                    messages.append(pack_jets(JetFrame(**said, **posed, left_m=float(batch.quality.left_m[row]))))
                elif vertices is not None:
                    messages.append(
                        pack_frame(Frame(**said, positions=vertices[row], bits=batch.plan.options.bits or 16))
                    )
        return replace(batch, messages=tuple(messages))
