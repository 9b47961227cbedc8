"""Modules of @drape/client in Node.js: what they decode is what Python packed, newest first, and they come back."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from drape.garment.cache import Garment
from drape.wire import messages as wire
from drape.wire.mesh_messages import STEP_M, pack_mesh
from tests.clients.node import answer_of
from tests.fixtures.patience import PATIENT_S
from tests.fixtures.streams import PROTOCOLS, page_command

FRAME = """
import { Decoding } from "./decoding.js";
import { unpackMesh } from "./meshes.js";
const bytesOf = (hex) => Uint8Array.from(Buffer.from(hex, "hex")).buffer;
const layers = input.meshes.map((mesh) => ({ ...unpackMesh(bytesOf(mesh)), layout: null }));
const bytes = bytesOf(input.frame);
"""
DECODER = """
const told = (targets) => targets && targets.map(({ positions, normals }) => [[...positions], [...normals]]);
const alone = told(await new Decoding(layers, null).decode(bytes));
const other = await new Decoding(layers.slice(1), null).decode(bytes);
// A worker that takes arrays along and never loads.
let worker;
const taking = { postMessage: (data, moved = []) => structuredClone(data, { transfer: moved }) };
const lost = new Decoding(layers, () => (worker = taking));
setTimeout(() => worker.onerror({}), 10);
const after = told(await lost.decode(bytes));
// The real one, beside stand-ins for the two ends of its channel.
let answer;
globalThis.self = { postMessage: (data) => (answer = data) };
await import("./worker.js");
self.onmessage({ data: { layers } });
const { makeTargets } = await import("./decode.js");
self.onmessage({ data: { message: bytes, targets: makeTargets(layers) } });
const worked = told(answer.filled && answer.targets);
self.onmessage({ data: { message: bytes.slice(0, 20), targets: makeTargets(layers) } });
console.log(JSON.stringify({
  alone, other, same: [after, worked].map((one) => JSON.stringify(one) === JSON.stringify(alone)), error: answer.error,
  index: layers.map(({ index }) => [...index]), uv: [...layers[0].uv], metres: layers[0].uvMetres,
}));
"""


def area_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3), the sum of the triangles' cross products at each vertex."""
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    cross = np.cross(second - first, third - first)
    sums = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(sums, faces[:, corner], cross)
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def test_layers_get_the_positions_and_normals_that_were_packed(tube: Garment, rng, tmp_path: Path):
    rest = tube.vertices[: tube.vertex_count]
    faces = tube.faces
    uv = rng.uniform(size=(3 * len(faces), 2))  # every corner its own: a seam everywhere
    corners = np.arange(3 * len(faces)).reshape(-1, 3)
    meshes = [pack_mesh(rest, faces, uv, corners), pack_mesh(rest, faces, uv[:0], corners[:0])]
    vertices = np.concatenate([rest, rest + rng.normal(scale=0.01, size=rest.shape)]).astype(np.float32)
    frame = wire.Frame(1, 0.0, 0.0, np.zeros(3), vertices, 0, 0, True, 0.0, 0.0)
    packed = wire.pack_frame(frame)
    document = {"frame": packed.hex(), "meshes": [mesh.hex() for mesh in meshes]}
    got = answer_of(FRAME + DECODER, document, tmp_path)
    count = len(rest)
    expected = wire.unpack_frame(packed).positions
    for layer, index in enumerate(got["index"]):
        positions, normals = (np.reshape(numbers, (-1, 3)) for numbers in got["alone"][layer])
        ours = expected[layer * count : (layer + 1) * count]
        assert_allclose(positions[:count], ours, rtol=0, atol=1e-6)
        assert_allclose(normals[:count], area_normals(positions[:count], faces), rtol=0, atol=1e-4)
        assert_allclose(positions[index], ours[faces.ravel()], rtol=0, atol=1e-6)
        assert_allclose(normals[index], normals[faces.ravel()], rtol=0, atol=0)
    off_m = got["metres"] * (np.reshape(got["uv"], (-1, 2))[got["index"][0]] - uv)
    assert np.abs(off_m).max() < 0.501 * STEP_M
    assert got["other"] is None, "frames of other garments are left out"
    assert got["same"] == [True, True], "without a worker, with one, and where it fails"
    assert "too short" in got["error"]


MAILBOX = """
import { Drape } from "./core.js";
import { Wearing } from "./wearing.js";
const wearing = new Wearing(new Drape("http://127.0.0.1"), ["tube"], {});
const shown = [];
let finish;
const asked = [];
wearing.decoding = {
  decode(data) {
    asked.push(data.name);
    return new Promise((resolve) => (finish = () => resolve([{}])));
  },
};
wearing.onFrame = () => shown.push(wearing.root);
const header = { dropped: 0, residence_us: 0 };
const frame = (name, root, data = { name }) => {
  wearing.stream.onFrame({ header: { ...header, root }, data, pose: [], bytes: 1, ageS: () => 0 });
  return data;
};
const settled = () => new Promise((resolve) => setTimeout(resolve, 5));
frame("a", 1); frame("b", 2); frame("c", 3);
const kept = frame("d", 4);
finish(); await settled();
finish(); await settled();
frame("d again", 5, kept);
console.log(JSON.stringify({ asked, shown, skipped: wearing.stats.skipped, frames: wearing.stats.frames }));
"""


def test_of_frames_that_wait_the_newest_is_decoded_and_the_others_are_counted(tmp_path: Path):
    got = answer_of(MAILBOX, {}, tmp_path)
    assert got == {"asked": ["a", "d"], "shown": [1, 4, 5], "skipped": 2, "frames": 3}


SOURCES = """
import { clipSource, flatPose } from "./sources.js";
const poses = [0, 1, 2, 3].map((frame) => Array.from({ length: 24 }, () => [frame, 0, 0]));
const clip = { fps: 2, frames: 4, poses, trans: [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]] };
const at = (source, times) => times.map((timeS) => [source(timeS).poses[0], source(timeS).trans[0]]);
let refused;
try { flatPose([1, 2, 3].map(() => [0, 0, 0])); } catch (error) { refused = [error.name, error.kind, error.message]; }
console.log(JSON.stringify({
  looped: at(clipSource(clip), [0, 0.6, 1.9, 2.1]), refused,
  once: at(clipSource(clip, { loop: false, speed: 2 }), [0.3, 9]),
}));
"""


def test_clips_play_in_a_loop_or_once(tmp_path: Path):
    got = answer_of(SOURCES, {}, tmp_path)
    assert got["looped"] == [[0, 0], [1, 1], [3, 3], [0, 0]]
    assert got["once"] == [[1, 1], [3, 3]]
    assert got["refused"][:2] == ["poses", "MotionError"] and "got 9 numbers" in got["refused"][2]


@contextmanager
def service_that_ends(openings: list[float]) -> Iterator[str]:
    """The address of a stream that answers poses, and cuts its first two connections: one at its opening, one after a
    frame. ``openings`` gets when [s] each was opened."""

    def talk(socket: ServerConnection) -> None:
        socket.recv(timeout=PATIENT_S)
        openings.append(time.monotonic())
        if len(openings) == 1:
            socket.close(1011, "a fault")
            return
        socket.send(json.dumps({"type": "opened", "garment": "tube", "tier": "fast"}))
        try:
            while True:
                message = socket.recv(timeout=PATIENT_S)
                assert isinstance(message, bytes)
                if wire.message_kind(message) != wire.POSE:
                    continue
                pose = wire.unpack_pose(message)
                vertices = np.full((2, 3), len(openings), np.float32)
                vertices[0] = 0.0
                socket.send(
                    wire.pack_frame(wire.Frame(pose.sequence, 0.0, 0.0, pose.trans, vertices, 0, 0, True, 0, 0))
                )
                if len(openings) == 2:
                    socket.recv(timeout=PATIENT_S)  # its acknowledgement
                    socket.close(1011, "a fault")
                    return
        except ConnectionClosed:
            return

    with serve(talk, "127.0.0.1", 0, subprotocols=PROTOCOLS) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()


RECONNECT = """
const states = [];
const seen = [];
const stream = new Stream({
  onFrame({ header }) {
    seen.push([header.root[0], Math.round(header.box_step[0] * 65535)]);
    if (seen.at(-1)[1] < 3) return;
    stream.close();
    console.log(JSON.stringify({ states, seen, sent: stream.send(pose, [0, 0, 0]) }));
    process.exit(0);
  },
  onState(state, refusal) { states.push([state, refusal?.message ?? ""]); },
});
stream.open({ garment: "tube" });
setInterval(() => stream.send(pose, [7, 0, 0]), 20);
"""


def test_a_lost_stream_comes_back_by_itself_and_frames_go_on(tmp_path: Path):
    openings: list[float] = []
    with service_that_ends(openings) as url:
        run = subprocess.run(page_command(tmp_path, RECONNECT, url), capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout)
    assert said["states"] == [["waiting", "a fault"], ["open", ""], ["waiting", "a fault"], ["open", ""]]
    assert [connection for _, connection in said["seen"]] == [2, 3] and said["seen"][0][0] == 7
    assert not said["sent"], "a closed stream takes no pose"
    assert len(openings) == 3
    assert openings[1] - openings[0] > 0.45 and openings[2] - openings[1] > 0.45


BACK_OFF = """
let now = 0;
const waits = [];
globalThis.setTimeout = (task, ms) => { waits.push(ms); if (waits.length < 7) queueMicrotask(task); return 0; };
globalThis.WebSocket = class {
  static OPEN = 1;
  static CONNECTING = 0;
  constructor() { queueMicrotask(() => this.onclose?.({ code: 1006, reason: "" })); }
  close() {}
};
const { Stream } = await import("./stream.js");
const stream = new Stream({ base: "http://x", onFrame() {}, onState() {} });
stream.open({ garment: "tube" });
await new Promise((resolve) => setImmediate(resolve));
console.log(JSON.stringify(waits));
"""


def test_pauses_between_tries_double_up_to_a_limit(tmp_path: Path):
    assert answer_of(BACK_OFF, {}, tmp_path) == [500, 1000, 2000, 4000, 8000, 8000, 8000]


HOOK = """
import { readFileSync, writeFileSync } from "node:fs";
const here = (name) => new URL(name, import.meta.url);
// React's two hooks and its elements, as far as this one needs them.
writeFileSync(here("hooks.js"), `
  const slots = [];
  let at = 0;
  export function render(component) {
    at = 0;
    const value = component();
    for (const slot of slots) slot.run?.();
    return value;
  }
  export const createElement = (...parts) => parts;
  export function useState(first) {
    const slot = (slots[at++] ??= { value: first });
    return [slot.value, (next) => (slot.value = typeof next === "function" ? next(slot.value) : next)];
  }
  export function useEffect(effect, needs) {
    const slot = (slots[at++] ??= {});
    slot.run = () => {
      if (slot.needs?.every((one, i) => one === needs[i])) return;
      slot.undo?.();
      slot.needs = needs;
      slot.undo = effect();
    };
  }`);
writeFileSync(here("service.js"), `
  export const calls = [];
  const garment = (name) => ({
    name,
    play: async (motion) => calls.push(["play", name, motion]),
    stop: () => calls.push(["stop", name]),
    dispose: () => calls.push(["dispose", name]),
  });
  async function wear(name, options) {
    if (name === "nothing") throw new Error("no such garment");
    calls.push(["wear", name, options]);
    return garment(name);
  }
  export async function connect(url) {
    calls.push(["connect", url]);
    return { wear };
  }`);
const source = readFileSync(here("react.js"), "utf8");
writeFileSync(here("hook.js"), source.replace('"react"', '"./hooks.js"').replace('"./index.js"', '"./service.js"'));
const { render } = await import("./hooks.js");
const { calls } = await import("./service.js");
const { useGarment } = await import("./hook.js");
const settled = () => new Promise((resolve) => setTimeout(resolve, 5));
const shown = async (name, play) => {
  for (let i = 0; i < 3; i++) { render(() => useGarment("http://x", name, { tier: "fast", play })); await settled(); }
  return render(() => useGarment("http://x", name, { tier: "fast", play }));
};
const first = await shown("shirt", "walk");
const second = await shown("skirt");
const third = await shown("nothing");
const names = [first.garment.name, second.garment.name, third.garment];
console.log(JSON.stringify({ names, error: third.error.message, calls }));
"""


def test_the_hook_wears_one_garment_at_a_time(tmp_path: Path):
    got = answer_of(HOOK, {}, tmp_path)
    assert got["names"] == ["shirt", "skirt", None] and got["error"] == "no such garment"
    assert got["calls"] == [
        ["connect", "http://x"],
        ["wear", "shirt", {"tier": "fast"}],
        ["play", "shirt", "walk"],
        ["dispose", "shirt"],
        ["stop", "shirt"],
        ["wear", "skirt", {"tier": "fast"}],
        ["stop", "skirt"],
        ["dispose", "skirt"],
    ]


ACCESS = """
import { Rest } from "./rest.js";
const asked = [];
let given = 0;
globalThis.fetch = async (address, { headers, method = "GET" } = {}) => {
  asked.push([method, address, headers?.Authorization ?? ""]);
  if (address.endsWith("/health")) throw new TypeError("no answer");
  const ok = !address.endsWith("/tiers");
  return { ok, status: ok ? 200 : 502, statusText: "Bad Gateway", json: async () => {
    if (!ok) throw new SyntaxError("a proxy's page");
    return { ticket: "of the service" };
  } };
};
const open = new Rest("http://x/", {});
const keyed = new Rest("http://x", { key: "k" });
const page = new Rest("http://x", { ticket: async () => `t${++given}` });
await open.garments();
await keyed.garments();
await page.garments();
await page.fabrics();
const tickets = [await open.ticket(), await keyed.ticket(), await page.ticket()];
const refused = [];
for (const task of [() => open.tiers(), () => open.health()]) {
  await task().catch((error) => refused.push([error.name, error.kind, error.status, error.message]));
}
console.log(JSON.stringify({ asked, tickets, refused }));
"""


def test_requests_carry_a_key_or_a_ticket_and_a_stream_gets_a_ticket_of_its_own(tmp_path: Path):
    got = answer_of(ACCESS, {}, tmp_path)
    assert got["asked"][:5] == [
        ["GET", "http://x/garments", ""],
        ["GET", "http://x/garments", "Bearer k"],
        ["GET", "http://x/garments", "Bearer t1"],
        ["GET", "http://x/fabrics", "Bearer t1"],
        ["POST", "http://x/tickets", "Bearer k"],
    ]
    assert got["tickets"] == ["", "of the service", "t2"]
    proxy, silent = got["refused"]
    assert proxy == ["/tiers", "DrapeError", 502, "502 Bad Gateway"]
    assert silent == ["service", "Unavailable", 0, "The service does not answer. Is it still running?"]
